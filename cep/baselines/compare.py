"""What a code is compared with: the open shutter, the best short exposure, published, length-only and random codes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cep.baselines.dnf import dnf_search
from cep.baselines.light import best_snapshot, random_codes
from cep.baselines.published import for_chips
from cep.code import ShutterCode
from cep.mtf import CodeMetrics
from cep.search.objective import Objective
from cep.search.problem import SearchProblem

__all__ = ["BaselineRow", "compare"]

_RANDOM_CODES = 15
_LENGTH_ONLY_MOVES = 200_000
_LENGTH_ONLY_S = 3.0  # it may take so long in any case: to 128 chips the moves are done by then, whatever the limit


@dataclass(frozen=True)
class BaselineRow:
    """A line of the comparison.

    Attributes
    ----------
    name : str
        "this code", "open shutter", "best snapshot", "published: NAME", "length-only code" or "random code, median".
    code : ShutterCode
    metrics : CodeMetrics
        Worst over the problem's scenarios and directions. Only the first row's ``min_mtf_lower`` is worth anything:
        the others carry no certificate.
    stopped_early : bool
        Whether the time limit or Ctrl-C ended the search of this code: another run may give another.
    """

    name: str
    code: ShutterCode
    metrics: CodeMetrics
    stopped_early: bool = False


def compare(
    problem: SearchProblem,
    code: ShutterCode,
    *,
    rng: np.random.Generator,
    metrics: CodeMetrics | None = None,
    time_s: float = 60.0,
) -> tuple[BaselineRow, ...]:
    """Measure ``code``, and what would be used instead of it, on the same motions; first row the code itself.

    Parameters
    ----------
    problem : SearchProblem
        The baselines need not keep its limits, but for the light of the length-only and the random ones.
    code : ShutterCode
    rng : numpy Generator
    metrics : CodeMetrics, optional
        The code's own, where they are known already.
    time_s : float
        Limit of the length-only code's search, seconds, as :func:`cep.search.annealing.anneal.anneal` takes it; at
        least 3, so that codes of usual lengths do not depend on it.

    Notes
    -----
    The snapshot is the run of open chips, anywhere in the exposure and of any length, that is best by the problem's
    objective. The length-only code is searched as the DNF methods do: for a uniform straight motion of the path's
    length, least noise. The random code is the middle one of 15 by the objective.
    """
    objective = Objective(problem, oversampling=8)
    others = {"open shutter": ShutterCode("1" * problem.chips), "best snapshot": best_snapshot(objective)}
    others |= {f"published: {entry.name}": entry.code for entry in for_chips(problem.chips)}
    lengths = [scenario.trajectory.length_px for scenario in problem.scenarios] or [float(problem.chips)]
    length_only = dnf_search(
        float(np.mean(lengths)), problem.chips, rng=rng, steps=_LENGTH_ONLY_MOVES, open_range=problem.open_limits,
        time_s=max(time_s, _LENGTH_ONLY_S),
    )  # fmt: skip
    others["length-only code"] = length_only.code
    stopped_early = {"length-only code"} if length_only.stopped in ("time", "interrupted") else set()
    others["random code, median"] = random_codes(objective, _RANDOM_CODES, rng=rng).middle
    return (
        BaselineRow("this code", code, metrics or problem.measure(code)),
        *(
            BaselineRow(
                name, ShutterCode(other.bits, code.chip_ns), problem.measure(other, budget=0), name in stopped_early
            )
            for name, other in others.items()
        ),
    )
