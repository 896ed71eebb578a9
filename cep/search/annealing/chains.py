"""Parallel chains of the search: annealing, tabu walks and sweeps, each on its own thread."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from threading import Event

import numpy as np
from numpy.typing import NDArray

from cep.search.annealing.cooling import Cooling, anneal_chain
from cep.search.annealing.sweeps import Sweeps, SweepTables, sweeps
from cep.search.annealing.tabu import Walks, walk_often
from cep.search.annealing.terms import Tables
from cep.search.problem import SearchProblem

Codes = NDArray[np.int8]
_TICK_S = 0.1  # between two looks of the caller


class Crew:
    """Threads that run chains of one problem.

    Parameters
    ----------
    problem : SearchProblem
    tables : Tables
        Of the search's coarse samples.
    threads : int, optional
        As many as the processor has cores when omitted. The outcome does not depend on it.
    sweeping : SweepTables, optional
        For plans that sweep.
    """

    def __init__(
        self,
        problem: SearchProblem,
        tables: Tables,
        *,
        threads: int | None = None,
        sweeping: SweepTables | None = None,
    ) -> None:
        self._problem = problem
        self._tables = tables
        self._sweeping = sweeping
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
            return anneal_chain(self._problem, self._tables, plan)
        return walk_often(self._problem, self._tables, plan)
