"""Compiled scan of the proven optimum: 1024 codes at a time, one bit each.

A code is cut into far chips at both ends, near chips, and an inner block of ten. At a frequency
the sum of all chips outside the block is a point of the plane; the plane is cut into square cells,
and for every cell 1024 bits are kept: which of the 1024 inner patterns are not surely below the
limit, wherever in the cell the point lies. One AND of 1024 bits judges 1024 codes at one
frequency, and a dozen and a half leave nothing of most blocks. The others are evaluated in float32
at all frequencies, with an allowance for rounding; the caller evaluates those that remain.

Nothing is discarded without a frequency at which its |H| is below the limit: rounding costs speed,
never the proof.
"""

from __future__ import annotations

from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled, inlined
from cep.search.annealing.proposals import LoopLimits, keeps_runs

INNER = 10  # chips of a block: its 1024 bits are two vector registers
BYTES = 6  # of a code: 48 chips at most
LANES = 16  # frequencies evaluated side by side
SHIFT = 16  # a cell is 2^16 fixed-point units wide

Bits = NDArray[np.uint64]
Ints = NDArray[np.int32]
Counts = NDArray[np.int64]


class ChipGroup(NamedTuple):
    """Patterns of some chips of the code, one a row.

    Attributes
    ----------
    bits : (R,) uint64
        Open chips.
    sums : (R, 2 F) int32
        Real parts of their sum at each frequency, then the imaginary ones, in fixed-point units.
    open_chips, pulses : (R,) int64
        Number of open chips and of open runs.
    """

    bits: Bits
    sums: Ints
    open_chips: Counts
    pulses: Counts


class CodeBlocks(NamedTuple):
    """Codes of one length, as all that its parts can be joined to.

    Attributes
    ----------
    head, middle, tail : ChipGroup
        Far chips at the start and the end, and near chips, the latter sorted by their open chips.
    tails : (R,) int64
        How many of the first rows of ``tail`` go with each head.
    near_at : (N,) int64
        First row of ``middle`` with as many open chips, and one entry beyond.
    inner_bits : (1024,) uint64
        Open chips of the inner patterns.
    inner_left : (49, 16) uint64
        Inner patterns that keep the limits, by the number of open chips outside the block.
    inner_count : (49,) int64
        Their number.
    """

    head: ChipGroup
    middle: ChipGroup
    tail: ChipGroup
    tails: Counts
    near_at: Counts
    inner_bits: Bits
    inner_left: Bits
    inner_count: Counts


class CellTables(NamedTuple):
    """Tables of a limit on |H|.

    Attributes
    ----------
    first_cell : (F,) int32
        First row of each frequency in ``cells``; F is a multiple of eight.
    cells, grid
        From :func:`fill_cells`.
    dense : float32
        From :func:`sums_by_byte`.
    limit2 : float32
        Smallest |H|^2 of interest there, less rounding errors.
    """

    first_cell: Ints
    cells: Bits
    grid: int
    dense: NDArray[np.float32]
    limit2: np.float32


def all_patterns(chips: int) -> NDArray[np.int8]:
    """All patterns of some chips, (2^chips, chips), the first chip changing fastest."""
    return ((np.arange(2**chips)[:, None] >> np.arange(chips)) & 1).astype(np.int8)


def dot(patterns: NDArray[np.int8], basis: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Sum the chips' contributions at each frequency, (R, Q)."""
    # real and imaginary parts side by side: of mixed types numpy multiplies without BLAS
    chips, frequencies = basis.shape
    columns = np.ascontiguousarray(basis).view(np.float64).reshape(chips, 2 * frequencies)
    parts = patterns.astype(np.float64) @ columns
    return parts.view(np.complex128).reshape(len(patterns), frequencies)


@compiled
def fill_cells(
    inner: NDArray[np.float64],
    corner: NDArray[np.float64],
    step: float,
    slack: float,
    limit: float,
    grid: int,
) -> Bits:
    """Find the inner patterns that each cell leaves, (F * grid * grid * 16,) uint64.

    Parameters
    ----------
    inner : (F, 2, 1024) float
        Sums of the inner patterns.
    corner : (F, 2) float
        Lower left corner of each frequency's cells. The outermost cells stand for all beyond them
        and leave everything.
    step : float
        Side of a cell.
    slack : float
        How far outside its cell a point may lie, from rounding.
    limit : float
        Smallest |H| of interest.
    """
    frequencies = inner.shape[0]
    patterns = inner.shape[2]
    words = patterns // 64
    cells = np.full(frequencies * grid * grid * words, ~np.uint64(0), np.uint64)
    half = step / 2 + slack
    limit2 = limit * limit
    for f in range(frequencies):
        for y in range(1, grid - 1):
            middle_y = corner[f, 1] + step * (y + 0.5)
            for x in range(1, grid - 1):
                middle_x = corner[f, 0] + step * (x + 0.5)
                row = (f * grid + y) * grid + x
                for word in range(words):
                    survivors = np.uint64(0)
                    for bit in range(64):
                        # the farthest point of the cell decides
                        away_x = abs(inner[f, 0, word * 64 + bit] + middle_x) + half
                        away_y = abs(inner[f, 1, word * 64 + bit] + middle_y) + half
                        survivors |= np.uint64(
                            away_x * away_x + away_y * away_y >= limit2
                        ) << np.uint64(bit)
                    cells[row * words + word] = survivors
    return cells


def sums_by_byte(basis: NDArray[np.complex128]) -> NDArray[np.float32]:
    """Sum every byte of a code at all frequencies, (Q / 16, 6, 256, 32) float32.

    Parameters
    ----------
    basis : (n, Q) complex
        Contribution of each chip, frequencies in the order in which they are to be tried.
    """
    chips, frequencies = basis.shape
    order = np.arange(-(-frequencies // LANES) * LANES)
    padded = np.zeros((8 * BYTES, order.size), np.complex128)
    # the last sixteen are filled up with the first: a frequency twice discards no more codes
    padded[:chips] = basis[:, order % frequencies]
    sums = np.stack(
        [dot(all_patterns(8), padded[8 * byte : 8 * byte + 8]) for byte in range(BYTES)]
    )
    blocks = sums.reshape(BYTES, 256, -1, LANES).transpose(2, 0, 1, 3)
    return np.ascontiguousarray(
        np.concatenate([blocks.real, blocks.imag], axis=-1), dtype=np.float32
    )


@compiled
def _reaches(code: np.uint64, dense: NDArray[np.float32], limit2: np.float32) -> bool:
    """Whether |H|^2 is not below the limit at any frequency; sixteen are judged side by side."""
    mask = np.uint64(255)
    b0 = code & mask
    b1 = (code >> np.uint64(8)) & mask
    b2 = (code >> np.uint64(16)) & mask
    b3 = (code >> np.uint64(24)) & mask
    b4 = (code >> np.uint64(32)) & mask
    b5 = (code >> np.uint64(40)) & mask
    for block in range(dense.shape[0]):
        below = 0
        for q in range(LANES):
            real = (dense[block, 0, b0, q] + dense[block, 1, b1, q] + dense[block, 2, b2, q]) + (
                dense[block, 3, b3, q] + dense[block, 4, b4, q] + dense[block, 5, b5, q]
            )
            r = q + LANES
            imag = (dense[block, 0, b0, r] + dense[block, 1, b1, r] + dense[block, 2, b2, r]) + (
                dense[block, 3, b3, r] + dense[block, 4, b4, r] + dense[block, 5, b5, r]
            )
            below += real * real + imag * imag < limit2
        if below:
            return False
    return True


@inlined
def _locate(
    outer_sums: Ints,
    near_sums: Ints,
    pattern: int,
    first_cell: Ints,
    side: np.int32,
    rows: NDArray[np.uint32],
) -> None:
    """Find the cell of the sum of all chips outside the block at each frequency."""
    top = side - np.int32(1)
    zero = np.int32(0)
    frequencies = rows.size
    for f in range(frequencies):
        x = (outer_sums[f] + near_sums[pattern, f]) >> SHIFT
        y = (outer_sums[frequencies + f] + near_sums[pattern, frequencies + f]) >> SHIFT
        rows[f] = first_cell[f] + min(max(y, zero), top) * side + min(max(x, zero), top)


@compiled
def scan(
    blocks: CodeBlocks,
    tables: CellTables,
    limits: LoopLimits,
    span: Counts,
    survivors: Bits,
    scanned: Counts,
    halt: NDArray[np.bool_],
) -> int:
    """Go through all codes of a range of heads; returns how many were written to ``survivors``.

    Parameters
    ----------
    span : (3,) int64
        First head, end of heads, first tail of the first head. Its first and last are moved to
        where the scan stopped: at the end, where ``survivors`` may not hold the next block, or at
        ``halt``.
    survivors : (M,) uint64
        Codes that reach the limit at every frequency.
    scanned : (1,) int64
        Raised by the number of codes within the limit on light.
    halt : (1,) bool
        Set from another thread to stop.
    """
    head = blocks.head
    tail = blocks.tail
    tails = blocks.tails
    near_at = blocks.near_at
    near_sums = blocks.middle.sums
    near_open_chips = blocks.middle.open_chips
    near_bits = blocks.middle.bits
    inner_bits = blocks.inner_bits
    inner_left = blocks.inner_left
    inner_count = blocks.inner_count
    first_cell = tables.first_cell
    cells = tables.cells
    side = np.int32(tables.grid)
    rows = np.zeros(first_cell.size, np.uint32)
    # in fixed point, where a shift finds the cell, and a sum of parts has no rounding of its own
    outer_sums = np.zeros(2 * rows.size, np.int32)
    alive = np.zeros(inner_left.shape[1], np.uint64)
    words = alive.size
    chips = np.zeros(limits.chips, np.int8)
    number = 0
    room = survivors.size - near_bits.size * inner_bits.size
    most_near = near_at.size - 2
    start = span[2]
    for i in range(span[0], span[1]):
        for j in range(start, tails[i]):
            if number > room or halt[0]:
                span[0], span[2] = i, j
                return number
            open_chips = head.open_chips[i] + tail.open_chips[j]
            low = max(limits.low - open_chips - INNER, 0)
            high = min(limits.high - open_chips, most_near)
            # joined in the middle they may still be one pulse
            if low > high or head.pulses[i] + tail.pulses[j] - 1 > limits.max_pulses:
                continue
            far_bits = head.bits[i] | tail.bits[j]
            for f in range(outer_sums.size):
                outer_sums[f] = head.sums[i, f] + tail.sums[j, f]
            for k in range(near_at[low], near_at[high + 1]):
                outside = open_chips + near_open_chips[k]
                scanned[0] += inner_count[outside]
                _locate(outer_sums, near_sums, k, first_cell, side, rows)
                # plain loops over a length known only at run time: those become vector
                # instructions
                for word in range(words):
                    alive[word] = inner_left[outside, word]
                any_alive = np.uint64(1)
                for first in range(0, rows.size, 8):
                    cell0 = rows[first] * words
                    cell1 = rows[first + 1] * words
                    cell2 = rows[first + 2] * words
                    cell3 = rows[first + 3] * words
                    cell4 = rows[first + 4] * words
                    cell5 = rows[first + 5] * words
                    cell6 = rows[first + 6] * words
                    cell7 = rows[first + 7] * words
                    any_alive = np.uint64(0)
                    for word in range(words):
                        bits = (
                            alive[word]
                            & cells[cell0 + word]
                            & cells[cell1 + word]
                            & cells[cell2 + word]
                            & cells[cell3 + word]
                        )
                        bits &= (
                            cells[cell4 + word]
                            & cells[cell5 + word]
                            & cells[cell6 + word]
                            & cells[cell7 + word]
                        )
                        alive[word] = bits
                        any_alive |= bits
                    if any_alive == 0:
                        break
                if any_alive == 0:
                    continue
                outer = far_bits | near_bits[k]
                for word in range(alive.size):
                    bits = alive[word]
                    while bits:
                        lowest = _ones((bits & (~bits + np.uint64(1))) - np.uint64(1))
                        bits &= bits - np.uint64(1)
                        code = outer | inner_bits[64 * word + lowest]
                        if limits.constrained:
                            for chip in range(chips.size):
                                chips[chip] = (code >> np.uint64(chip)) & np.uint64(1)
                            if not keeps_runs(chips, limits):
                                continue
                        if _reaches(code, tables.dense, tables.limit2):
                            survivors[number] = code
                            number += 1
        start = 0
    span[0], span[2] = span[1], 0
    return number


@compiled
def _ones(word: np.uint64) -> int:
    """Open bits of a word; compiles to one instruction."""
    count = 0
    while word:
        word &= word - np.uint64(1)
        count += 1
    return count


def possible(
    patterns: NDArray[np.int8], limits: LoopLimits, at_ends: tuple[bool, bool]
) -> NDArray[np.bool_]:
    """Which patterns may be part of a code that keeps the run limits.

    ``at_ends`` are whether the code begins and ends with the pattern.
    """
    shortest = limits.min_open == limits.min_closed == limits.min_period == 1
    if shortest and limits.max_open >= patterns.shape[1]:
        return np.ones(len(patterns), dtype=np.bool_)
    return np.array([_runs_fit(row.tolist(), limits, at_ends) for row in patterns], dtype=np.bool_)


def _runs_fit(row: list[int], limits: LoopLimits, at_ends: tuple[bool, bool]) -> bool:
    # a run cut off by the pattern's edge may go on: it has no shortest length yet
    runs = [(bit, len(list(group))) for bit, group in groupby(row)]
    place = 0
    pulse_start = -limits.min_period
    for index, (bit, length) in enumerate(runs):
        starts_here = index > 0 or (bit and at_ends[0])
        ends_here = index < len(runs) - 1 or (bit and at_ends[1])
        if starts_here and ends_here and length < (limits.min_open if bit else limits.min_closed):
            return False
        if bit and (
            length > limits.max_open or (starts_here and place - pulse_start < limits.min_period)
        ):
            return False
        if bit and starts_here:
            pulse_start = place
        place += length
    return True
