"""A tabu walk, compiled: always the best of all flips and swaps, even uphill, but never soon back the way it came.

Where a move is judged only as far as it can still beat the best one seen in the step, most are refused early.

References
----------
Gallardo, Cotta and Fernandez, "Finding low autocorrelation binary sequences with memetic algorithms", Applied Soft
Computing 2009: tabu search with short random tenures and restarts on a problem of the same kind.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.search.annealing.proposals import keeps_runs, uniform
from cep.search.annealing.states import smallest_power
from cep.search.annealing.terms import STEEP, add_rows, alone, decibels, judge, sum_of_cost, turn

__all__ = ["walk"]

_TENURE, _SPREAD = 4, 12  # steps that a moved chip stays where it is: at least, and drawn on top


@compiled
def walk(
    tables: Any,
    limits: Any,
    chain: Any,
    free: NDArray[np.int64],
    work: Any,
    held: NDArray[np.int64],
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
        Work space; None where every move is usual (:func:`cep.search.annealing.tables.work_space`), which is faster.
    held : (chips,) int64
        Step until which each chip stays; changed in place.
    first : int
        Number of the first step.
    steps : int
    """
    code, otf, random, costs = chain.code, chain.otf, chain.random, chain.cost
    rows, layout, kinds = tables.rows, tables.layout, tables.kinds
    scale, offset, light = tables.scale, tables.offset, tables.light
    sums = np.empty((kinds.size, layout.shape[0], 2))
    changed, picked, best = np.empty(2, np.int64), np.zeros((2, 3), np.int64), np.zeros(2, np.int64)
    variants = rows.shape[1]
    early, steep = alone(tables), kinds[0] == STEEP
    opened, judged = int(code.sum()), 0
    for step in range(first, first + steps):
        record = sum_of_cost(tables, costs[1]) if early else np.inf
        lowest, ceiling, taken = np.inf, np.inf, 0
        for a in range(len(free)):
            # b = a is a flip, any other b a swap of two unlike chips
            for b in range(a, len(free)):
                i, j = free[a], free[b]
                if a == b:
                    if not limits.low <= opened + 1 - 2 * code[i] <= limits.high:
                        continue
                elif code[i] == code[j]:
                    continue
                # a move that is held counts if it leads where the walk has never been
                worth, most = lowest, ceiling
                if (held[i] > step or held[j] > step) and costs[1] < lowest:
                    worth, most = costs[1], record
                changed[0], changed[1] = i, j
                count = 1 if a == b else 2
                more = turn(code, changed, count, limits.chips, variants, picked)
                cost = np.inf
                if not limits.constrained or keeps_runs(code, limits):
                    judged += 1
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
                        opened + more,
                        most,
                        work,
                        sums,
                    ):
                        cost = decibels(tables, sums, opened + more)
                for c in range(count):
                    code[changed[c]] = 1 - code[changed[c]]
                if cost < worth:
                    lowest, taken, best[0], best[1] = cost, count, i, j
                    if early:
                        ceiling = sum_of_cost(tables, lowest)
        if taken == 0:
            break
        opened += turn(code, best, taken, limits.chips, variants, picked)
        add_rows(rows, otf, picked, taken, limits.chips)
        for c in range(taken):
            held[best[c]] = step + _TENURE + int(uniform(random) * _SPREAD)
        costs[0] = lowest
        if lowest < costs[1]:
            costs[1] = lowest
            chain.best[:] = code
        if steep:
            deep = smallest_power(tables, otf)
            if deep > costs[2]:
                costs[2] = deep
                chain.deepest[:] = code
    return judged
