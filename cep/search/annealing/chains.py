"""Parallel chains of the search: simulated annealing and tabu walks, each on its own thread.

The cost of a move is summed only as far as it can still beat the best one of the step: most are
refused early.

References
----------
Gallardo, Cotta and Fernandez, "Finding low autocorrelation binary sequences with memetic
algorithms", Applied Soft Computing 2009: tabu search with short random tenures and restarts on a
problem of the same kind.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.search.annealing.proposals import Limits, draw_any, draw_blocks, keeps_runs, uniform
from cep.search.annealing.states import found_by, new_chain, own_tables, refresh, smallest_power
from cep.search.annealing.sweeps import Sweeps, SweepTables, sweeps
from cep.search.annealing.terms import (
    Tables,
    add_rows,
    decibels,
    judge,
    one_sum_decides,
    sum_of_cost,
    turn,
    work_space,
)
from cep.search.objectives.criterion import STEEP
from cep.search.problem import SearchProblem

Codes = NDArray[np.int8]
_COOL_SLICE = 4096  # moves until the OTF is summed anew and its frequencies sorted
_WALK_SLICE = 16  # steps of a walk until the same: each judges all flips and swaps
_TICK_S = 0.1  # between two looks of the caller
_PATIENCE = 32  # steps without a better code before a walk ends
_KEPT = 64  # walks of a chain whose ends are offered: an exact objective ranks them
_KICK = (3, 9)  # swaps that start a walk from one of the best
_FRESH = 0.8  # share of walks that start from a random code: docs/decisions/search.md
# steps that a moved chip stays where it is, at least, and drawn on top: a constant number cycles
_TENURE = 4
_SPREAD = 12


@dataclass(frozen=True)
class Cooling:
    """One annealing chain.

    Attributes
    ----------
    code : (n,) int8
        Where it starts.
    hot_db, cold_db : float
        Temperatures at the first and after the last move.
    moves : int
    seed : int
    """

    code: Codes
    hot_db: float
    cold_db: float
    moves: int
    seed: int


@dataclass(frozen=True)
class Walks:
    """Tabu walks one after the other, from random codes and from kicked copies of the best.

    Attributes
    ----------
    pool : (R, n) int8
        The best so far.
    moves : int
        Moves to judge in all.
    seed : int
    """

    pool: Codes
    moves: int
    seed: int


class Crew:
    """Threads that run chains of one problem.

    Parameters
    ----------
    problem : SearchProblem
    tables : Tables
        Of the search's coarse samples.
    free : (M,) int
        Chips that may change.
    threads : int, optional
        As many as the processor has cores when omitted. The outcome does not depend on it.
    sweeping : SweepTables, optional
        For plans that sweep.
    """

    def __init__(
        self,
        problem: SearchProblem,
        tables: Tables,
        free: NDArray[np.intp],
        *,
        threads: int | None = None,
        sweeping: SweepTables | None = None,
    ) -> None:
        self._problem = problem
        self._tables = tables
        self._free = free.astype(np.int64)
        self._sweeping = sweeping
        self._limits = Limits.of(problem)
        self._threads = threads or os.cpu_count() or 1

    def run(
        self,
        plans: Sequence[Cooling | Walks | Sweeps],
        tick: Callable[[int], bool],
        offer: Callable[[Codes], None],
    ) -> None:
        """Run the plans, and offer each chain's best codes, whatever ends them.

        Parameters
        ----------
        plans : sequence of Cooling, Walks and Sweeps
        tick : callable
            Called about ten times a second with the moves made since the last call; False stops
            the chains. It may raise.
        offer : callable
            Called with (R, n) codes of every chain.
        """
        stop = Event()
        moves_made = [0] * len(plans)

        def run_plan(index: int, plan: Cooling | Walks | Sweeps) -> Codes:
            best: Codes = np.empty((0, self._problem.chips), np.int8)
            for moves, codes in self._steps(plan):
                moves_made[index] += moves
                best = codes[self._problem.satisfied(codes)]
                if stop.is_set():
                    break
            return best

        with ThreadPoolExecutor(self._threads) as pool:
            jobs: list[Future[Codes]] = [
                pool.submit(run_plan, index, plan) for index, plan in enumerate(plans)
            ]
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
                # in the plans' order, so that the outcome does not depend on who is faster
                for job in jobs:
                    offer(job.result())
            if (late := sum(moves_made) - reported) > 0:  # a stopped chain ends its slice first
                tick(late)

    def _steps(self, plan: Cooling | Walks | Sweeps) -> Iterator[tuple[int, Codes]]:
        if isinstance(plan, Sweeps):
            assert self._sweeping is not None
            return sweeps(self._problem, self._sweeping, plan)
        if isinstance(plan, Cooling):
            return self._cooling(plan)
        return self._walks(plan)

    def _cooling(self, plan: Cooling) -> Iterator[tuple[int, Codes]]:
        """Yield the moves made and the best codes after every slice."""
        tables = own_tables(self._tables)
        work = work_space(self._tables, self._problem)
        chain = new_chain(tables, plan.code, plan.seed)
        ratio = plan.cold_db / plan.hot_db
        moves = 0
        deepest: list[Codes] = []
        while moves < plan.moves:
            refresh(tables, chain, self._problem.chips)
            count = min(_COOL_SLICE, plan.moves - moves)
            heat = [plan.hot_db * ratio ** (move / plan.moves) for move in (moves, moves + count)]
            cool(tables, self._limits, chain, self._free, work, np.array(heat), count)
            moves += count
            # of every slice: what is deepest on the search's samples need not be so in between
            deepest = [*deepest, found_by(chain)][-_KEPT:]
            chain.cost[2] = 0.0
            yield count, np.concatenate([chain.best[None], *deepest])

    def _walks(self, plan: Walks) -> Iterator[tuple[int, Codes]]:
        tables = own_tables(self._tables)
        work = work_space(self._tables, self._problem)
        rng = np.random.default_rng(plan.seed)
        moves = 0
        finished: list[tuple[float, Codes]] = []
        while moves < plan.moves:
            chain = new_chain(tables, self._kicked(plan.pool, rng), int(rng.integers(1, 2**62)))
            tabu_until = np.zeros(self._problem.chips, np.int64)
            step = 1
            since = 0
            while since < _PATIENCE and moves < plan.moves:
                refresh(tables, chain, self._problem.chips)
                before = chain.cost[1]
                step_moves = walk(
                    tables, self._limits, chain, self._free, work, tabu_until, step, _WALK_SLICE
                )
                step = step + _WALK_SLICE
                moves = moves + step_moves
                since += _WALK_SLICE
                if chain.cost[1] < before:
                    since = 0  # patience starts again
                ranked = sorted(
                    [*finished, (float(chain.cost[1]), found_by(chain))],
                    key=lambda entry: entry[0],
                )[:_KEPT]
                yield step_moves, np.concatenate([codes for _, codes in ranked])
                if not step_moves:
                    return
            finished = ranked

    def _kicked(self, pool: Codes, rng: np.random.Generator) -> Codes:
        if rng.random() < _FRESH:
            fresh: Codes = self._problem.random_codes(1, rng=rng)[0].astype(np.int8)
            return fresh
        code: Codes = pool[int(rng.integers(len(pool)))].copy()
        open_chips = self._free[code[self._free] == 1]
        closed_chips = self._free[code[self._free] == 0]
        swaps = min(int(rng.integers(*_KICK)), open_chips.size, closed_chips.size)
        code[rng.choice(open_chips, swaps, replace=False)] = 0
        code[rng.choice(closed_chips, swaps, replace=False)] = 1
        return code


@compiled
def walk(
    tables: Any,
    limits: Any,
    chain: Any,
    free: NDArray[np.int64],
    work: Any,
    tabu_until: NDArray[np.int64],
    first: int,
    steps: int,
) -> int:
    """Take ``steps`` steps; returns the number of moves judged.

    Parameters
    ----------
    tables : Tables
    limits : Limits
    chain : Chain
    free : (M,) int64
        Chips that may change.
    work : (3, 64) float32 or None
        Of :func:`cep.search.annealing.terms.work_space`.
    tabu_until : (chips,) int64
        Step until which each chip stays; changed in place.
    first : int
        Number of the first step.
    steps : int
    """
    # out of their tuples once: doing it for every move would cost more than the sums
    code = chain.code
    otf = chain.otf
    random = chain.random
    costs = chain.cost
    rows = tables.rows
    layout = tables.layout
    kinds = tables.kinds
    scale = tables.scale
    offset = tables.offset
    light = tables.light
    sums = np.empty((kinds.size, layout.shape[0], 2))
    changed = np.empty(2, np.int64)
    picked = np.zeros((2, 3), np.int64)
    best = np.zeros(2, np.int64)
    variants = rows.shape[1]
    early = one_sum_decides(tables)
    steep = kinds[0] == STEEP
    open_chips = int(code.sum())
    moves = 0
    for step in range(first, first + steps):
        record = sum_of_cost(tables, costs[1]) if early else np.inf
        lowest = np.inf
        ceiling = np.inf
        best_count = 0
        for a in range(len(free)):
            # b = a is a flip, any other b a swap of two unlike chips
            for b in range(a, len(free)):
                i = free[a]
                j = free[b]
                if a == b:
                    if not limits.low <= open_chips + 1 - 2 * code[i] <= limits.high:
                        continue
                elif code[i] == code[j]:
                    continue
                # a move that is held counts if it leads where the walk has never been
                to_beat = lowest
                limit = ceiling
                if (tabu_until[i] > step or tabu_until[j] > step) and costs[1] < lowest:
                    to_beat = costs[1]
                    limit = record
                changed[0], changed[1] = i, j
                count = 1 if a == b else 2
                more = turn(code, changed, count, limits.chips, variants, picked)
                cost = np.inf
                if not limits.constrained or keeps_runs(code, limits):
                    moves += 1
                    if judge(
                        rows,
                        layout,
                        kinds,
                        scale,
                        offset,
                        light,
                        otf,
                        picked,
                        count,
                        limits.chips,
                        open_chips + more,
                        limit,
                        work,
                        sums,
                    ):
                        cost = decibels(tables, sums, open_chips + more)
                for c in range(count):
                    code[changed[c]] = 1 - code[changed[c]]
                if cost < to_beat:
                    lowest, best_count, best[0], best[1] = cost, count, i, j
                    if early:
                        ceiling = sum_of_cost(tables, lowest)
        if best_count == 0:
            break
        open_chips += turn(code, best, best_count, limits.chips, variants, picked)
        add_rows(rows, otf, picked, best_count, limits.chips)
        for c in range(best_count):
            tabu_until[best[c]] = step + _TENURE + int(uniform(random) * _SPREAD)
        costs[0] = lowest
        if lowest < costs[1]:
            costs[1] = lowest
            chain.best[:] = code
        if steep:
            deep = smallest_power(tables, otf)
            if deep > costs[2]:
                costs[2] = deep
                chain.deepest[:] = code
    return moves


@compiled
def cool(
    tables: Any,
    limits: Any,
    chain: Any,
    free: NDArray[np.int64],
    work: Any,
    temperatures: NDArray[np.float64],
    moves: int,
) -> int:
    """Make ``moves`` moves of one chain, cooling geometrically; returns how many were accepted.

    Parameters
    ----------
    tables, limits, chain, free, work
        As of :func:`walk`.
    temperatures : (2,) float64, dB
        At the first move, and after the last.
    moves : int
    """
    code = chain.code
    otf = chain.otf
    random = chain.random
    costs = chain.cost
    rows = tables.rows
    layout = tables.layout
    kinds = tables.kinds
    scale = tables.scale
    offset = tables.offset
    light = tables.light
    sums = np.empty((kinds.size, layout.shape[0], 2))
    changed = np.empty(len(code), np.int64)
    trial = np.empty_like(code)
    picked = np.zeros((max(2, len(code)), 3), np.int64)
    variants = rows.shape[1]
    may_change = np.zeros(len(code), np.bool_)
    may_change[free] = True
    early = one_sum_decides(tables)  # a move is then refused as soon as its sum is too large
    steep = kinds[0] == STEEP
    cooling = (temperatures[1] / temperatures[0]) ** (1.0 / moves)
    temperature = temperatures[0]
    open_chips = int(code.sum())
    accepted = 0
    for _ in range(moves):
        temperature *= cooling
        if limits.constrained:
            count = draw_blocks(code, may_change, limits, open_chips, random, trial, changed)
        else:
            count = draw_any(code, free, limits, open_chips, random, changed)
        if count == 0:
            continue
        more = turn(code, changed, count, limits.chips, variants, picked)
        # Metropolis: the random number comes first, so that it sets what the cost may be
        highest = costs[0] - temperature * np.log(1.0 - uniform(random))
        ceiling = sum_of_cost(tables, highest) if early else np.inf
        cost = np.inf
        if judge(
            rows,
            layout,
            kinds,
            scale,
            offset,
            light,
            otf,
            picked,
            count,
            limits.chips,
            open_chips + more,
            ceiling,
            work,
            sums,
        ):
            cost = decibels(tables, sums, open_chips + more)
        if not cost <= highest:
            for c in range(count):
                code[changed[c]] = 1 - code[changed[c]]
            continue
        accepted += 1
        open_chips += more
        costs[0] = cost
        add_rows(rows, otf, picked, count, limits.chips)
        if cost < costs[1]:
            costs[1] = cost
            chain.best[:] = code
        if steep:
            # the sum leads, the plain minimum is what counts
            lowest = smallest_power(tables, otf)
            if lowest > costs[2]:
                costs[2] = lowest
                chain.deepest[:] = code
    return accepted
