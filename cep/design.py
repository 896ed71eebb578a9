"""Designing a code for an estimated motion: what it can resolve, how it is judged, and what it is compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cep.band import uniform_length_px
from cep.baselines.published import best_for
from cep.camera import Camera
from cep.code import ShutterCode
from cep.mtf import CodeMetrics, measure, worst_of
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from hw.device import DeviceProfile
from motdiff.trajectory import Trajectory

__all__ = [
    "FINEST_CHIP_PX",
    "Compared",
    "baselines",
    "check_resolved",
    "expected_psnr_db",
    "judge",
    "limits_of_device",
    "parseval_bound",
]

FINEST_CHIP_PX = 0.25
"""Shortest mean displacement per chip, px: the pitch of the HR map. Chips below it differ by nothing a pixel sees."""

_RANDOM_CODES = 15


@dataclass(frozen=True)
class Compared:
    """A code that another one is compared with.

    Attributes
    ----------
    name : str
    code : ShutterCode
    metrics : CodeMetrics
        Worst over the problem's motions and directions.
    """

    name: str
    code: ShutterCode
    metrics: CodeMetrics


def check_resolved(trajectory: Trajectory, chips: int) -> None:
    """Refuse a code with more chips than the path can tell apart.

    Raises
    ------
    ValueError
        If a chip covers less than a quarter of a pixel on average; the line says how many chips would do.
    """
    most = max(1, int(trajectory.length_px / FINEST_CHIP_PX))
    if chips > most:
        raise ValueError(
            f"chips: {chips} are too many for a path of {trajectory.length_px:.1f} px, "
            f"at most {most} can be resolved ({FINEST_CHIP_PX} px each)"
        )


def judge(trajectory: Trajectory, code: ShutterCode, *, camera: Camera | None = None) -> CodeMetrics:
    """Measure a code along a trajectory; when its direction is unknown, each figure is that of the worse one."""
    forward = measure(trajectory, code, camera=camera)
    mirror_image = trajectory.direction == "known" or uniform_length_px(trajectory) is not None
    if mirror_image or code.bits == code.bits[::-1]:
        return forward
    return worst_of(forward, measure(trajectory.reversed(), code, camera=camera))


def baselines(problem: SearchProblem, code: ShutterCode, *, rng: np.random.Generator) -> tuple[Compared, ...]:
    """Measure what a photographer would use instead of ``code``, on the same problem.

    The shutter open all the time; a snapshot, open for as many chips as the code but in one go; the best published
    code of this length, where there is one; and the middle one, by noise gain, of 15 random codes within the limits.

    Parameters
    ----------
    problem : SearchProblem
    code : ShutterCode
        The code that the others are compared with.
    rng : numpy Generator
    """
    n, k = code.chips, code.open_chips
    named = {"open shutter": "1" * n, "snapshot, same light": "1" * k + "0" * (n - k)}
    published = best_for(n)
    if published is not None:
        named[f"published: {published.name}"] = published.code.bits
    found = [_compared(problem, name, ShutterCode(bits, code.chip_ns)) for name, bits in named.items()]
    drawn = problem.random_codes(_RANDOM_CODES, rng=rng)
    random = [_compared(problem, "random, median", ShutterCode.from_array(c, chip_ns=code.chip_ns)) for c in drawn]
    random.sort(key=lambda item: item.metrics.noise_gain_db)
    return (*found, random[_RANDOM_CODES // 2])


def parseval_bound(problem: SearchProblem) -> float | None:
    """Upper bound of ``min_chip`` over all codes of a straight problem: mean |P|^2 over the circle is the open count.

    None where the motion is not straight and uniform.
    """
    if any(uniform_length_px(scenario.trajectory) is None for scenario in problem.scenarios):
        return None
    return float(np.sqrt(problem.open_limits[1]))


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


def limits_of_device(profile: DeviceProfile, *, chips: int, chip_ns: int) -> Mapping[str, int | None]:
    """Translate a device's limits on times into limits on chips, for :class:`cep.search.problem.SearchProblem`.

    Parameters
    ----------
    profile : DeviceProfile
    chips, chip_ns : int

    Returns
    -------
    mapping with ``min_open``, ``min_closed``, ``max_pulses`` and ``max_open``, the last two None when unlimited

    Raises
    ------
    ValueError
        If the device cannot play codes of this length or chip time at all.
    """
    if profile.max_chips is not None and chips > profile.max_chips:
        raise ValueError(f"{profile.name}: plays at most {profile.max_chips} chips, {chips} were asked for")
    bias_ns = profile.on_bias_ns
    least_open_ns = max(profile.min_on_ns or 0, profile.tick_ns if bias_ns else 0) + bias_ns
    least_closed_ns = max(profile.min_off_ns or 0, profile.dead_time_ns)
    return {
        "min_open": max(1, -(-least_open_ns // chip_ns)),
        "min_closed": max(1, -(-least_closed_ns // chip_ns)),
        "max_pulses": profile.max_pulses,
        "max_open": None if profile.max_duty is None else max(1, int(profile.max_duty * chips + 1e-9)),
    }


def _compared(problem: SearchProblem, name: str, code: ShutterCode) -> Compared:
    return Compared(name, code, problem.measure(code, budget=0))
