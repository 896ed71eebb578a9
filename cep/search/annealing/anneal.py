"""Annealing search of a code: rounds of ever longer chains on all cores, then a polish."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import straight_axis
from cep.optics.code import ShutterCode
from cep.search.annealing.chains import Crew
from cep.search.annealing.cooling import Cooling
from cep.search.annealing.polish import Polished, judging_objective, polish
from cep.search.annealing.sweeps import Sweeps, sweep_tables, swept
from cep.search.annealing.tabu import Walks
from cep.search.annealing.terms import lay_out
from cep.search.objective import Objective, sample_count
from cep.search.problem import SearchProblem
from motdiff.types import FloatArray

Codes = NDArray[np.int8]
Progress = Callable[[float, ShutterCode], None]
# temperatures, shares of walks and numbers of moves were measured: docs/decisions/search.md
SEARCH_OVERSAMPLING = 8  # of the moves; what they find is judged on finer samples
_HOT_CHIPS = 52  # these temperatures are for so many chips; fewer are at most so much hotter
_HOTTEST = 4.0
COOLING = 3.0  # hottest over coldest
_WALKS_STRAIGHT = 6  # chains of later rounds that walk instead
_WALKS_OTHERS = 2  # along curves annealing wins
_SHORT = 64  # chips up to which walks find better codes than cooling on straight motion
MOST_SWAPS = 2**12  # chips up to which every neighbour is evaluated in each step
REHEATED = 0.6  # temperature over the hottest, of chains that start from the best codes
_SWEPT = 0.28  # the same of sweeps, all the time
_ELITES = 32  # codes kept for the polish, which evaluates each on the fine grid
_POOL = 8  # of the best, from which walks start
_STANDARD_WORK = 2**33  # moves times frequencies after which more rarely find a better code
# the same number for sweeps, which take the time of a sixteenth of other moves
_SWEPT_MOVES = 2**29
_LEAST_OF_MEAN = 2**16
MOVES_SHARE = 0.9  # of the progress reported: the polish has the remainder
Stopped = Literal["steps", "time", "interrupted", "complete", "proven"]
"""What ended a search: all its moves made, the time limit, Ctrl-C, that no other code keeps the
limits, or a proof."""
_Piece = TypeVar("_Piece")
# of a round: enough for most machines' cores, and the outcome must not depend on their number
CHAINS = 8
_SHORTEST = 2**15  # moves of a chain in the first and the last rounds
_LONGEST = 2**22
_LONGEST_SWEPT = 2**26  # the same in sweeps
# of the time limit, or seconds if that is more: what the polish may take on top
_POLISH_SHARE = 0.1
_POLISH_S = 0.5


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes
    ----------
    code : ShutterCode
    objective : float
        Cost in dB, lower is better, with minima over the continuum; see
        :mod:`cep.search.objective`.
    seconds : float
    steps : int
        Moves tried.
    stopped : {"steps", "time", "interrupted", "complete"}
        Its end: all moves made; the time limit, which makes the outcome depend on the machine;
        Ctrl-C; or that no other code keeps the limits.
    """

    code: ShutterCode
    objective: float
    seconds: float
    steps: int
    stopped: Stopped


@dataclass
class Elites:
    """Best distinct codes seen, or choices of codes, the best first.

    Attributes
    ----------
    cost_of : callable
        Cost (R,) of (R, ...) codes; one that is not finite is left out.
    capacity : int
        Codes kept.
    """

    cost_of: Callable[[Codes], FloatArray]
    capacity: int
    costs: dict[bytes, float] = field(default_factory=dict)

    def offer(self, codes: Codes) -> None:
        """Keep (R, ...) codes as far as they are among the best."""
        for code, cost in zip(codes, self.cost_of(codes), strict=True):
            if np.isfinite(cost):
                self.costs[code.astype(np.int8).tobytes()] = float(cost)
        self.costs = dict(sorted(self.costs.items(), key=lambda item: item[1])[: self.capacity])

    def ranked(self) -> Codes:
        """Return the codes, (R, all their chips)."""
        return np.array([np.frombuffer(key, dtype=np.int8) for key in self.costs])


def anneal(
    problem: SearchProblem,
    *,
    rng: np.random.Generator,
    steps: int | None = 1_000_000,
    time_s: float = 60.0,
    start: Iterable[ShutterCode] = (),
    progress: Progress | None = None,
    threads: int | None = None,
    judge: Objective | None = None,
    moved: Objective | None = None,
    swaps: bool = True,
) -> SearchResult:
    """Search a code; anytime: a limit or Ctrl-C returns the best so far.

    Parameters
    ----------
    problem : SearchProblem
    rng : numpy Generator
        The same seed and ``steps`` give the same code, as long as ``time_s`` is not reached.
    steps : int, optional
        Moves to try, over all chains. None searches for ``time_s``, and is not reproducible.
    time_s : float
        Upper limit of the moves, seconds; ``math.inf`` for none. The closing polish ends at the
        latest a tenth of it, or half a second, later; after Ctrl-C, within half a second.
        Preparing the moves (seconds for a class of motions) and the polish is not included.
    start : iterable of ShutterCode
        Codes to start from besides random ones, such as published ones; those that break a limit
        are left out.
    progress : callable, optional
        Called repeatedly with the fraction done, 0..1, and the best code so far. It may raise
        KeyboardInterrupt.
    threads : int, optional
        As many as there are cores when omitted; the outcome does not depend on it.
    judge : Objective, optional
        The problem's on 64 samples per 1 / extent in float64, where it has been made already.
    moved : Objective, optional
        The problem's on 8 samples per 1 / extent in float32, by which the moves are judged, where
        it has been made already.
    swaps : bool
        Whether the closing polish exchanges open chips for closed ones, besides flipping single
        chips: many times the work.

    Raises
    ------
    ValueError
        If a limit is not positive or a starting code has another length.

    References
    ----------
    Kirkpatrick, Gelatt and Vecchi, "Optimization by simulated annealing", Science 1983.
    """
    started = time.monotonic()
    budget = Budget(steps, time_s, started)
    starts = [code.array for code in start]
    if any(bits.size != problem.chips for bits in starts):
        raise ValueError(f"start: every code must have {problem.chips} chips")
    ranking = coarse = moved or Objective(problem, oversampling=SEARCH_OVERSAMPLING)
    longest = _LONGEST
    if swept(problem):
        # what is best on the coarse samples need not be so between them
        ranking = judge = judge or judging_objective(problem)
        longest = _LONGEST_SWEPT
    elites = Elites(ranking.cost_of, _ELITES)
    seeds = np.array([*starts, problem.random_codes(1, rng=rng)[0]], dtype=np.int8)
    elites.offer(seeds[problem.satisfied(seeds)])
    stopped: Stopped = "complete"

    def tick(moves: int) -> bool:
        budget.moves += moves
        if progress is not None:
            progress(MOVES_SHARE * budget.share(), ShutterCode.from_array(elites.ranked()[0]))
        return budget.elapsed() < time_s

    try:
        if _movable(problem, elites.ranked()[0]):
            crews = _crews(coarse, judge, threads)
            # the samples of a class of motions may take longer than the whole limit
            budget.start_s = time.monotonic()
            round_number = 0
            while budget.remains():
                moves = budget.chain(round_number, longest=longest)
                plans = _plans(problem, elites, moves, rng, first=round_number == 0)
                crews[round_number % len(crews)].run(plans, tick, elites.offer)
                round_number += 1
            stopped = budget.stopped()
    except KeyboardInterrupt:
        stopped = "interrupted"

    def report(piece: Polished, over: bool) -> None:
        if progress is not None:
            progress(1.0 if over else MOVES_SHARE + (1 - MOVES_SHARE) * piece.done, piece.code)

    best = ShutterCode.from_array(elites.ranked()[0])
    fine = judge or judging_objective(problem)
    polished = Polished(best, fine.exact_cost(best), 0.0)
    polished, stopped = budget.polished(
        polished, polish(fine, elites.ranked(), swaps=swaps), report, stopped=stopped
    )
    seconds = time.monotonic() - started
    return SearchResult(polished.code, polished.cost, seconds, budget.moves, stopped)


def standard_moves(problem: SearchProblem) -> int:
    """Return the number of moves after which further ones rarely find a better code."""
    if swept(problem):
        return _SWEPT_MOVES
    columns = sample_count(problem, oversampling=SEARCH_OVERSAMPLING)
    if problem.rule == "mean":
        # every move is judged on every motion, and a class of them leaves few valleys
        return int(np.clip(_STANDARD_WORK // columns, _LEAST_OF_MEAN, 2**25))
    largest = max(criterion.most_moves for criterion, _ in problem.criteria)
    return int(np.clip(_STANDARD_WORK // columns, 2**20, largest))


def hottest_db(problem: SearchProblem) -> float:
    """Temperature, dB, at which a chain from anywhere starts."""
    hot = sum(weight * criterion.hot_db for criterion, weight in problem.criteria)
    # the more chips, the less a move changes
    return float(hot * min(_HOTTEST, (_HOT_CHIPS / problem.chips) ** 1.5))


def _movable(problem: SearchProblem, code: Codes) -> bool:
    """Whether any chip may change: alone, where the light may, or against another."""
    low, high = problem.open_limits
    return low < high or np.unique(code).size == 2


def _crews(coarse: Objective, judge: Objective | None, threads: int | None) -> list[Crew]:
    """Return a crew for the objective, and of a mix one for each of its parts before it."""
    problem = coarse.problem
    sweeping = None
    if judge is not None and swept(problem):
        sweeping = sweep_tables(coarse, judge)
    objectives = [coarse]
    if len(problem.objective_mix) > 1:
        # a part alone is one sum, by which a move is judged many times as fast
        objectives = [*(coarse.instead(name) for name, _ in problem.objective_mix), coarse]
    return [Crew(o.problem, lay_out(o), threads=threads, sweeping=sweeping) for o in objectives]


def _plans(
    problem: SearchProblem, elites: Elites, moves: int, rng: np.random.Generator, *, first: bool
) -> list[Cooling | Walks | Sweeps]:
    """Plan a round: sweeps; or chains that cool, from the best and from anywhere, and walks."""
    hot = hottest_db(problem)
    if swept(problem):
        return [Sweeps(moves, _SWEPT * hot, int(seed)) for seed in rng.integers(1, 2**62, CHAINS)]
    walks = 0
    if not (first or problem.limits_runs or problem.chips**2 // 4 > MOST_SWAPS):
        straight = all(
            straight_axis(scenario.trajectory) is not None for scenario in problem.scenarios
        )
        walks = _WALKS_OTHERS
        if straight and problem.chips <= _SHORT:
            walks = _WALKS_STRAIGHT
    cooled = CHAINS - walks
    codes = problem.random_codes(cooled, rng=rng).astype(np.int8)
    best = elites.ranked()
    # the others from anywhere: starts may all lie in one valley
    leaders = min(len(best), cooled // 2)
    codes[:leaders] = best[:leaders]
    seeds = [int(seed) for seed in rng.integers(1, 2**62, CHAINS)]
    heats = [hot] * cooled
    if not first:
        heats[:leaders] = [REHEATED * hot] * leaders
    chains = [
        Cooling(code, heat, hot / COOLING, moves, seed)
        for code, heat, seed in zip(codes, heats, seeds, strict=False)
    ]
    return [*chains, *(Walks(best[:_POOL], moves, seed) for seed in seeds[cooled:])]


@dataclass
class Budget:
    """Moves and seconds: how much of them is used, and whether any is left."""

    steps: int | None
    time_s: float
    start_s: float
    moves: int = 0

    def __post_init__(self) -> None:
        if self.steps is not None and self.steps < 1:
            raise ValueError(f"steps: must be at least 1, got {self.steps}")
        if not self.time_s > 0:
            raise ValueError(f"time_s: must be above 0 seconds, got {self.time_s}")

    def share(self) -> float:
        """Fraction used, 0..1."""
        of_moves = self.moves / (self.steps or math.inf)
        return min(1.0, max(self.elapsed() / self.time_s, of_moves))

    def elapsed(self) -> float:
        """Seconds since it began."""
        return time.monotonic() - self.start_s

    def remains(self) -> bool:
        """Whether neither the moves nor the time is used up."""
        return self.elapsed() < self.time_s and (self.steps is None or self.moves < self.steps)

    def chain(self, round_number: int, *, longest: int = _LONGEST) -> int:
        """Return the number of moves of each chain of a round."""
        moves: int = min(_SHORTEST << round_number, longest)
        if self.steps is not None:
            return min(moves, -(-(self.steps - self.moves) // CHAINS))
        if not self.moves:
            return moves
        # a chain cut off by the time limit is wasted
        per_second = self.moves / max(self.elapsed(), 1e-3)
        affordable = per_second * (self.time_s - self.elapsed()) / CHAINS
        return max(256, int(min(moves, 0.95 * affordable)))

    def stopped(self) -> Stopped:
        """Return the exhausted limit: the moves, where they and the time ran out together."""
        if self.steps is not None and self.moves >= self.steps:
            return "steps"
        return "time"

    def polished(
        self,
        piece: _Piece,
        pieces: Iterable[_Piece],
        tell: Callable[[_Piece, bool], None],
        *,
        stopped: Stopped,
    ) -> tuple[_Piece, Stopped]:
        """Take the pieces of a closing polish until it ends or must, soon after Ctrl-C.

        Parameters
        ----------
        piece : piece
            Stands where the polish is stopped before its first piece.
        pieces : iterable
            Each the best so far.
        tell : callable
            Called with each piece and False, and at the end with the last one and True. It may
            raise KeyboardInterrupt.
        stopped : {"steps", "time", "interrupted", "complete"}
            Reason of the end of the search so far.

        Returns
        -------
        The last piece, and the reason of the end of the search with its polish.
        """
        ends_s = self.time_s + max(_POLISH_S, _POLISH_SHARE * self.time_s)
        if stopped == "interrupted":
            ends_s = self.elapsed() + _POLISH_S
        try:
            for piece in pieces:
                tell(piece, False)
                if self.elapsed() > ends_s:
                    if stopped == "steps":
                        stopped = "time"
                    break
            tell(piece, True)
        except KeyboardInterrupt:
            stopped = "interrupted"
        return piece, stopped
