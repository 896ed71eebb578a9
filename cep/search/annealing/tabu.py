"""Tabu walks: always the best move, even to a worse code, and not back to chips just moved.

The terms of a move are summed only as far as it can still be the best one of its step.

References
----------
Gallardo, Cotta and Fernandez, "Finding low autocorrelation binary sequences with memetic
algorithms", Applied Soft Computing 2009: tabu search with short random tenures and restarts on a
problem of the same kind.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.search.annealing.proposals import Limits, keeps_runs, uniform
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
_SLICE = 16  # steps until the OTF is summed anew: each judges all flips and swaps
_PATIENCE = 32  # steps without a better code before a walk ends
_OFFERED = 64  # walks whose ends are offered: an exact objective ranks them
_KICK = (3, 9)  # swaps that start a walk from one of the best
_FRESH = 0.8  # share of walks that start from a random code: docs/decisions/search.md
# steps that a moved chip stays where it is, at least, and drawn on top: a constant number cycles
_TENURE = 4
_SPREAD = 12


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


def walk_often(problem: SearchProblem, tables: Tables, plan: Walks) -> Iterator[tuple[int, Codes]]:
    """Yield the moves judged and the (R, n) best codes after every slice of a walk.

    Parameters
    ----------
    problem : SearchProblem
    tables : Tables
    plan : Walks
    """
    tables = own_tables(tables)
    limits = Limits.of(problem)
    work = work_space(tables, problem)
    rng = np.random.default_rng(plan.seed)
    moves = 0
    finished: list[tuple[float, Codes]] = []
    while moves < plan.moves:
        start = _start(problem, plan.pool, rng)
        chain = new_chain(tables, start, int(rng.integers(1, 2**62)))
        tabu_until = np.zeros(problem.chips, np.int64)
        step = 1
        since = 0
        while since < _PATIENCE and moves < plan.moves:
            refresh(tables, chain, problem.chips)
            before = chain.best_cost[0]
            step_moves = walk(tables, limits, chain, work, tabu_until, step, _SLICE)
            step += _SLICE
            moves += step_moves
            since += _SLICE
            if chain.best_cost[0] < before:
                since = 0  # patience starts again
            ranked = sorted(
                [*finished, (float(chain.best_cost[0]), best_codes(chain))],
                key=lambda entry: entry[0],
            )[:_OFFERED]
            yield step_moves, np.concatenate([codes for _, codes in ranked])
            if not step_moves:
                return
        finished = ranked


def _start(problem: SearchProblem, pool: Codes, rng: np.random.Generator) -> Codes:
    """Draw a random code, or swap a few chips of one of the best."""
    if rng.random() < _FRESH:
        fresh: Codes = problem.random_codes(1, rng=rng)[0].astype(np.int8)
        return fresh
    code: Codes = pool[int(rng.integers(len(pool)))].copy()
    open_chips = np.flatnonzero(code == 1)
    closed_chips = np.flatnonzero(code == 0)
    swaps = min(int(rng.integers(*_KICK)), open_chips.size, closed_chips.size)
    code[rng.choice(open_chips, swaps, replace=False)] = 0
    code[rng.choice(closed_chips, swaps, replace=False)] = 1
    return code


@compiled
def walk(
    tables: Any,
    limits: Any,
    chain: Any,
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
    work : (3, 64) float32 or None
        Of :func:`cep.search.annealing.terms.work_space`.
    tabu_until : (chips,) int64
        Step until which each chip stays; changed in place.
    first : int
        Number of the first step.
    steps : int
    """
    code = chain.code
    otf = chain.otf
    random = chain.random
    best_cost = chain.best_cost
    rows = tables.rows
    sums = np.empty((tables.kinds.size, tables.layout.shape[0], 2))
    changed = np.empty(2, np.int64)
    picked = np.zeros((2, 3), np.int64)
    best = np.zeros(2, np.int64)
    variants = rows.shape[1]
    early = one_sum_decides(tables)
    open_chips = int(code.sum())
    moves = 0
    for step in range(first, first + steps):
        record = sum_of_cost(tables, best_cost[0]) if early else np.inf
        lowest = np.inf
        ceiling = np.inf
        best_count = 0
        for i in range(len(code)):
            # j = i is a flip, any other j a swap of two unlike chips
            for j in range(i, len(code)):
                if i == j:
                    if not limits.low <= open_chips + 1 - 2 * code[i] <= limits.high:
                        continue
                elif code[i] == code[j]:
                    continue
                # a move that is held counts if it leads where the walk has never been
                to_beat = lowest
                limit = ceiling
                if (tabu_until[i] > step or tabu_until[j] > step) and best_cost[0] < lowest:
                    to_beat = best_cost[0]
                    limit = record
                changed[0], changed[1] = i, j
                count = 1 if i == j else 2
                more = turn(code, changed, count, limits.chips, variants, picked)
                cost = np.inf
                if not limits.constrained or keeps_runs(code, limits):
                    moves += 1
                    if judge(
                        tables,
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
        chain.cost[0] = lowest
        note_best(tables, chain)
    return moves
