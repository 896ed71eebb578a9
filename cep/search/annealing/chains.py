"""Chains of the search side by side: each cools once, or walks again and again, on its own thread."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from threading import Event

import numpy as np
from numpy.typing import NDArray

from cep.search.annealing.cooling import cool
from cep.search.annealing.states import found_by, new_chain, own_tables, refresh
from cep.search.annealing.tables import limits_of, work_space
from cep.search.annealing.terms import Tables
from cep.search.annealing.walking import walk
from cep.search.problem import SearchProblem

__all__ = ["Cooling", "Crew", "Walks"]

Codes = NDArray[np.int8]
_COOL_SLICE, _WALK_SLICE = 4096, 16  # moves and steps until the OTF is summed anew and its frequencies sorted
_TICK_S = 0.1  # between two looks of the caller
_PATIENCE = 32  # steps without a better code before a walk ends
_KEPT = 64  # walks of a chain whose ends are offered: another objective may judge them
_KICK = (3, 9)  # swaps that start a walk from one of the best
_FRESH = 0.8  # share of walks that start from a random code: docs/decisions/search.md


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
    """

    def __init__(
        self, problem: SearchProblem, tables: Tables, free: NDArray[np.intp], *, threads: int | None = None
    ) -> None:
        self._problem, self._tables, self._free = problem, tables, free.astype(np.int64)
        self._limits = limits_of(problem)
        self._threads = threads or os.cpu_count() or 1

    def run(
        self, plans: Sequence[Cooling | Walks], tick: Callable[[int], bool], offer: Callable[[Codes], None]
    ) -> None:
        """Run the plans, and offer the codes that each chain found best, in the plans' order, whatever ends them.

        Parameters
        ----------
        plans : sequence of Cooling and Walks
        tick : callable
            Called about ten times a second with the moves made since the last call; False stops the chains. It may
            raise.
        offer : callable
            Called with (R, n) codes of every chain.
        """
        stop, made = Event(), [0] * len(plans)

        def one(index: int, plan: Cooling | Walks) -> Codes:
            steps = self._cooling(plan) if isinstance(plan, Cooling) else self._walks(plan)
            best: Codes = np.empty((0, self._problem.chips), np.int8)
            for moves, codes in steps:
                made[index] += moves
                best = codes[self._problem.satisfied(codes)]
                if stop.is_set():
                    break
            return best

        with ThreadPoolExecutor(self._threads) as pool:
            jobs: list[Future[Codes]] = [pool.submit(one, index, plan) for index, plan in enumerate(plans)]
            try:
                told, waiting = 0, set(jobs)
                while waiting:
                    _, waiting = wait(waiting, timeout=_TICK_S, return_when=FIRST_COMPLETED)
                    now = sum(made)
                    if not tick(now - told):
                        break
                    told = now
            finally:
                stop.set()
                for job in jobs:
                    offer(job.result())

    def _cooling(self, plan: Cooling) -> Iterator[tuple[int, Codes]]:
        """Yield the moves made and the best codes after every slice."""
        tables, work = own_tables(self._tables), work_space(self._tables, self._problem)
        chain = new_chain(tables, plan.code, plan.seed)
        ratio, done = plan.cold_db / plan.hot_db, 0
        deepest: list[Codes] = []
        while done < plan.moves:
            refresh(tables, chain, self._problem.chips)
            count = min(_COOL_SLICE, plan.moves - done)
            heat = [plan.hot_db * ratio ** (move / plan.moves) for move in (done, done + count)]
            cool(tables, self._limits, chain, self._free, work, np.array(heat), count)
            done += count
            # of every slice: what is deepest on the search's samples need not be so in between
            deepest = [*deepest, found_by(chain)][-_KEPT:]
            chain.cost[2] = 0.0
            yield count, np.concatenate([chain.best[None], *deepest])

    def _walks(self, plan: Walks) -> Iterator[tuple[int, Codes]]:
        tables, work = own_tables(self._tables), work_space(self._tables, self._problem)
        rng = np.random.default_rng(plan.seed)
        done = 0
        kept: list[tuple[float, Codes]] = []
        while done < plan.moves:
            chain = new_chain(tables, self._kicked(plan.pool, rng), int(rng.integers(1, 2**62)))
            held, step, since = np.zeros(self._problem.chips, np.int64), 1, 0
            while since < _PATIENCE and done < plan.moves:
                refresh(tables, chain, self._problem.chips)
                before = chain.cost[1]
                judged = walk(tables, self._limits, chain, self._free, work, held, step, _WALK_SLICE)
                step, done = step + _WALK_SLICE, done + judged
                since = 0 if chain.cost[1] < before else since + _WALK_SLICE
                now = sorted([*kept, (float(chain.cost[1]), found_by(chain))], key=lambda entry: entry[0])[:_KEPT]
                yield judged, np.concatenate([codes for _, codes in now])
                if not judged:
                    return
            kept = now

    def _kicked(self, pool: Codes, rng: np.random.Generator) -> Codes:
        if rng.random() < _FRESH:
            drawn: Codes = self._problem.random_codes(1, rng=rng)[0].astype(np.int8)
            return drawn
        code: Codes = pool[int(rng.integers(len(pool)))].copy()
        opened, closed = self._free[code[self._free] == 1], self._free[code[self._free] == 0]
        swaps = min(int(rng.integers(*_KICK)), opened.size, closed.size)
        code[rng.choice(opened, swaps, replace=False)] = 0
        code[rng.choice(closed, swaps, replace=False)] = 1
        return code
