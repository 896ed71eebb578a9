"""A code beside what would be used instead of it: their figures, and what to expect of them at several light levels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.proofs.measure import CodeMetrics
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from cep.search.recipe import Baseline

__all__ = ["BaselineRow", "compare", "expected_psnr_db"]


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
