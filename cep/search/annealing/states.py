"""State of a compiled chain: its OTF summed anew, its frequencies sorted, its cost and smallest |P|."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.search.annealing.terms import BLOCK, FLATNESS, SMALLEST, decibels, sums_over

__all__ = ["fresh_otf", "smallest_power", "total_cost", "worst_first"]

Floats = NDArray[np.float32]


@compiled
def fresh_otf(tables: Any, code: NDArray[np.int8], chips: int, otf: Floats) -> None:
    """Sum a code's OTF anew: float32 sums drift."""
    otf[:] = 0
    variants = tables.rows.shape[1]
    for j in range(len(code)):
        if code[j]:
            # chips open from the first to the last: the left neighbour stands, the right one is closed yet
            variant = 2 * code[j - 1] if variants == 4 and j % chips > 0 else 0
            row, changed = tables.rows[j, variant].ravel(), otf[j // chips].ravel()
            for f in range(changed.size):
                changed[f] += row[f]


@compiled
def worst_first(tables: Any, otf: Floats) -> None:
    """Sort each part's frequencies in place by what they add to the cost: the worst ones refuse most moves."""
    frames, rows, scale, offset = otf.shape[0], tables.rows, tables.scale, tables.offset
    for part in range(len(tables.layout)):
        first, size = tables.layout[part, 0], (tables.layout[part, 1] - tables.layout[part, 0]) * BLOCK
        key, kept = np.empty(size, np.float32), np.empty(size, np.float32)
        for place in range(size):
            block, f = first + place // BLOCK, place % BLOCK
            power = np.float32(SMALLEST)
            for frame in range(frames):
                power += otf[frame, block, 0, f] ** 2 + otf[frame, block, 1, f] ** 2
            # columns that fill up a block have scale 0
            key[place] = -scale[0, block, 0, f] / power if tables.kinds[0] == FLATNESS else 0
            if tables.kinds[0] != FLATNESS:
                key[place] = -1 / (scale[0, block, 0, f] * power + offset[0, block, 0, f])
        order = np.argsort(key)
        for line in range(rows.shape[0] * rows.shape[1] * 2):
            chip, variant, half = line // (2 * rows.shape[1]), line // 2 % rows.shape[1], line % 2
            for place in range(size):
                kept[place] = rows[chip, variant, first + order[place] // BLOCK, half, order[place] % BLOCK]
            for place in range(size):
                rows[chip, variant, first + place // BLOCK, half, place % BLOCK] = kept[place]
        for line in range(frames * 2):
            for place in range(size):
                kept[place] = otf[line // 2, first + order[place] // BLOCK, line % 2, order[place] % BLOCK]
            for place in range(size):
                otf[line // 2, first + place // BLOCK, line % 2, place % BLOCK] = kept[place]
        for table in (scale, offset):
            for line in range(scale.shape[0] * scale.shape[2]):
                o, q = line // scale.shape[2], line % scale.shape[2]
                for place in range(size):
                    kept[place] = table[o, first + order[place] // BLOCK, q, order[place] % BLOCK]
                for place in range(size):
                    table[o, first + place // BLOCK, q, place % BLOCK] = kept[place]


@compiled
def total_cost(tables: Any, chips: int, code: NDArray[np.int8], otf: Floats) -> float:
    """Cost, dB, of a code whose OTF (frames, nb, 2, 64) is given."""
    work = np.empty((3, BLOCK), np.float32)
    sums = np.empty((len(tables.kinds), len(tables.layout), 2))
    opened = int(code.sum())
    sums_over(
        tables.rows,
        tables.layout,
        tables.kinds,
        tables.scale,
        tables.offset,
        tables.light,
        otf,
        np.zeros((2, 3), np.int64),
        0,
        chips,
        opened,
        np.inf,
        work,
        sums,
    )
    return decibels(tables, sums, opened)


@compiled
def smallest_power(tables: Any, otf: Floats) -> float:
    """Smallest |P|^2 of an OTF over all frequencies."""
    lowest = np.float32(np.inf)
    for block in range(otf.shape[1]):
        for f in range(BLOCK):
            power = np.float32(0)
            for frame in range(otf.shape[0]):
                power += otf[frame, block, 0, f] ** 2 + otf[frame, block, 1, f] ** 2
            if tables.scale[0, block, 0, f] > 0 and power < lowest:
                lowest = power
    return float(lowest)
