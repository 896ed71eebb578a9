"""What a code is compared with: the open shutter, the best short exposure, published, length-only and random codes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cep.baselines.published import for_chips
from cep.code import ShutterCode
from cep.mtf import CodeMetrics
from cep.search.annealing.anneal import anneal
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory

__all__ = ["BaselineRow", "compare"]

_RANDOM_CODES = 15
_LENGTH_ONLY_MOVES = 200_000
_LENGTHS, _STARTS = 32, 16  # snapshots looked at before the best one is moved chip by chip
_BATCH = 2**21  # numbers evaluated at once: 16 MB


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
    """

    name: str
    code: ShutterCode
    metrics: CodeMetrics


def compare(
    problem: SearchProblem, code: ShutterCode, *, rng: np.random.Generator, metrics: CodeMetrics | None = None
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

    Notes
    -----
    The snapshot is the run of open chips, anywhere in the exposure and of any length, that is best by the problem's
    objective. The length-only code is searched as the DNF methods do: for a uniform straight motion of the path's
    length, least noise. The random code is the middle one of 15 by the objective.
    """
    objective = Objective(problem, oversampling=8)
    others = {"open shutter": ShutterCode("1" * problem.chips), "best snapshot": _snapshot(objective)}
    others |= {f"published: {entry.name}": entry.code for entry in for_chips(problem.chips)}
    others["length-only code"] = _length_only(problem, rng=rng)
    drawn = problem.random_codes(_RANDOM_CODES, rng=rng)
    middle = np.argsort(_costs(objective, drawn), kind="stable")[_RANDOM_CODES // 2]
    others["random code, median"] = ShutterCode.from_array(drawn[middle])
    return (
        BaselineRow("this code", code, metrics or problem.measure(code)),
        *(
            BaselineRow(name, ShutterCode(other.bits, code.chip_ns), problem.measure(other, budget=0))
            for name, other in others.items()
        ),
    )


def _costs(objective: Objective, codes: NDArray[np.int8]) -> NDArray[np.float64]:
    step = max(1, _BATCH // objective.rows[0].size)
    return np.concatenate([objective.cost_of(codes[i : i + step]) for i in range(0, len(codes), step)])


def _snapshot(objective: Objective) -> ShutterCode:
    """Best run over a lattice of lengths and starts, then moved and stretched by single chips while that helps."""
    n = objective.problem.chips
    lengths = np.unique(np.linspace(1, n, min(n, _LENGTHS)).round().astype(int))
    runs = [
        (int(start), int(start) + int(length))
        for length in lengths
        for start in np.unique(np.linspace(0, n - length, min(n - length + 1, _STARTS)).round().astype(int))
    ]
    chip = np.arange(n)
    best, lowest = (0, n), np.inf
    while runs:
        drawn = np.array([(chip >= first) & (chip < end) for first, end in runs], dtype=np.int8)
        costs = _costs(objective, drawn)
        if costs.min() >= lowest:
            break
        best, lowest = runs[int(costs.argmin())], float(costs.min())
        near = [(best[0] + a, best[1] + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
        runs = [(first, end) for first, end in near if 0 <= first < end <= n]
    return ShutterCode("0" * best[0] + "1" * (best[1] - best[0]) + "0" * (n - best[1]))


def _length_only(problem: SearchProblem, *, rng: np.random.Generator) -> ShutterCode:
    lengths = [scenario.trajectory.length_px for scenario in problem.scenarios] or [float(problem.chips)]
    straight = SearchProblem.along(
        Trajectory.straight(max(1.0, float(np.mean(lengths)))),
        chips=problem.chips,
        open_range=problem.open_limits,
        objective="noise",
    )
    return anneal(straight, rng=rng, steps=_LENGTH_ONLY_MOVES).code
