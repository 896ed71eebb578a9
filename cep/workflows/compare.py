"""Codes along an estimated motion: what they can resolve, what they are worth, and what they are compared with."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import stays_in_place, uniform_length_px
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.proofs.measure import CodeMetrics, measure, worst_of
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from cep.search.recipe import Baseline
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
