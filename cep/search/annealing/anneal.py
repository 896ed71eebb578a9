"""Annealing search of a code: rounds of ever longer chains on all cores, then a polish."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from threading import Event
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.search.annealing.cooling import anneal_chain
from cep.search.annealing.polish import Polished, polish
from cep.search.annealing.sweeps import can_sweep, sweep_chain, sweep_tables
from cep.search.annealing.terms import lay_out
from cep.search.cost import CodeCost, sample_count
from cep.search.problem import SearchProblem
from cep.search.search_result import SearchResult, Stopped
from motdiff.types import FloatArray

Codes = NDArray[np.int8]
ChainSlices = Iterator[tuple[int, Codes]]
"""A chain: after every slice the moves made in it, and the (R, n) best codes so far."""
Progress = Callable[[float, ShutterCode], None]
# temperatures and numbers of moves were measured: docs/decisions/search.md
SEARCH_OVERSAMPLING = 8  # of the moves; what they find is judged on finer samples
_HOT_CHIPS = 52  # these temperatures are for so many chips; fewer are at most so much hotter
_HOTTEST = 4.0
COOLING = 3.0  # hottest over coldest
REHEATED = 0.6  # temperature over the hottest, of chains that start from the best codes
_SWEPT = 0.28  # the same of sweeps, all the time
_ELITES = 32  # codes kept for the polish, which evaluates each on the fine grid
_STANDARD_WORK = 2**33  # moves times frequencies after which more rarely find a better code
# the same number for sweeps, which take the time of a sixteenth of other moves
_SWEPT_MOVES = 2**29
_LEAST_OF_MEAN = 2**16
MOVES_SHARE = 0.9  # of the progress reported: the polish has the remainder
_Piece = TypeVar("_Piece")
# of a round: enough for most machines' cores, and the outcome must not depend on their number
CHAINS = 8
_SHORTEST = 2**15  # moves of a chain in the first and the last rounds
_LONGEST = 2**22
_LONGEST_SWEPT = 2**26  # the same in sweeps
# of the time limit, or seconds if that is more: what the polish may take on top
_POLISH_SHARE = 0.1
_POLISH_S = 0.5
_TICK_S = 0.1  # between two looks of the caller at running chains


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
    judge: CodeCost | None = None,
    coarse: CodeCost | None = None,
    swaps: bool = True,
) -> SearchResult:
    """Search a code; anytime: a limit or Ctrl-C returns the best so far.

    Parameters
    ----------
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
    judge : CodeCost, optional
        The problem's on 64 samples per 1 / extent in float64, where it has been made already.
    coarse : CodeCost, optional
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
    ranking = coarse = coarse or CodeCost(problem, oversampling=SEARCH_OVERSAMPLING)
    longest = _LONGEST
    if can_sweep(problem):
        # what is best on the coarse samples need not be so between them
        ranking = judge = judge or CodeCost.fine(problem)
        longest = _LONGEST_SWEPT
    elites = Elites(ranking.cost_of, _ELITES)
    seeds = np.array([*starts, problem.random_codes(1, rng=rng)[0]], dtype=np.int8)
    elites.offer(seeds[problem.satisfied(seeds)])
    stopped: Stopped = "complete"

    def offer(codes: Codes) -> None:
        elites.offer(codes[problem.satisfied(codes)])

    def tick(moves: int) -> bool:
        budget.moves += moves
        if progress is not None:
            progress(MOVES_SHARE * budget.share(), ShutterCode(elites.ranked()[0]))
        return budget.elapsed() < time_s

    try:
        low, high = problem.open_limits
        # a chip may change alone where the light may, else against another
        if low < high or np.unique(elites.ranked()[0]).size == 2:
            chains_of_round = _chains(coarse, judge, elites, rng)
            # the samples of a class of motions may take longer than the whole limit
            budget.start_s = time.monotonic()
            round_number = 0
            while budget.remains():
                moves = budget.chain(round_number, longest=longest)
                run_chains(chains_of_round(round_number, moves), tick, offer, threads=threads)
                round_number += 1
            stopped = budget.stopped()
    except KeyboardInterrupt:
        stopped = "interrupted"

    def report(piece: Polished, over: bool) -> None:
        if progress is not None:
            progress(1.0 if over else MOVES_SHARE + (1 - MOVES_SHARE) * piece.done, piece.code)

    best = ShutterCode(elites.ranked()[0])
    fine = judge or CodeCost.fine(problem)
    polished = Polished(best, fine.exact_cost(best), 0.0)
    polished, stopped = budget.polished(
        polished, polish(fine, elites.ranked(), swaps=swaps), report, stopped=stopped
    )
    seconds = time.monotonic() - started
    return SearchResult(polished.code, polished.cost, seconds, budget.moves, stopped)


def standard_moves(problem: SearchProblem) -> int:
    """Return the number of moves after which further ones rarely find a better code."""
    if can_sweep(problem):
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


def _chains(
    coarse: CodeCost, judge: CodeCost | None, elites: Elites, rng: np.random.Generator
) -> Callable[[int, int], list[ChainSlices]]:
    """Lay out tables for the compiled loops; returns what makes the chains of a round.

    It is called with the number of the round and the moves of each chain.
    """
    problem = coarse.problem
    hot = hottest_db(problem)
    if judge is not None and can_sweep(problem):
        sweeping = sweep_tables(coarse, judge)

        def sweep_round(_round_number: int, moves: int) -> list[ChainSlices]:
            return [
                sweep_chain(
                    problem, sweeping, moves=moves, temperature_db=_SWEPT * hot, seed=int(seed)
                )
                for seed in rng.integers(1, 2**62, CHAINS)
            ]

        return sweep_round
    tables = [lay_out(coarse)]
    if len(problem.objective_mix) > 1:
        # a part alone is one sum, by which a move is judged many times as fast
        tables = [*(lay_out(coarse.instead(name)) for name, _ in problem.objective_mix), *tables]

    def cooling_round(round_number: int, moves: int) -> list[ChainSlices]:
        codes = problem.random_codes(CHAINS, rng=rng).astype(np.int8)
        best = elites.ranked()
        # the others from anywhere: starts may all lie in one valley
        leaders = min(len(best), CHAINS // 2)
        codes[:leaders] = best[:leaders]
        heats = [hot] * CHAINS
        if round_number:
            heats[:leaders] = [REHEATED * hot] * leaders
        return [
            anneal_chain(
                problem,
                tables[round_number % len(tables)],
                code,
                temperatures_db=(heat, hot / COOLING),
                moves=moves,
                seed=int(seed),
            )
            for code, heat, seed in zip(codes, heats, rng.integers(1, 2**62, CHAINS), strict=True)
        ]

    return cooling_round


def run_chains(
    chains: Sequence[ChainSlices],
    tick: Callable[[int], bool],
    offer: Callable[[Codes], None],
    *,
    threads: int | None = None,
) -> None:
    """Run chains on threads, and offer the best codes of each, whatever ends them.

    Parameters
    ----------
    chains : sequence of iterators
        As of :data:`ChainSlices`.
    tick : callable
        Called about ten times a second with the moves made since the last call; False stops the
        chains. It may raise.
    offer : callable
        Called with the (R, n) codes of every chain.
    threads : int, optional
        As many as the processor has cores when omitted. The outcome does not depend on it.
    """
    stop = Event()
    moves_made = [0] * len(chains)

    def run_chain(index: int) -> Codes:
        best: Codes | None = None
        for moves, codes in chains[index]:
            moves_made[index] += moves
            best = codes
            if stop.is_set():
                break
        assert best is not None  # a chain makes at least one slice
        return best

    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        jobs = [pool.submit(run_chain, index) for index in range(len(chains))]
        try:
            reported = 0
            waiting = set(jobs)
            while waiting:
                _, waiting = wait(waiting, timeout=_TICK_S, return_when=FIRST_COMPLETED)
                total = sum(moves_made)
                news = total - reported
                reported = total
                if not tick(news):
                    break
        finally:
            stop.set()
            # in the chains' order, so that the outcome does not depend on who is faster
            for job in jobs:
                offer(job.result())
        if (late := sum(moves_made) - reported) > 0:  # a stopped chain ends its slice first
            tick(late)


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

        The last one is returned, and the reason of the end of the search with its polish.

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
