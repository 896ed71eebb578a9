"""An annealing chain, compiled: propose, judge, accept, ever cooler."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.search.annealing.proposals import draw_any, draw_blocks, uniform
from cep.search.annealing.states import smallest_power
from cep.search.annealing.terms import STEEP, add_rows, alone, decibels, judge, sum_of_cost, turn

__all__ = ["cool"]


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
    tables : Tables
    limits : Limits
    chain : Chain
    free : (M,) int64
        Chips that may change.
    work : (3, 64) float32 or None
        Work space; None where every move is usual (:func:`cep.search.annealing.tables.work_space`), which is faster.
    temperatures : (2,) float64, dB
        At the first move, and after the last.
    moves : int
    """
    code, otf, random, costs = chain.code, chain.otf, chain.random, chain.cost
    rows, layout, kinds = tables.rows, tables.layout, tables.kinds
    scale, offset, light = tables.scale, tables.offset, tables.light
    sums = np.empty((kinds.size, layout.shape[0], 2))
    changed, trial = np.empty(len(code), np.int64), np.empty_like(code)
    picked = np.zeros((max(2, len(code)), 3), np.int64)
    variants = rows.shape[1]
    may_change = np.zeros(len(code), np.bool_)
    may_change[free] = True
    early, steep = alone(tables), kinds[0] == STEEP
    cooling = (temperatures[1] / temperatures[0]) ** (1.0 / moves)
    temperature, opened, accepted = temperatures[0], int(code.sum()), 0
    for _ in range(moves):
        temperature *= cooling
        if limits.constrained:
            count = draw_blocks(code, may_change, limits, opened, random, trial, changed)
        else:
            count = draw_any(code, free, limits, opened, random, changed)
        if count == 0:
            continue
        more = turn(code, changed, count, limits.chips, variants, picked)
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
            opened + more,
            ceiling,
            work,
            sums,
        ):
            cost = decibels(tables, sums, opened + more)
        if not cost <= highest:
            for c in range(count):
                code[changed[c]] = 1 - code[changed[c]]
            continue
        accepted += 1
        opened += more
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
