"""Simulated annealing of one chain: moves at a temperature that falls, in a compiled loop.

The terms of a move are summed only as far as it can still be accepted: most are refused early.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.search.annealing.proposals import Limits, draw_any, draw_blocks, uniform
from cep.search.annealing.states import best_codes, new_chain, note_best, own_tables, refresh
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
from cep.search.problem import SearchProblem

Codes = NDArray[np.int8]
_SLICE = 4096  # moves until the OTF is summed anew and its frequencies sorted
_OFFERED = 64  # slices whose deepest codes are offered: an exact objective ranks them


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


def anneal_chain(
    problem: SearchProblem, tables: Tables, plan: Cooling
) -> Iterator[tuple[int, Codes]]:
    """Yield the moves made and the (R, n) best codes after every slice.

    Parameters
    ----------
    problem : SearchProblem
    tables : Tables
    plan : Cooling
    """
    tables = own_tables(tables)
    limits = Limits.of(problem)
    work = work_space(tables, problem)
    free = np.arange(problem.chips)
    chain = new_chain(tables, plan.code, plan.seed)
    ratio = plan.cold_db / plan.hot_db
    moves = 0
    deepest: list[Codes] = []
    while moves < plan.moves:
        refresh(tables, chain, problem.chips)
        count = min(_SLICE, plan.moves - moves)
        heat = [plan.hot_db * ratio ** (move / plan.moves) for move in (moves, moves + count)]
        cool(tables, limits, chain, free, work, np.array(heat), count)
        moves += count
        # of every slice: what is deepest on the search's samples need not be so in between
        deepest = [*deepest, best_codes(chain)][-_OFFERED:]
        chain.deepest_power[0] = 0.0
        yield count, np.concatenate([chain.best[None], *deepest])


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
        Chips that may change: all of the code, or those of one exposure of several.
    work : (3, 64) float32 or None
        Of :func:`cep.search.annealing.terms.work_space`.
    temperatures : (2,) float64, dB
        At the first move, and after the last.
    moves : int
    """
    code = chain.code
    otf = chain.otf
    random = chain.random
    rows = tables.rows
    sums = np.empty((tables.kinds.size, tables.layout.shape[0], 2))
    changed = np.empty(len(code), np.int64)
    trial = np.empty_like(code)
    picked = np.zeros((max(2, len(code)), 3), np.int64)
    variants = rows.shape[1]
    may_change = np.zeros(len(code), np.bool_)
    may_change[free] = True
    early = one_sum_decides(tables)  # a move is then refused as soon as its sum is too large
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
        highest = chain.cost[0] - temperature * np.log(1.0 - uniform(random))
        ceiling = sum_of_cost(tables, highest) if early else np.inf
        cost = np.inf
        if judge(
            tables,
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
        chain.cost[0] = cost
        add_rows(rows, otf, picked, count, limits.chips)
        note_best(tables, chain)
    return accepted
