"""Search of a code by annealing or a count of all codes, and the description of it in files.

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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import anneal, standard_moves
from cep.search.baselines import find_baselines
from cep.search.cost import CodeCost
from cep.search.exhaustive.exact import ExactResult, ProofLog, codes_to_count, exact
from cep.search.limits import nearest
from cep.search.optima import proven_optimum, proven_starts
from cep.search.problem import SearchProblem
from cep.search.search_result import Baseline, SearchResult

STANDARD_TIME_S = 60.0
"""Limit of an annealing that is given neither moves nor a time, seconds."""


_LEAST_SHARE = 0.5  # of the time limit that the annealing has, however long the baselines take


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """How a code is searched.

    Attributes
    ----------
    method : {"anneal", "exact"}
    steps : int, optional
        Moves of an annealing. The same seed and moves give the same code, unless the time ends the
        search.
    time_s : float, optional
        Limit of an annealing, seconds; a proof runs to its end. With a time alone the annealing
        goes on for it, however many moves that are; without moves or a time it makes as many as
        suit the problem, for :data:`STANDARD_TIME_S` at most.
    seed : int

    Raises
    ------
    ValueError
        If the method is another, the time is not above 0, or moves or a time are
        given for a proof.
    """

    method: Literal["anneal", "exact"] = "anneal"
    steps: int | None = None
    time_s: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.method not in ("anneal", "exact"):
            raise ValueError(f"method: must be anneal or exact, got {self.method!r}")
        if self.time_s is not None and not self.time_s > 0:
            raise ValueError(f"time_s: must be above 0 seconds, got {self.time_s}")
        for name in ("steps", "time_s"):
            if self.method == "exact" and getattr(self, name) is not None:
                raise ValueError(
                    f"{name}: not valid with method='exact', which judges every code there is"
                )

    @property
    def limit_s(self) -> float:
        """Limit of an annealing, seconds; infinite where only its moves are given."""
        if self.time_s is not None:
            return self.time_s
        if self.steps is None:
            return STANDARD_TIME_S
        return math.inf

    def moves(self, problem: SearchProblem) -> int | None:
        """Say how many moves an annealing makes; None where the time alone ends it."""
        if self.steps is None and self.time_s is None:
            return standard_moves(problem)
        return self.steps


def searched_problem(problem: SearchProblem) -> SearchProblem:
    """Reduce to the unit circle a problem where only the code's polynomial matters."""
    # |H| = |sinc| |P|: the largest min |P| holds for any speed, and has exact proofs
    if problem.on_circle and problem.objective == "min-mtf" and problem.frames == 1:
        return replace(problem, scenarios=())
    return problem


def search_code(
    problem: SearchProblem,
    how: SearchOptions,
    *,
    rng: np.random.Generator | None = None,
    length_px: float | None = None,
    threads: int | None = None,
    progress: Callable[[float, ShutterCode], None] | None = None,
) -> SearchResult:
    """Search a code, or count all codes for the best; a limit or Ctrl-C returns the best so far.

    Where a bundled proof covers the problem, its code is returned without a search.

    Parameters
    ----------
    problem : SearchProblem
    how : SearchOptions
        What the baselines take counts against the time, but for the half of it that an annealing
        has in any case.
    rng : numpy Generator, optional
        Made of the seed of ``how`` when omitted.
    length_px : float, optional
        Of the path, for the length-only code among the baselines; of the problem's when omitted.
    threads : int, optional
        As many as there are cores when omitted; the code does not depend on it.
    progress : callable, optional
        Called with the fraction done and the best code so far.

    Returns
    -------
    SearchResult
        No baseline within the limits has a lower cost. Along a path a proof is over the band's
        samples, though: it stands, whatever a baseline is worth between them.

    Raises
    ------
    ValueError
        If the problem is not one that the method solves.
    """
    rng = rng or np.random.default_rng(how.seed)
    started = time.monotonic()
    if how.method == "exact":
        proven: ExactResult | None = exact(problem, threads=threads, progress=progress)
    else:
        proven = proven_optimum(problem)
    for_baselines = rng
    if proven is None:
        # the search's draws must not depend on how many the baselines take
        for_baselines, rng = rng.spawn(2)
    judge = CodeCost.fine(problem)
    rivals: list[Baseline] = []
    interrupted = False
    try:
        for baseline in find_baselines(
            problem,
            rng=for_baselines,
            judge=judge,
            length_px=length_px,
            time_s=how.limit_s,
            threads=threads,
        ):
            rivals.append(baseline)
    except KeyboardInterrupt:
        interrupted = True
    if proven is not None:
        return _proven_outcome(problem, proven, judge, rivals)
    if interrupted:
        # before the annealing: any code within the limits, if no baseline keeps them
        code = ShutterCode(problem.random_codes(1, rng=rng)[0])
        result = SearchResult(code, judge.exact_cost(code), 0.0, 0, "interrupted")
    else:
        left_s = how.limit_s - (time.monotonic() - started)
        result = anneal(
            problem,
            rng=rng,
            steps=how.moves(problem),
            time_s=max(left_s, _LEAST_SHARE * how.limit_s),
            start=[*_starts(problem, rivals), *proven_starts(problem)],
            progress=progress,
            threads=threads,
            judge=judge,
        )
    code, cost_db = _best_of(result.code, result.objective, rivals)
    seconds = time.monotonic() - started
    return replace(result, code=code, objective=cost_db, seconds=seconds, baselines=tuple(rivals))


def _proven_outcome(
    problem: SearchProblem, proven: ExactResult, judge: CodeCost, rivals: Sequence[Baseline]
) -> SearchResult:
    """Return what a count of all codes came to; where Ctrl-C ended it, a rival may be better."""
    code = proven.code
    cost_db = judge.exact_cost(code)
    # a proven code stands, though along a path a baseline may be better between the samples
    if not proven.proven:
        code, cost_db = _best_of(code, cost_db, rivals)
    counted = 0  # by a proof that comes with the package
    if isinstance(proven.proof, ProofLog):
        counted = codes_to_count(problem)
    return SearchResult(
        code,
        cost_db,
        proven.seconds,
        counted,
        "proven" if proven.proven else "interrupted",
        tuple(rivals),
        asdict(proven.proof),
    )


def _starts(problem: SearchProblem, rivals: Iterable[Baseline]) -> list[ShutterCode]:
    """Return the baselines within the limits, and the nearest codes to the others."""
    codes = []
    for baseline in rivals:
        if baseline.within_limits:
            codes.append(ShutterCode(baseline.code.array != 0))
            continue
        # None where the walk's table would be too large: that start is left out
        bits = nearest(problem.limits, baseline.code.array != 0)
        if bits is not None:
            codes.append(ShutterCode(bits))
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


def described_search(
    problem: SearchProblem, how: SearchOptions, *, steps: int, stopped: str
) -> dict[str, Any]:
    """Describe a problem, how it was searched and how that ended, as a code file does."""
    return {
        "chips": problem.chips,
        **asdict(problem.runs),
        "frames": problem.frames,
        "open_range": problem.open_limits,
        "objective": problem.objective,
        "direction": problem.direction,
        "rule": problem.rule,
        "camera": problem.camera.to_dict(),
        "scene": asdict(problem.scene),
        "device": problem.device and problem.device.to_dict(),
        "method": how.method,
        "seed": how.seed,
        "steps": steps,
        "stopped": stopped,
    }


def ended_early(how: SearchOptions, stopped: str, moves: int | None) -> list[str]:
    """Warn of a search that Ctrl-C or the time ended before its ``moves``."""
    if stopped == "interrupted":
        run = {"anneal": "search", "exact": "proof"}[how.method]
        return [f"the {run} was stopped early, this is the best code so far"]
    # an annealing that is given a time alone always ends by it
    if stopped == "time" and moves is not None:
        return [
            f"the limit of {how.limit_s:g} s ended the search before its {moves:,} moves: another"
            " run may give another code"
        ]
    return []
