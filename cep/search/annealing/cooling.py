"""One chain of simulated annealing: its state, and compiled moves at a temperature that falls.

The terms of a move are summed only as far as it can still be accepted: most are refused early.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.search.annealing.proposals import LoopLimits, draw_any, draw_blocks, uniform
from cep.search.annealing.terms import (
    BLOCK,
    SMALLEST,
    Tables,
    add_rows,
    decibels,
    judge,
    one_sum_decides,
    sum_of_cost,
    sums_over,
    turn,
    work_space,
)
from cep.search.objectives import FLATNESS, STEEP
from cep.search.problem import SearchProblem

Codes = NDArray[np.int8]
Floats = NDArray[np.float32]
_SLICE = 4096  # moves until the OTF is summed anew and its frequencies sorted
_OFFERED = 64  # slices whose deepest codes are offered: an exact objective ranks them


class Chain(NamedTuple):
    """State of a chain, changed in place: single numbers are arrays of one for that.

    Attributes
    ----------
    code, best, deepest : (chips,) int8
        Where it is, the cheapest code seen, and the one with the largest smallest |P|.
    otf : (frames, nb, 2, 64) float32
    cost, best_cost : (1,) float64, dB
        Of ``code`` and of ``best``.
    deepest_term : (1,) float64
        Smallest x of the terms of ``deepest``, 0 before there is one.
    random : (1,) uint64
        State of the random numbers, not 0.
    """

    code: NDArray[np.int8]
    best: NDArray[np.int8]
    deepest: NDArray[np.int8]
    otf: NDArray[np.float32]
    cost: NDArray[np.float64]
    best_cost: NDArray[np.float64]
    deepest_term: NDArray[np.float64]
    random: NDArray[np.uint64]


@compiled
def fresh_otf(tables: Any, code: NDArray[np.int8], chips: int, otf: Floats) -> None:
    """Recompute a code's OTF: float32 sums drift."""
    for frame in range(otf.shape[0]):
        otf[frame] = tables.start[0]
    variants = tables.rows.shape[1]
    for j in range(len(code)):
        if code[j]:
            # chips open from the first to the last: the left neighbour stands, the right one is
            # closed yet
            variant = 0
            if variants == 4 and j % chips > 0:
                variant = 2 * code[j - 1]
            row = tables.rows[j, variant].ravel()
            changed = otf[j // chips].ravel()
            for f in range(changed.size):
                changed[f] += row[f]


@compiled
def worst_first(tables: Any, otf: Floats) -> None:
    """Sort each part's frequencies in place: the costliest ones reject most moves."""
    rows = tables.rows.reshape((-1, otf.shape[1], 2, BLOCK))
    scale = tables.scale
    offset = tables.offset
    for band in range(len(tables.layout)):
        first = tables.layout[band, 0]
        size = (tables.layout[band, 1] - tables.layout[band, 0]) * BLOCK
        key = np.empty(size, np.float32)
        for place in range(size):
            block = first + place // BLOCK
            f = place % BLOCK
            power = np.float32(SMALLEST)
            for frame in range(otf.shape[0]):
                power += otf[frame, block, 0, f] ** 2 + otf[frame, block, 1, f] ** 2
            # columns that fill up a block have scale 0
            if tables.kinds[0] == FLATNESS:
                key[place] = -scale[0, block, 0, f] / power
            else:
                key[place] = -1 / (scale[0, block, 0, f] * power + offset[0, block, 0, f])
        order = np.argsort(key)
        for table in (rows, otf, scale, offset, tables.start):
            _reorder(table, first, order)


@compiled
def _reorder(table: Floats, first: int, order: NDArray[np.intp]) -> None:
    """Permute the frequencies of a (L, nb, Q, 64) table from a block on, in place."""
    row = np.empty(order.size, np.float32)
    for line in range(table.shape[0]):
        for q in range(table.shape[2]):
            for place in range(order.size):
                row[place] = table[line, first + order[place] // BLOCK, q, order[place] % BLOCK]
            for place in range(order.size):
                table[line, first + place // BLOCK, q, place % BLOCK] = row[place]


@compiled
def total_cost(tables: Any, chips: int, code: NDArray[np.int8], otf: Floats) -> float:
    """Cost, dB, of a code whose OTF (frames, nb, 2, 64) is given."""
    work = np.empty((3, BLOCK), np.float32)
    sums = np.empty((len(tables.kinds), len(tables.layout), 2))
    open_chips = int(code.sum())
    sums_over(tables, otf, np.zeros((2, 3), np.int64), 0, chips, open_chips, np.inf, work, sums)
    return decibels(tables, sums, open_chips)


@compiled
def smallest_term(tables: Any, otf: Floats) -> float:
    """Smallest x of the first objective's terms, which is that of the smallest |P|."""
    lowest = np.float32(np.inf)
    for block in range(otf.shape[1]):
        for f in range(BLOCK):
            power = np.float32(0)
            for frame in range(otf.shape[0]):
                power += otf[frame, block, 0, f] ** 2 + otf[frame, block, 1, f] ** 2
            # columns that only fill up a block have a large offset
            x = tables.scale[0, block, 0, f] * power + tables.offset[0, block, 0, f]
            lowest = min(lowest, x)
    return float(lowest)


@compiled
def note_best(tables: Any, chain: Any) -> None:
    """Keep a chain's code where it costs least so far, or its smallest |P| is the largest."""
    if chain.cost[0] < chain.best_cost[0]:
        chain.best_cost[0] = chain.cost[0]
        chain.best[:] = chain.code
    if tables.kinds[0] == STEEP:
        # the sum leads, the plain minimum is what counts
        lowest = smallest_term(tables, chain.otf)
        if lowest > chain.deepest_term[0]:
            chain.deepest_term[0] = lowest
            chain.deepest[:] = chain.code


def new_chain(tables: Tables, code: NDArray[np.int8], seed: int, *, frames: int = 1) -> Chain:
    """Make a chain at a code, all frames' chips in a row; :func:`refresh` gives it its OTF."""
    otf = np.empty((frames, tables.rows.shape[2], 2, BLOCK), np.float32)
    return Chain(
        code=code.copy(),
        best=code.copy(),
        deepest=code.copy(),
        otf=otf,
        cost=np.array([np.inf]),
        best_cost=np.array([np.inf]),
        deepest_term=np.zeros(1),
        random=np.array([seed | 1], dtype=np.uint64),  # a shift register never leaves 0
    )


def own_tables(tables: Tables) -> Tables:
    """Copy the tables that a chain sorts."""
    return tables._replace(
        rows=tables.rows.copy(),
        scale=tables.scale.copy(),
        offset=tables.offset.copy(),
        start=tables.start.copy(),
    )


def refresh(tables: Tables, chain: Chain, chips: int) -> None:
    """Sum a chain's OTF and cost anew, and sort its own tables, for frames of ``chips`` chips."""
    fresh_otf(tables, chain.code, chips, chain.otf)
    worst_first(tables, chain.otf)
    chain.cost[0] = total_cost(tables, chips, chain.code, chain.otf)
    if chain.cost[0] < chain.best_cost[0]:
        chain.best_cost[0] = chain.cost[0]
        chain.best[:] = chain.code


def best_codes(chain: Chain) -> NDArray[np.int8]:
    """Best codes (R, n) of a chain; the deepest counts for the smallest |H| alone."""
    codes = np.stack([chain.best, chain.deepest])
    return codes[: 1 + (chain.deepest_term[0] > 0)]


def anneal_chain(
    problem: SearchProblem,
    tables: Tables,
    code: Codes,
    *,
    temperatures_db: tuple[float, float],
    moves: int,
    seed: int,
) -> Iterator[tuple[int, Codes]]:
    """Yield the moves made and the (R, n) best codes after every slice of a chain.

    Parameters
    ----------
    code : (n,) int8
        Where it starts.
    temperatures_db : (float, float)
        At the first and after the last move.
    """
    tables = own_tables(tables)
    limits = LoopLimits.of(problem)
    work = work_space(tables, problem)
    free = np.arange(problem.chips)
    chain = new_chain(tables, code, seed)
    hot_db, cold_db = temperatures_db
    ratio = cold_db / hot_db
    moves_made = 0
    deepest: list[Codes] = []
    while moves_made < moves:
        refresh(tables, chain, problem.chips)
        count = min(_SLICE, moves - moves_made)
        heat = [hot_db * ratio ** (move / moves) for move in (moves_made, moves_made + count)]
        cool(tables, limits, chain, free, work, np.array(heat), count)
        moves_made += count
        # of every slice: what is deepest on the search's samples need not be so in between
        deepest = [*deepest, best_codes(chain)][-_OFFERED:]
        chain.deepest_term[0] = 0.0
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
    limits : LoopLimits
    chain : Chain
    free : (M,) int64
        Chips that may change: all of the code, or those of one exposure of several.
    work : (3, 64) float32 or None
        Of :func:`cep.search.annealing.terms.work_space`.
    temperatures : (2,) float64, dB
        At the first move, and after the last.
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
        if judge(tables, otf, picked, count, limits.chips, open_chips + more, ceiling, work, sums):
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
