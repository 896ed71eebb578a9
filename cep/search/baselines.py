"""Codes used instead of a searched one: snapshot, strobe, published, DNF's and a random code.

All but the published codes and DNF's are judged by a problem's own objective. The random code and
DNF's keep its limits, the snapshot and the strobe keep them on request.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cep.codes.published import for_chips
from cep.files.tables import markdown_table
from cep.optics.code import ShutterCode
from cep.proofs.measure import CodeMetrics, PairMetrics
from cep.search.annealing.anneal import anneal
from cep.search.cost import CodeCost
from cep.search.limits import Limits, RunLimits
from cep.search.problem import SearchProblem
from cep.search.search_result import Baseline, ComparedCode
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

Codes = NDArray[np.int8]
_COARSE = 8  # samples per 1 / extent, to choose a snapshot, a strobe and a random code
_RANDOM_CODES = 15
_LENGTH_ONLY_MOVES = 200_000
_LENGTH_ONLY_SHARE = 0.25  # of the time limit: the only baseline that may take long
_WITHIN = " within the limits"
_AND_COMPLEMENT = " and complement"
_ALL_RUNS_WORK = 2**35  # multiplications that evaluating every snapshot may take: seconds
_LENGTHS = 32  # of snapshots beyond that, before the best one is moved chip by chip
_STARTS = 16
_PERIODS = 64  # of strobes, and widths of each period
_WIDTHS = 32
_PAIRS = 256  # of strobes within limits: widths with numbers of pulses, and periods of each
_PERIODS_WITHIN = 8
_SHORTEST_PX = 1.0  # paths that are shorter are designed for like one of a pixel
_BATCH = 2**21  # numbers evaluated at once: 16 MB


@dataclass(frozen=True, kw_only=True)
class BaselineRow(ComparedCode):
    """A line of the comparison.

    Attributes
    ----------
    metrics : CodeMetrics or PairMetrics
        Worst over the problem's scenarios and directions. Only the first row's ``min_mtf_lower``
        is worth anything: the others carry no certificate. Of a problem of two frames those of
        both cameras.
    """

    metrics: CodeMetrics | PairMetrics


class Comparison(tuple[BaselineRow, ...]):
    """Rows of a comparison, the code itself first; printed as a table in Markdown."""

    __slots__ = ()

    def __repr__(self) -> str:
        head = ("", "open", "min MTF", "noise gain, dB", "MSE, dB")
        return markdown_table(head, [_cells(row) for row in self])


def compare(
    problem: SearchProblem,
    code: ShutterCode,
    *,
    baselines: Iterable[Baseline] | None = None,
    seed: int = 0,
) -> Comparison:
    """Measure a code, and what would be used instead of it, on the same motions.

    Parameters
    ----------
    problem : SearchProblem
        Of one frame; pairs: :func:`cep.search.pairs.compare_pairs`.
    code : ShutterCode
    baselines : iterable of Baseline, optional
        As the code's search returned them; the problem's :func:`find_baselines` when omitted.
    seed : int
        Of the baselines that are searched or drawn here.

    Raises
    ------
    ValueError
        If the code has another number of chips.

    Examples
    --------
    >>> from motdiff.trajectory import Trajectory
    >>> path = Trajectory.from_samples([[0, 0], [9, 3], [14, 12]])
    >>> problem = SearchProblem.along(path, chips=8, objective="mse")
    >>> rows = compare(problem, ShutterCode("11100101"))
    >>> [row.name for row in rows][:4]
    ['this code', 'open shutter', 'best snapshot', 'best strobe']
    """
    if problem.frames == 2:
        raise ValueError("frames: 2 is for cep.optimize, whose result compares two cameras")
    if baselines is None:
        baselines = find_baselines(problem, rng=np.random.default_rng(seed))
    rows = [
        BaselineRow("this code", code, problem.allows(code), metrics=problem.measure(code)),
        *(
            BaselineRow(
                baseline.name,
                ShutterCode(baseline.code.bits, code.chip_ns),  # published codes have none
                baseline.within_limits,
                baseline.stopped_early,
                # no proof: it would take seconds
                metrics=problem.measure(baseline.code, budget=0),
            )
            for baseline in baselines
        ),
    ]
    return Comparison(rows)


def _cells(row: BaselineRow) -> tuple[object, ...]:
    figures = (row.metrics.in_words(name) for name in ("min_mtf", "noise_gain_db", "mse_db"))
    return row.label, row.code.open_chips, *figures


def find_baselines(
    problem: SearchProblem,
    *,
    rng: np.random.Generator,
    judge: CodeCost | None = None,
    length_px: float | None = None,
    time_s: float = math.inf,
    threads: int | None = None,
) -> Iterator[Baseline]:
    """Yield the codes that would be used instead of a searched one, each as soon as it is known.

    Parameters
    ----------
    problem : SearchProblem
        Its limits are kept by the length-only and the random code, and by the snapshot and the
        strobe that say so.
    rng : numpy Generator
    judge : CodeCost, optional
        Of the problem, finely sampled; made here when omitted.
    length_px : float, optional
        Of the path, for the length-only code; :func:`mean_length_px` of the problem when omitted.
    time_s : float
        Limit of a search that these are for, seconds; the length-only code's own search takes a
        quarter of it at most.
    threads : int, optional
        As many as there are cores when omitted; the codes do not depend on it.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C, what was known has been yielded by then.

    Notes
    -----
    The snapshot is the run of open chips, anywhere in the exposure and of any length, and the
    strobe the periodic pulses, that are best by the problem's objective. The length-only code is
    searched as the DNF methods do: for a uniform straight motion of the path's length, least
    noise. The random code is the middle one of 15 by the objective.

    Of a problem of two frames each is played beside its complement, which the open shutter has
    none of: the snapshot is a single run in one camera, and the rest in the other.
    """
    judge = judge or CodeCost.fine(problem)

    def baseline(name: str, code: ShutterCode, *, stopped_early: bool = False) -> Baseline:
        allowed = problem.allows(code)
        if problem.frames == 2:
            name += _AND_COMPLEMENT
        return Baseline(name, code, allowed, stopped_early, cost_db=judge.exact_cost(code))

    if problem.frames == 1:
        yield baseline("open shutter", ShutterCode("1" * problem.chips))
    coarse = CodeCost(problem, oversampling=_COARSE)
    for name, best in (("best snapshot", best_snapshot), ("best strobe", best_strobe)):
        free = best(coarse)
        if free is None:  # two pulses do not fit
            continue
        yield baseline(name, free)
        if problem.allows(free):
            continue
        # the best of all breaks the limits: also the best that could be used
        limited = best(coarse, within_limits=True)
        if limited is not None:
            yield baseline(name + _WITHIN, limited)
    for entry in for_chips(problem.chips):
        yield baseline(f"published: {entry.name}", entry.code)
    if length_px is None:
        length_px = mean_length_px(problem)
    length_only = anneal(
        dnf_problem(length_px, problem.chips, open_range=problem.open_limits, runs=problem.runs),
        rng=rng,
        steps=_LENGTH_ONLY_MOVES,
        time_s=_LENGTH_ONLY_SHARE * time_s,
        threads=threads,
    )
    early = length_only.stopped in ("time", "interrupted")
    yield baseline("length-only code", length_only.code, stopped_early=early)
    if length_only.stopped == "interrupted":
        raise KeyboardInterrupt
    random_code = median_random_code(coarse, _RANDOM_CODES, rng=rng)
    yield baseline("random code, median", random_code)


def mean_length_px(problem: SearchProblem) -> float:
    """Mean length of the problem's paths, px; on the unit circle, a px for each chip."""
    lengths_px = [scenario.trajectory.length_px for scenario in problem.scenarios]
    return float(np.mean(lengths_px or [problem.chips]))


def median_random_code(
    code_cost: CodeCost, count: int, *, rng: np.random.Generator
) -> ShutterCode:
    """Draw ``count`` codes within the limits, all equally likely: the one of the median cost.

    Of an even number, the worse of the two in the middle.
    """
    codes = code_cost.problem.random_codes(count, rng=rng)
    order = np.argsort(_costs(code_cost, codes), kind="stable")
    return ShutterCode(codes[order[count // 2]])


def best_snapshot(code_cost: CodeCost, *, within_limits: bool = False) -> ShutterCode | None:
    """Find the best single open run, of any length and anywhere in the exposure.

    With the objective "mse" its length is the one of least noise for the problem's camera. Every
    run is tried, to hundreds of chips along one motion. Beyond, 32 lengths and 16 starts are
    tried, and the best of these is moved and stretched by single chips while that helps.

    Parameters
    ----------
    code_cost : CodeCost
    within_limits : bool
        Whether it must keep the problem's limits.

    Returns
    -------
    ShutterCode or None
        None where no single run keeps the limits.
    """
    n = code_cost.problem.chips
    # of two frames one chip is left for the complement
    limits = Limits(n, (1, n + 1 - code_cost.problem.frames))
    if within_limits:
        limits = code_cost.problem.limits
    fits = _fitting_runs(limits)
    lengths = np.flatnonzero(fits.any(axis=1))
    most_lengths = _LENGTHS
    most_starts = _STARTS
    if np.count_nonzero(fits) * code_cost.rows.size <= _ALL_RUNS_WORK:
        most_lengths = most_starts = n + 1
    runs = [
        (int(start), int(start + length))
        for length in evenly_some(lengths, most_lengths)
        for start in evenly_some(np.flatnonzero(fits[length]), most_starts)
    ]
    chip = np.arange(n)
    best = (0, 0)
    lowest = np.inf
    # descent by single chips; where every run was tried, its first step ends it
    while runs:
        firsts, stops = np.array(runs).T
        codes = ((chip >= firsts[:, None]) & (chip < stops[:, None])).astype(np.int8)
        costs = np.where(limits.satisfied(codes), _costs(code_cost, codes), np.inf)
        if costs.min() >= lowest:
            break
        best = runs[int(costs.argmin())]
        lowest = float(costs.min())
        neighbours = [(best[0] + a, best[1] + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
        runs = [
            (first, end)
            for first, end in neighbours
            if 0 <= first < end <= n and fits[end - first, first]
        ]
    if not best[1]:
        return None
    return ShutterCode("0" * best[0] + "1" * (best[1] - best[0]) + "0" * (n - best[1]))


def best_strobe(code_cost: CodeCost, *, within_limits: bool = False) -> ShutterCode | None:
    """Find the best periodic pulses: ``width`` chips open of every ``period``, two or more.

    The first pulse begins with the exposure and the last is cut off with it. Every period and
    width is tried, of long codes 64 periods and 32 widths each. Along a uniform straight motion a
    periodic code has true zeros: "mse" alone is an objective for all motions.

    Parameters
    ----------
    code_cost : CodeCost
    within_limits : bool
        Whether it must keep the problem's limits. Then the pulses are whole, and may be fewer than
        there is time for.

    Returns
    -------
    ShutterCode or None
        None where two pulses do not fit, or no strobe that was tried keeps the limits.
    """
    problem = code_cost.problem
    codes = _strobes_within(problem) if within_limits else _strobes(problem.chips)
    if not len(codes):
        return None
    return ShutterCode(codes[int(_costs(code_cost, codes).argmin())])


def dnf_problem(
    length_px: float,
    chips: int,
    *,
    open_range: tuple[int, int] | None = None,
    runs: RunLimits | None = None,
) -> SearchProblem:
    """Make DNF's problem: least deconvolution noise for a straight blur of the path's length.

    The deconvolution noise factor of a code is ``sqrt(mean(max|H|^2 / |H|^2))``; since |H| is
    largest at frequency 0, it is the noise of the inverse filter relative to the light that came
    through. A single open chip has the least there is, 1, whatever the light it loses: so the
    noise itself is the objective, which ranks codes of equal light alike.

    Raises
    ------
    ValueError
        If the limits conflict.

    References
    ----------
    Agrawal and Raskar, "Optimal single image capture for motion deblurring", CVPR 2009.
    """
    straight = Trajectory.straight(max(_SHORTEST_PX, float(length_px)))
    return SearchProblem.along(
        straight, chips=chips, open_range=open_range, objective="noise", runs=runs or RunLimits()
    )


def _fitting_runs(limits: Limits) -> NDArray[np.bool_]:
    """Whether a single run of each length may start at each chip, (n + 1, n + 1)."""
    n = limits.chips
    length, first = np.ogrid[: n + 1, : n + 1]
    longest = min(limits.open_range[1], limits.longest)
    fits = (
        (first + length <= n)
        & (length >= max(limits.open_range[0], limits.runs.min_open, 1))
        & (length <= longest)
    )
    return np.asarray(fits, dtype=np.bool_)


def _strobes(chips: int) -> Codes:
    chip = np.arange(chips)
    return np.array(
        [
            (chip % period) < width
            for period in evenly_some(np.arange(2, chips), _PERIODS)
            for width in evenly_some(np.arange(1, period), _WIDTHS)
        ],
        dtype=np.int8,
    )


def _strobes_within(problem: SearchProblem) -> Codes:
    """Strobes of whole pulses within the limits: some widths, numbers of pulses and periods."""
    limits = problem.limits
    n = problem.chips
    low, high = limits.open_range
    pairs = []
    for width in range(limits.runs.min_open, limits.longest + 1):
        shortest = max(limits.runs.min_period, width + limits.runs.min_closed)
        most_pulses = 1 + (n - width) // shortest
        first = max(2, -(-low // width))
        last = min(most_pulses, high // width, limits.runs.max_pulses or most_pulses)
        pairs += [(width, pulses) for pulses in range(first, last + 1)]
    codes = []
    for width, pulses in (pairs[index] for index in evenly_some(np.arange(len(pairs)), _PAIRS)):
        shortest = max(limits.runs.min_period, width + limits.runs.min_closed)
        longest = (n - width) // (pulses - 1)
        for period in evenly_some(np.arange(shortest, longest + 1), _PERIODS_WITHIN):
            code = np.zeros(n, dtype=np.int8)
            code[(np.arange(pulses)[:, None] * period + np.arange(width)).ravel()] = 1
            codes.append(code)
    strobes = np.array(codes, dtype=np.int8).reshape(-1, n)
    return strobes[problem.satisfied(strobes)]


def evenly_some(values: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Return all values, or ``count`` of them evenly spread."""
    return values[
        np.unique(np.linspace(0, len(values) - 1, min(len(values), count)).round().astype(np.intp))
    ]


def _costs(code_cost: CodeCost, codes: Codes) -> FloatArray:
    step = max(1, _BATCH // code_cost.rows[0].size)
    return np.concatenate(
        [code_cost.cost_of(codes[i : i + step]) for i in range(0, len(codes), step)]
    )
