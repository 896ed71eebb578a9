"""Codes used instead of a searched one: best snapshot, best strobe, DNF's code, a random code.

All but DNF's are judged by a problem's own objective. The random code keeps its limits, the
snapshot and the strobe keep them on request.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import SearchResult, anneal
from cep.search.limits import Limits, RunLimits
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

Codes = NDArray[np.int8]
_ALL_RUNS_WORK = 2**35  # multiplications that evaluating every snapshot may take: seconds
_LENGTHS = 32  # of snapshots beyond that, before the best one is moved chip by chip
_STARTS = 16
_PERIODS = 64  # of strobes, and widths of each period
_WIDTHS = 32
_PAIRS = 256  # of strobes within limits: widths with numbers of pulses, and periods of each
_PERIODS_WITHIN = 8
_SHORTEST_PX = 1.0  # paths that are shorter are designed for like one of a pixel
_BATCH = 2**21  # numbers evaluated at once: 16 MB


def median_random_code(
    objective: Objective, count: int, *, rng: np.random.Generator
) -> ShutterCode:
    """Draw ``count`` codes within the limits, all equally likely: the one of the median cost.

    Of an even number, the worse of the two in the middle.

    Raises
    ------
    ValueError
        If the count is below 1.
    """
    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")
    codes = objective.problem.random_codes(count, rng=rng)
    order = np.argsort(_costs(objective, codes), kind="stable")
    return ShutterCode.from_array(codes[order[count // 2]])


def best_snapshot(objective: Objective, *, within_limits: bool = False) -> ShutterCode | None:
    """Find the best single open run, of any length and anywhere in the exposure.

    With the objective "mse" its length is the one of least noise for the problem's camera. Every
    run is tried, to hundreds of chips along one motion. Beyond, 32 lengths and 16 starts are
    tried, and the best of these is moved and stretched by single chips while that helps.

    Parameters
    ----------
    objective : Objective
    within_limits : bool
        Whether it must keep the problem's limits.

    Returns
    -------
    ShutterCode or None
        None where no single run keeps the limits.
    """
    n = objective.problem.chips
    limits = objective.problem.limits if within_limits else Limits(n, (1, n))
    fits = _fitting_runs(limits)
    lengths = np.flatnonzero(fits.any(axis=1))
    most_lengths = _LENGTHS
    most_starts = _STARTS
    if np.count_nonzero(fits) * objective.rows.size <= _ALL_RUNS_WORK:
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
        costs = _costs(objective, codes)
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


def best_strobe(objective: Objective, *, within_limits: bool = False) -> ShutterCode | None:
    """Find the best periodic pulses: ``width`` chips open of every ``period``, two or more.

    The first pulse begins with the exposure and the last is cut off with it. Every period and
    width is tried, of long codes 64 periods and 32 widths each. Along a uniform straight motion a
    periodic code has true zeros: "mse" alone is an objective for all motions.

    Parameters
    ----------
    objective : Objective
    within_limits : bool
        Whether it must keep the problem's limits. Then the pulses are whole, and may be fewer than
        there is time for.

    Returns
    -------
    ShutterCode or None
        None where two pulses do not fit, or no strobe that was tried keeps the limits.
    """
    problem = objective.problem
    codes = _strobes_within(problem) if within_limits else _strobes(problem.chips)
    if not len(codes):
        return None
    return ShutterCode.from_array(codes[int(_costs(objective, codes).argmin())])


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
    noise itself is the objective, which ranks codes of equal light alike. Parameters are those of
    :func:`dnf_search`.
    """
    if not (np.isfinite(length_px) and length_px >= 0):
        raise ValueError(f"length_px: must be 0 or more, got {length_px}")
    straight = Trajectory.straight(max(_SHORTEST_PX, float(length_px)))
    return SearchProblem.along(
        straight, chips=chips, open_range=open_range, objective="noise", runs=runs or RunLimits()
    )


def dnf_search(
    length_px: float,
    chips: int,
    *,
    rng: np.random.Generator,
    steps: int | None = 1_000_000,
    time_s: float = 60.0,
    open_range: tuple[int, int] | None = None,
    runs: RunLimits | None = None,
    threads: int | None = None,
) -> SearchResult:
    """Search DNF's code with the project's search, for a straight motion of the given length.

    Parameters
    ----------
    length_px : float, px
        Arc length of the path.
    chips : int
    rng : numpy Generator
    steps, time_s, threads
        As :func:`cep.search.annealing.anneal.anneal` takes them.
    open_range : (int, int), optional
        Fewest and most open chips; any number when omitted.
    runs : RunLimits, optional
        Limits on runs and pulses; none when omitted.

    Raises
    ------
    ValueError
        If the length is negative or not finite, or the problem or the budget is malformed.

    References
    ----------
    Agrawal and Raskar, "Optimal single image capture for motion deblurring", CVPR 2009.
    """
    problem = dnf_problem(length_px, chips, open_range=open_range, runs=runs)
    return anneal(problem, rng=rng, steps=steps, time_s=time_s, threads=threads)


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


def _costs(objective: Objective, codes: Codes) -> FloatArray:
    step = max(1, _BATCH // objective.rows[0].size)
    return np.concatenate(
        [objective.cost_of(codes[i : i + step]) for i in range(0, len(codes), step)]
    )
