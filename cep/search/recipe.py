"""Recipe of a search: baselines, annealing or a count of all codes, and the best of all.

What a code is compared with is computed first. The annealing starts from whatever of it keeps the
problem's limits, and from the nearest code to each other one. The code returned is the best of
what the search found and of what it is compared with, by the problem's objective with its minima
over the continuum. So no code within the limits that a table shows beats it.

On straight motion the proven codes of docs/optima.md are starts as well. Where the proof of one
covers the problem, that code is the answer.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from cep.codes.published import for_chips
from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import Stopped, anneal
from cep.search.exhaustive.exact import codes_to_count, exact
from cep.search.exhaustive.proof import ExactResult, ProofLog
from cep.search.feasibility import nearest
from cep.search.light import best_snapshot, best_strobe, dnf_search, median_random_code
from cep.search.objective import Objective
from cep.search.optima import proven_optimum, proven_starts
from cep.search.problem import SearchProblem

_COARSE = 8  # samples per 1 / extent, to choose a baseline
_FINE = 64  # to judge: between 8 samples a code's |P| may dip unseen, docs/decisions/search.md
_RANDOM_CODES = 15
_LENGTH_ONLY_MOVES = 200_000
_LENGTH_ONLY_SHARE = 0.25  # of the time limit: the only baseline that may take long
_LEAST_SHARE = 0.5  # of the time limit that the annealing has in any case
_WITHIN = " within the limits"


@dataclass(frozen=True)
class Baseline:
    """A code that would be used instead of a searched one.

    Attributes
    ----------
    name : str
        "open shutter", "best snapshot", "best strobe", "published: NAME", "length-only code" or
        "random code, median"; "best snapshot within the limits" and "best strobe within the
        limits" where the best ones break them.
    code : ShutterCode
    cost_db : float
        By the problem's objective, with its minima over the continuum; lower is better.
    within_limits : bool
        Whether the code keeps the problem's limits: others could not be returned, however good
        they are.
    stopped_early : bool
        Whether the time limit or Ctrl-C ended the search of this code: another run may give
        another.
    """

    name: str
    code: ShutterCode
    cost_db: float
    within_limits: bool
    stopped_early: bool = False


@dataclass(frozen=True)
class Found:
    """What a search or a proof came to.

    Attributes
    ----------
    code : ShutterCode
    objective : float
        Cost in dB with minima over the continuum, lower is better.
    steps : int
        Moves tried, or codes counted.
    seconds : float
        The baselines' included.
    stopped : {"steps", "time", "interrupted", "complete", "proven"}
        What ended it: all moves made, the time limit, Ctrl-C, that no other code keeps the limits,
        or a proof.
    baselines : tuple of Baseline
        What the code was compared with: none of them that keeps the limits has a lower cost.
        Ctrl-C may have cut them short.
    proof : dict or None
        Log of the proof; ``file`` names that of a bundled proof.
    """

    code: ShutterCode
    objective: float
    steps: int
    seconds: float
    stopped: Stopped
    baselines: tuple[Baseline, ...]
    proof: dict[str, Any] | None = None


def search_code(
    problem: SearchProblem,
    *,
    rng: np.random.Generator,
    steps: int | None = 1_000_000,
    time_s: float = 60.0,
    start: Iterable[ShutterCode] = (),
    length_px: float | None = None,
    progress: Callable[[float, ShutterCode], None] | None = None,
    threads: int | None = None,
) -> Found:
    """Search a code; anytime: a limit or Ctrl-C returns the best so far.

    Where a bundled proof covers the problem, its code is returned without a search.

    Parameters
    ----------
    problem : SearchProblem
    rng : numpy Generator
        The same seed and ``steps`` give the same code, as long as ``time_s`` is not reached.
    steps, time_s, progress, threads
        Of the annealing, as :func:`cep.search.annealing.anneal.anneal` takes them. What the
        baselines take counts against the time, but for the half of it that the annealing has in
        any case.
    start : iterable of ShutterCode
        Codes to start from besides the baselines.
    length_px : float, optional
        As of :func:`baselines`.

    Raises
    ------
    ValueError
        If a limit is not positive or a starting code has another length.
    """
    optimum = proven_optimum(problem)
    if optimum is not None:
        return prove_code(
            problem,
            rng=rng,
            time_s=time_s,
            length_px=length_px,
            threads=threads,
            proven=optimum,
        )
    started = time.monotonic()
    # the search's draws must not depend on how many the baselines take
    for_baselines, for_search = rng.spawn(2)
    # float64: candidates that are almost as good must not be ranked by rounding
    judge = Objective(problem, oversampling=_FINE, dtype=np.float64)
    rivals: list[Baseline] = []
    try:
        for baseline in baselines(
            problem,
            rng=for_baselines,
            judge=judge,
            length_px=length_px,
            time_s=time_s,
            threads=threads,
        ):
            rivals.append(baseline)
    except KeyboardInterrupt:
        # Ctrl-C before the annealing: any code within the limits, if no baseline keeps them
        code = ShutterCode.from_array(problem.random_codes(1, rng=for_search)[0])
        cost = judge.exact_cost(code)
        moves = 0
        stopped: Stopped = "interrupted"
    else:
        left_s = max(time_s - (time.monotonic() - started), _LEAST_SHARE * time_s)
        searched = anneal(
            problem,
            rng=for_search,
            steps=steps,
            time_s=left_s,
            start=[*_starts(problem, rivals), *proven_starts(problem), *start],
            progress=progress,
            threads=threads,
            judge=judge,
        )
        code = searched.code
        cost = searched.objective
        moves = searched.steps
        stopped = searched.stopped
    code, cost = _best_of(code, cost, rivals)
    return Found(code, cost, moves, time.monotonic() - started, stopped, tuple(rivals))


def prove_code(
    problem: SearchProblem,
    *,
    rng: np.random.Generator,
    time_s: float = math.inf,
    length_px: float | None = None,
    progress: Callable[[float, ShutterCode], None] | None = None,
    threads: int | None = None,
    proven: ExactResult | None = None,
) -> Found:
    """Count all codes for the best; where Ctrl-C stops that, a baseline may be the best yet.

    Parameters
    ----------
    problem : SearchProblem
    rng, time_s, length_px
        Of the baselines, as of :func:`baselines`; the count runs to its end.
    progress, threads
        Of the count, as :func:`cep.search.exhaustive.exact.exact` takes them.
    proven : ExactResult, optional
        Outcome of a count that was made before.

    Raises
    ------
    ValueError
        If the problem is not one that can be counted.
    """
    if proven is None:
        proven = exact(problem, threads=threads, progress=progress)
    judge = Objective(problem, oversampling=_FINE, dtype=np.float64)
    rivals: list[Baseline] = []
    with suppress(KeyboardInterrupt):
        for baseline in baselines(
            problem, rng=rng, judge=judge, length_px=length_px, time_s=time_s, threads=threads
        ):
            rivals.append(baseline)
    code = proven.code
    cost = judge.exact_cost(code)
    stopped: Stopped = "proven"
    # a proven code stands, though along a path a baseline may be better between the samples
    if not proven.proven:
        stopped = "interrupted"
        code, cost = _best_of(code, cost, rivals)
    if isinstance(proven.proof, ProofLog):
        counted = codes_to_count(problem)
    else:
        counted = proven.proof.judged
    return Found(
        code,
        cost,
        counted,
        proven.seconds,
        stopped,
        tuple(rivals),
        proven.proof.to_dict(),
    )


def _starts(problem: SearchProblem, rivals: Iterable[Baseline]) -> list[ShutterCode]:
    """Return the baselines within the limits, and the nearest codes to the others."""
    codes = []
    for baseline in rivals:
        if baseline.within_limits:
            codes.append(ShutterCode.from_array(baseline.code.array != 0))
            continue
        # None where the walk's table would be too large: that start is left out
        bits = nearest(problem.limits, baseline.code.array != 0)
        if bits is not None:
            codes.append(ShutterCode.from_array(bits))
    return codes


def _best_of(
    code: ShutterCode, cost_db: float, rivals: Iterable[Baseline]
) -> tuple[ShutterCode, float]:
    """Return the cheapest, with its cost, of a code and the baselines within the limits."""
    best = min(
        (baseline for baseline in rivals if baseline.within_limits),
        key=lambda baseline: baseline.cost_db,
        default=None,
    )
    if best is None or best.cost_db >= cost_db:
        return code, cost_db
    return best.code, best.cost_db


def baselines(
    problem: SearchProblem,
    *,
    rng: np.random.Generator,
    judge: Objective | None = None,
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
    judge : Objective, optional
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
    """
    judge = judge or Objective(problem, oversampling=_FINE, dtype=np.float64)
    unjudged = _used_instead(problem, rng=rng, length_px=length_px, time_s=time_s, threads=threads)
    for name, code, stopped_early in unjudged:
        yield Baseline(name, code, judge.exact_cost(code), problem.allows(code), stopped_early)


def mean_length_px(problem: SearchProblem) -> float:
    """Mean length of the problem's paths, px; on the unit circle, a px for each chip."""
    lengths_px = [scenario.trajectory.length_px for scenario in problem.scenarios]
    return float(np.mean(lengths_px or [problem.chips]))


def _used_instead(
    problem: SearchProblem,
    *,
    rng: np.random.Generator,
    length_px: float | None,
    time_s: float,
    threads: int | None,
) -> Iterator[tuple[str, ShutterCode, bool]]:
    """Yield the name and the code of each baseline, and whether its search was stopped early."""
    yield "open shutter", ShutterCode("1" * problem.chips), False
    coarse = Objective(problem, oversampling=_COARSE)
    for name, best in (("best snapshot", best_snapshot), ("best strobe", best_strobe)):
        free = best(coarse)
        if free is None:  # two pulses do not fit
            continue
        yield name, free, False
        if problem.allows(free):
            continue
        # the best of all breaks the limits: also the best that could be used
        limited = best(coarse, within_limits=True)
        if limited is not None:
            yield name + _WITHIN, limited, False
    if length_px is None:
        length_px = mean_length_px(problem)
    for entry in for_chips(problem.chips):
        yield f"published: {entry.name}", entry.code, False
    length_only = dnf_search(
        length_px,
        problem.chips,
        rng=rng,
        steps=_LENGTH_ONLY_MOVES,
        time_s=_LENGTH_ONLY_SHARE * time_s,
        threads=threads,
        open_range=problem.open_limits,
        runs=problem.runs,
    )
    yield "length-only code", length_only.code, length_only.stopped in ("time", "interrupted")
    if length_only.stopped == "interrupted":
        raise KeyboardInterrupt
    yield "random code, median", median_random_code(coarse, _RANDOM_CODES, rng=rng), False
