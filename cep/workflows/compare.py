"""Designing a code for an estimated motion: what it can resolve, how it is judged, what a device can play."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import stays_in_place, uniform_length_px
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.response import ShutterResponse
from cep.proofs.measure import CodeMetrics, measure, worst_of
from cep.search.limits import RunLimits
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from cep.search.recipe import Baseline
from hw.device import DeviceProfile
from motdiff.trajectory import Trajectory

__all__ = [
    "FINEST_CHIP_PX",
    "LARGEST_FRAME_PX",
    "MOST_SAMPLES",
    "BaselineRow",
    "check_frame",
    "check_resolved",
    "compare",
    "expected_psnr_db",
    "judge",
    "limits_of_device",
    "response_of_device",
]


FINEST_CHIP_PX = 0.25
"""Shortest mean displacement per chip, px: the pitch of the HR map. Chips below it differ by nothing a pixel sees."""

LARGEST_FRAME_PX = 2048
"""Widest PSF frame, px, of a bent path that is measured: the work grows with its area."""

MOST_SAMPLES = 20_000
"""Most samples of a bent path that is measured: the work grows with them, to half a minute of a code's figures."""


def check_frame(trajectory: Trajectory) -> None:
    """Refuse a bent path too wide or too dense to be measured; a uniform straight one has a formula for any length.

    Raises
    ------
    ValueError
        If the PSF would need a frame of more than :data:`LARGEST_FRAME_PX`, or there are more samples than
        :data:`MOST_SAMPLES`.
    """
    if uniform_length_px(trajectory) is not None:
        return
    if trajectory.t.size > MOST_SAMPLES:
        raise ValueError(
            f"trajectory: the path has {trajectory.t.size} samples, at most {MOST_SAMPLES} can be measured; "
            "give fewer, the noise between them is not the camera's motion"
        )
    frame = trajectory.frame_size()
    if frame > LARGEST_FRAME_PX:
        raise ValueError(
            f"trajectory: the path needs a PSF of {frame} px around its zero, at most {LARGEST_FRAME_PX} can be handled"
        )


def check_resolved(trajectory: Trajectory, chips: int) -> None:
    """Refuse a code with more chips than the path can tell apart.

    Raises
    ------
    ValueError
        If a chip covers less than a quarter of a pixel on average; the line says how many chips would do, or how long
        a path where there is none.
    """
    if chips > 1 and stays_in_place(trajectory):
        raise ValueError(
            f"trajectory: the path stays in place, a code of {chips} chips needs a motion of at least "
            f"{chips * FINEST_CHIP_PX:g} px ({FINEST_CHIP_PX} px each)"
        )
    most = max(1, int(trajectory.length_px / FINEST_CHIP_PX))
    if chips > most:
        raise ValueError(
            f"chips: {chips} chips are too many for a path of {trajectory.length_px:.1f} px, "
            f"at most {most} can be resolved ({FINEST_CHIP_PX} px each)"
        )


def judge(trajectory: Trajectory, code: ShutterCode, *, camera: Camera | None = None) -> CodeMetrics:
    """Measure a code along a trajectory; when its direction is unknown, each figure is that of the worse one."""
    forward = measure(trajectory, code, camera=camera)
    mirror_image = trajectory.direction == "known" or uniform_length_px(trajectory) is not None
    if mirror_image or code.bits == code.bits[::-1]:
        return forward
    return worst_of(forward, measure(trajectory.reversed(), code, camera=camera))


def expected_psnr_db(
    problem: SearchProblem, codes: Sequence[ShutterCode], *, photons: Sequence[float]
) -> NDArray[np.float64]:
    """Expect this PSNR, dB, of the Wiener restoration at several light levels: (codes, levels), worse direction.

    Parameters
    ----------
    problem : SearchProblem
        Motions, and the camera but for its light.
    codes : sequence of ShutterCode
    photons : sequence of float
        Photo-electrons at full scale.
    """
    chips = np.array([code.array for code in codes], dtype=np.int8)
    columns = []
    for level in photons:
        camera = replace(problem.camera, photons_full_scale=level)
        at_level = replace(problem, objective="mse", camera=camera)
        columns.append(-Objective(at_level, oversampling=16, dtype=np.float64).cost_of(chips))
    return np.stack(columns, axis=1)


def limits_of_device(profile: DeviceProfile, *, chips: int, chip_ns: int) -> tuple[RunLimits, int]:
    """Translate a device's limits on times into limits on chips, for :class:`cep.search.problem.SearchProblem`.

    A code within them is one that :meth:`hw.device.DeviceProfile.check` passes, and the other way round.

    Parameters
    ----------
    profile : DeviceProfile
    chips, chip_ns : int

    Returns
    -------
    RunLimits, int
        And the most open chips of all runs together.

    Raises
    ------
    ValueError
        If the device cannot play codes of this length or chip time at all; the line says what it can.
    """
    _check_chip(profile, chip_ns)
    if profile.max_chips is not None and chips > profile.max_chips:
        raise ValueError(f"{profile.name}: plays at most {profile.max_chips} chips, {chips} were asked for")
    bias_ns = profile.on_bias_ns
    least_open_ns = max(profile.min_on_ns or 0, profile.tick_ns if bias_ns else 0) + bias_ns
    least_closed_ns = max(profile.min_off_ns or 0, profile.dead_time_ns)
    min_open, max_open = max(1, -(-least_open_ns // chip_ns)), None
    if min_open > chips:
        raise ValueError(
            f"chips: {profile.name} opens for at least {least_open_ns / 1e6:g} ms, a code of {chips} chips lasts "
            f"{chips * chip_ns / 1e6:g} ms; longer chips, or a faster shutter, would do"
        )
    if profile.max_on_ns is not None:
        max_open = profile.max_on_ns // chip_ns
        if max_open < 1:
            raise ValueError(
                f"chip_ns: {profile.name} opens for {profile.max_on_ns} ns at most, "
                f"a chip must not last longer, got {chip_ns} ns"
            )
        if max_open < min_open:
            raise ValueError(
                f"chip_ns: {profile.name} opens for {least_open_ns} to {profile.max_on_ns} ns, "
                f"no whole number of chips of {chip_ns} ns does; shorter chips would"
            )
    most_open_chips = chips
    if profile.max_duty is not None:
        # the device compares rounded quotients: so do these two, or a code at the very limit would be refused
        most_open_chips = bisect_right(range(1, chips + 1), profile.max_duty, key=lambda opened: opened / chips)
        if most_open_chips < min_open:
            raise ValueError(
                f"chips: {profile.name} may be open for {profile.max_duty:g} of the time at most, "
                f"too little for {min_open} of {chips} chips"
            )
    min_period = 1
    if profile.max_rate_hz is not None:
        # of chips, where every shorter one is too fast: a single opening is left
        min_period += bisect_left(range(1, chips), -profile.max_rate_hz, key=lambda period: -1e9 / (period * chip_ns))
    runs = RunLimits(
        min_open=min_open,
        min_closed=max(1, -(-least_closed_ns // chip_ns)),
        max_pulses=profile.max_pulses,
        max_open=max_open,
        min_period=min_period,
    )
    return runs, most_open_chips


def response_of_device(profile: DeviceProfile, chip_ns: int) -> ShutterResponse | None:
    """Describe how a device's shutter opens and closes around its edges, or None when it does so at once.

    What the device adds to every opening by itself, ``on_bias_ns``, is no part of it: whoever commands the device
    shortens the openings by as much.

    Parameters
    ----------
    profile : DeviceProfile
    chip_ns : int

    Raises
    ------
    ValueError
        If the chip time is none of the device's, or opening or closing takes longer than a chip.
    """
    _check_chip(profile, chip_ns)
    slowest = max(profile.rise_ns, profile.fall_ns)
    if slowest > chip_ns:
        raise ValueError(
            f"chip_ns: {profile.name} takes {slowest} ns to open or close, "
            f"chips must last at least as long, got {chip_ns} ns"
        )
    response = ShutterResponse(chip_ns=chip_ns, rise_ns=profile.rise_ns, fall_ns=profile.fall_ns)
    return None if response.instant else response


def _check_chip(profile: DeviceProfile, chip_ns: int) -> None:
    """Refuse a chip time that is no whole number of ticks, or out of range; name the nearest that would do."""
    tick = profile.tick_ns
    least = -(-(profile.min_chip_ns or 1) // tick) * tick
    most = None if profile.max_chip_ns is None else profile.max_chip_ns // tick * tick
    if chip_ns % tick == 0 and least <= chip_ns <= (most or chip_ns):
        return
    below = chip_ns // tick * tick
    near = sorted({min(max(time_ns, least), most or time_ns + least) for time_ns in (below, below + tick)})
    words = f"whole ticks of {tick} ns, from {least} ns" + ("" if most is None else f" to {most} ns")
    raise ValueError(
        f"chip_ns: {profile.name} plays chips of {words}, got {chip_ns} ns; "
        f"{' or '.join(str(time_ns) for time_ns in near)} ns would do"
    )


@dataclass(frozen=True)
class BaselineRow:
    """A line of the comparison.

    Attributes
    ----------
    name : str
        "this code", or of a :class:`cep.search.recipe.Baseline`.
    code : ShutterCode
    metrics : CodeMetrics
        Worst over the problem's scenarios and directions. Only the first row's ``min_mtf_lower`` is worth anything:
        the others carry no certificate.
    within_limits : bool
        Whether the code keeps the problem's limits: others could not be returned, however good they are.
    stopped_early : bool
        Whether the time limit or Ctrl-C ended the search of this code: another run may give another.
    """

    name: str
    code: ShutterCode
    metrics: CodeMetrics
    within_limits: bool
    stopped_early: bool = False

    @property
    def label(self) -> str:
        """The name, and whether the code breaks the limits, for tables."""
        return self.name if self.within_limits else f"{self.name} (outside the limits)"


def compare(
    problem: SearchProblem,
    code: ShutterCode,
    *,
    baselines: Iterable[Baseline],
    metrics: CodeMetrics | None = None,
) -> tuple[BaselineRow, ...]:
    """Measure ``code``, and what would be used instead of it, on the same motions; first row the code itself.

    Parameters
    ----------
    problem : SearchProblem
    code : ShutterCode
    baselines : iterable of Baseline
        As the code's search returned them, or :func:`cep.search.recipe.baselines` for a code from elsewhere.
    metrics : CodeMetrics, optional
        The code's own, where they are known already.
    """
    return (
        BaselineRow("this code", code, metrics or problem.measure(code), problem.allows(code)),
        *(
            BaselineRow(
                one.name,
                ShutterCode(one.code.bits, code.chip_ns),
                problem.measure(one.code, budget=0),
                one.within_limits,
                one.stopped_early,
            )
            for one in baselines
        ),
    )
