"""State of a compiled chain: code, OTF, sorted frequencies, cost and smallest |P|."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.search.annealing.terms import BLOCK, SMALLEST, Tables, decibels, sums_over
from cep.search.objectives import FLATNESS, STEEP

Floats = NDArray[np.float32]


class Chain(NamedTuple):
    """State of a chain, changed in place: single numbers are arrays of one for that.

    Attributes
    ----------
    code, best, deepest : (chips,) int8
        Where it is, the cheapest code seen, and the one with the largest smallest |P|.
    otf : (frames, nb, 2, 64) float32
    cost, best_cost : (1,) float64, dB
        Of ``code`` and of ``best``.
    deepest_power : (1,) float64
        Smallest |P|^2 of ``deepest``, 0 before there is one.
    random : (1,) uint64
        State of the random numbers, not 0.
    """

    code: NDArray[np.int8]
    best: NDArray[np.int8]
    deepest: NDArray[np.int8]
    otf: NDArray[np.float32]
    cost: NDArray[np.float64]
    best_cost: NDArray[np.float64]
    deepest_power: NDArray[np.float64]
    random: NDArray[np.uint64]


@compiled
def fresh_otf(tables: Any, code: NDArray[np.int8], chips: int, otf: Floats) -> None:
    """Recompute a code's OTF: float32 sums drift."""
    otf[:] = 0
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
        for table in (rows, otf, scale, offset):
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
    sums_over(
        tables,
        otf,
        np.zeros((2, 3), np.int64),
        0,
        chips,
        open_chips,
        np.inf,
        work,
        sums,
    )
    return decibels(tables, sums, open_chips)


@compiled
def smallest_power(tables: Any, otf: Floats) -> float:
    """Smallest |P|^2 of an OTF over all frequencies."""
    lowest = np.float32(np.inf)
    for block in range(otf.shape[1]):
        for f in range(BLOCK):
            power = np.float32(0)
            for frame in range(otf.shape[0]):
                power += otf[frame, block, 0, f] ** 2 + otf[frame, block, 1, f] ** 2
            # again without the columns that only fill up a block
            if tables.scale[0, block, 0, f] > 0 and power < lowest:
                lowest = power
    return float(lowest)


@compiled
def note_best(tables: Any, chain: Any) -> None:
    """Keep a chain's code where it costs least so far, or its smallest |P| is the largest."""
    if chain.cost[0] < chain.best_cost[0]:
        chain.best_cost[0] = chain.cost[0]
        chain.best[:] = chain.code
    if tables.kinds[0] == STEEP:
        # the sum leads, the plain minimum is what counts
        lowest = smallest_power(tables, chain.otf)
        if lowest > chain.deepest_power[0]:
            chain.deepest_power[0] = lowest
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
        deepest_power=np.zeros(1),
        random=np.array([seed | 1], dtype=np.uint64),  # a shift register never leaves 0
    )


def own_tables(tables: Tables) -> Tables:
    """Copy the tables that a chain sorts."""
    return tables._replace(
        rows=tables.rows.copy(), scale=tables.scale.copy(), offset=tables.offset.copy()
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
    return codes[: 1 + (chain.deepest_power[0] > 0)]
