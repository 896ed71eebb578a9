"""Search of the code of a class of motions, judged on motions that the search has not seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cep.codes.published import PUBLISHED
from cep.files.code_files import StoredCode
from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_frame, check_resolved
from cep.search.code_search import SearchOptions, described_search, search_code
from cep.search.cost import CodeCost
from cep.search.limits import RunLimits
from cep.search.objectives import OBJECTIVES
from cep.search.playable import unplayable
from cep.search.problem import SearchProblem
from lab.class_code.motions import class_scenarios
from lab.class_code.optimum import PUBLISHED_PREFIX, ClassOptimum, ClassRow
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_STANDARD = "raskar-52"  # compared with where no published code has as many chips
_AT_ONCE = 32  # motions in memory while codes are judged
_SEARCH_SHARE = 0.8  # of the time: judging takes the rest


def check_class(problem: SearchProblem) -> None:
    """Refuse a problem that has no meaningful mean over a class of motions.

    Raises
    ------
    ValueError
        If the objective's mean says nothing, a path cannot be measured, or all are too short for
        so many chips.
    """
    for criterion, _ in problem.criteria:
        if not criterion.averages:
            names = [name for name, objective in OBJECTIVES.items() if objective.averages]
            raise ValueError(
                f"objective: a class is searched by {' or '.join(names)} alone, got"
                f" {criterion.name}"
            )
    paths = [scenario.trajectory for scenario in problem.scenarios]
    for path in paths:
        check_frame(path)
    check_resolved(max(paths, key=lambda path: path.length_px), problem.chips)


def optimize_class(
    motions: Sequence[Trajectory],
    problem: SearchProblem,
    how: SearchOptions,
    *,
    held_out: Sequence[Trajectory] = (),
    threads: int | None = None,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
    on_found: Callable[[StoredCode], None] = lambda _stored: None,
) -> ClassOptimum:
    """Search the code whose mean decibels over a class of motions are best, and judge it on
    others.

    Where a code of the comparison that keeps the limits is better on the others, that one is
    returned.

    Parameters
    ----------
    motions : sequence of Trajectory
        One of unknown direction counts both ways, with half the weight each.
    problem : SearchProblem
        Chips, limits, light, objective; its scenarios, rule and direction are replaced.
    how : SearchOptions
        Of the method "anneal".
    held_out : sequence of Trajectory, optional
        Motions of the same class that the search does not see.
    threads : int, optional
        As many as there are cores when omitted; the code does not depend on it.
    progress : callable, optional
        Called with the finished share, 0..1, and a note.
    on_found : callable, optional
        Called with the code before it is judged.

    Raises
    ------
    ValueError
        If there are no motions, the device cannot play the code, or as of :func:`check_class`.

    Examples
    --------
    >>> from lab.class_code.motions import draw_motions
    >>> rng = np.random.default_rng(0)
    >>> walks, unseen = (draw_motions(count, length_px=20.0, rng=rng) for count in (4, 2))
    >>> problem = SearchProblem.along(chips=8, open_range=(4, 4), objective="mse")
    >>> best = optimize_class(walks, problem, SearchOptions(steps=500), held_out=unseen)
    >>> others_db = [row.others_db for row in best.rows if row.within_limits]
    >>> best.code.open_chips, best.rows[0].others_db <= min(others_db)
    (4, True)
    """
    problem = replace(
        problem, scenarios=class_scenarios(motions), rule="mean", direction="forward"
    )
    check_class(problem)
    result = search_code(
        problem,
        how,
        threads=threads,
        progress=lambda share, best: progress(_SEARCH_SHARE * share, f"{best.open_chips} open"),
    )
    code = replace(result.code, chip_ns=problem.chip_ns)
    if reason := unplayable(code.bits, problem.device, code.chip_ns):
        raise ValueError(reason)
    on_found(
        StoredCode(
            code,
            problem=described_search(problem, how, steps=result.steps, stopped=result.stopped),
        )
    )
    rivals = {
        baseline.name: (ShutterCode(baseline.code.bits, problem.chip_ns), baseline.within_limits)
        for baseline in result.baselines
    }
    if problem.response is None and not any(name.startswith(PUBLISHED_PREFIX) for name in rivals):
        rivals[PUBLISHED_PREFIX + _STANDARD] = (_standard_code(problem), False)
    codes = [code, *(rival for rival, _ in rivals.values())]
    class_figures = _judged(problem, motions, codes)
    figures = class_figures
    if held_out:
        progress(0.9, "judging on other motions")
        figures = _judged(problem, held_out, codes)
    means = figures.mean(axis=0)
    # a search may learn its motions by heart: what is better on others within the limits is taken
    allowed = [0, *(index for index, (_, within) in enumerate(rivals.values(), 1) if within)]
    best = min(allowed, key=means.__getitem__)
    order = [best, *range(1, len(codes))]
    names = ["this code", *rivals]
    rows = tuple(
        ClassRow(
            names[place],
            codes[index],
            place == 0 or rivals[names[place]][1],
            float(class_figures[:, index].mean()),
            float(means[index]) if held_out else None,
            *_mean_and_error(figures[:, index] - figures[:, best]),
        )
        for place, index in enumerate(order)
    )
    progress(1.0, "")
    return ClassOptimum(problem, how, result, rows, len(motions), len(held_out))


def per_motion_db(
    problem: SearchProblem, motions: Iterable[Trajectory], codes: Sequence[ShutterCode]
) -> FloatArray:
    """Judge codes by a problem's objective on each motion, (motions, codes) dB; ways of unknown
    direction averaged.
    """
    paths = list(motions)
    chips = np.array([code.array for code in codes], dtype=np.int8)
    costs: list[FloatArray] = []
    for start in range(0, len(paths), _AT_ONCE):
        for path_costs in _each_db(problem, paths[start : start + _AT_ONCE], chips):
            costs.append(path_costs)
    return np.array(costs)


def _judged(
    problem: SearchProblem, motions: Sequence[Trajectory], codes: Sequence[ShutterCode]
) -> FloatArray:
    """As :func:`per_motion_db`, of codes of any number of chips, all as long as the exposure."""
    costs = np.empty((len(motions), len(codes)))
    for chips in {code.chips for code in codes}:
        places = [index for index, code in enumerate(codes) if code.chips == chips]
        same_chips = problem
        if chips != problem.chips:  # a published code is played within the same exposure
            same_chips = _with_chips(problem, chips)
        costs[:, places] = per_motion_db(same_chips, motions, [codes[index] for index in places])
    return costs


def _with_chips(problem: SearchProblem, chips: int) -> SearchProblem:
    return replace(
        problem,
        chips=chips,
        open_range=None,
        runs=RunLimits(),
        scenarios=(),
        response=None,
        chip_ns=max(1, round(problem.chip_ns * problem.chips / chips)),
    )


def _standard_code(problem: SearchProblem) -> ShutterCode:
    code = PUBLISHED[_STANDARD]
    return replace(code, chip_ns=_with_chips(problem, code.chips).chip_ns)


def _each_db(
    problem: SearchProblem, paths: Sequence[Trajectory], chips: NDArray[np.int8]
) -> list[FloatArray]:
    scenario_lists = [class_scenarios([path]) for path in paths]
    scenarios = tuple(scenario for scenario_list in scenario_lists for scenario in scenario_list)
    code_cost = CodeCost(
        replace(problem, scenarios=scenarios, rule="mean", direction="forward"),
        oversampling=16,
        dtype=np.float64,
    )
    rows = code_cost.each_cost_of(chips)
    bounds = np.cumsum([len(scenario_list) for scenario_list in scenario_lists])
    return [np.asarray(piece.mean(axis=0)) for piece in np.split(rows, bounds[:-1])]


def _mean_and_error(values: FloatArray) -> tuple[float, float]:
    error = math.nan
    if values.size > 1:
        error = float(values.std(ddof=1)) / math.sqrt(values.size)
    return float(values.mean()), error
