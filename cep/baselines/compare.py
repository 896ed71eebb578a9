"""What a code is compared with: the open shutter, the best short exposure, published, length-only and random codes."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from cep.baselines.published import for_chips
from cep.code import ShutterCode
from cep.mtf import CodeMetrics
from cep.search.anneal import anneal
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory

__all__ = ["BaselineRow", "compare"]

_RANDOM_CODES = 9
_BOUND_BUDGET = 2_000  # frequencies for a baseline's lower bound: these rows carry no certificate


@dataclass(frozen=True)
class BaselineRow:
    """A line of the comparison.

    Attributes
    ----------
    name : str
        "code", "open", "snapshot", "length-only", "random (median)", or a published code's name.
    code : ShutterCode or None
        None for the random codes, whose figures are each a median.
    metrics : CodeMetrics
        Worst over the problem's scenarios and directions.
    """

    name: str
    code: ShutterCode | None
    metrics: CodeMetrics


def compare(
    problem: SearchProblem, code: ShutterCode, *, rng: np.random.Generator, steps: int = 60_000
) -> list[BaselineRow]:
    """Measure ``code`` beside its baselines on the same motions; they need not keep the problem's limits.

    Parameters
    ----------
    problem : SearchProblem
    code : ShutterCode
    rng : numpy Generator
    steps : int
        Moves for the length-only code.

    Notes
    -----
    The snapshot is the run of open chips, anywhere in the exposure and of any length, that is best by the problem's
    objective. The length-only code is searched as the DNF methods do: for a uniform straight motion of the path's
    length, least noise.
    """
    rows = [BaselineRow("code", code, problem.measure(code))]
    others = [("open", ShutterCode("1" * problem.chips)), ("snapshot", _snapshot(problem))]
    others += [(entry.name, entry.code) for entry in for_chips(problem.chips)]
    others.append(("length-only", _length_only(problem, rng=rng, steps=steps)))
    rows += [BaselineRow(name, other, problem.measure(other, budget=_BOUND_BUDGET)) for name, other in others]
    drawn = problem.random_codes(_RANDOM_CODES, rng=rng)
    measured = [problem.measure(ShutterCode.from_array(bits), budget=0) for bits in drawn]
    rows.append(BaselineRow("random (median)", None, _median(measured)))
    return rows


def _snapshot(problem: SearchProblem) -> ShutterCode:
    n, chip = problem.chips, np.arange(problem.chips)
    # a snapshot of zero blur is dark, one of all chips is the open shutter
    runs = np.array(
        [(chip >= first) & (chip < first + k) for k in range(1, n + 1) for first in range(n - k + 1)], dtype=np.int8
    )
    objective = Objective(problem, oversampling=8)
    step = max(1, 2**21 // objective.basis[0].size)
    costs = np.concatenate([objective.cost_of(runs[i : i + step]) for i in range(0, len(runs), step)])
    return ShutterCode.from_array(runs[int(costs.argmin())])


def _length_only(problem: SearchProblem, *, rng: np.random.Generator, steps: int) -> ShutterCode:
    lengths = [scenario.trajectory.length_px for scenario in problem.scenarios] or [float(problem.chips)]
    straight = SearchProblem.along(
        Trajectory.straight(max(1.0, float(np.mean(lengths)))),
        chips=problem.chips,
        open_range=problem.open_limits,
        objective="noise",
    )
    return anneal(straight, rng=rng, steps=steps).code


def _median(measured: list[CodeMetrics]) -> CodeMetrics:
    def middle(name: str) -> Any:
        values = [value for item in measured if (value := getattr(item, name)) is not None]
        return float(np.median(values)) if values else None

    return CodeMetrics(**{field.name: middle(field.name) for field in fields(CodeMetrics)})
