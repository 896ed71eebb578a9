"""Blocks and tables of the exhaustive scan (:mod:`cep.search.exhaustive.scan`)."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cep.search.annealing.proposals import LoopLimits
from cep.search.exhaustive.scan import (
    BYTES,
    INNER,
    SHIFT,
    CellTables,
    ChipGroup,
    CodeBlocks,
    all_patterns,
    dot,
    fill_cells,
    possible,
    scan,
    sums_by_byte,
)
from motdiff.types import ComplexArray

Patterns = NDArray[np.int8]
MARGIN = 1e-8  # relative: equal minima stay in spite of rounding
_CELL = 0.15  # side of a cell over the limit; others: docs/decisions/search.md
_CELL_BITES = 0.6  # of its side, that a cell takes off the limit: half its diagonal is 0.7
_MOST_CELLS = 126  # along one axis: 24 tables of 126 x 126 cells of 128 bytes are 49 MB
_FREQUENCIES = 24  # of the bit tables, a multiple of eight: docs/decisions/search.md
_FEWEST_CHIPS = 20  # below, bit tables cost more than they save
_NEAR = 8  # near chips: their 256 patterns share the sums of the far ones
_SAMPLE = 2**12  # random codes by which frequencies are put in order
_CANDIDATES = 768  # frequencies that the scan looks at; the caller looks at the others


class LimitTables:
    """Tables of a limit: frequencies in order of trial, and the patterns that they leave.

    Parameters
    ----------
    basis : (n, Q) complex
        Contribution of each chip at each frequency.
    limits : LoopLimits
    limit : float
        |H| of interest: a code is discarded when it is below at any frequency.
    """

    def __init__(self, basis: ComplexArray, limits: LoopLimits, limit: float) -> None:
        self.limits = limits
        self.inner_at = sum(_cut(len(basis))[:2])
        order = _order(basis, limits, limit)
        count = min(_FREQUENCIES, order.size // 8 * 8) if len(basis) >= _FEWEST_CHIPS else 0
        self.used = basis[:, order[:count]]
        # the bit tables' frequencies come last: they have judged already, if a little coarsely
        self.dense = sums_by_byte(basis[:, np.r_[order[count:], order[:count]]])
        # six sums, each rounded to float32, then added up: at most eleven roundings in each of two
        # parts
        self._error = np.sqrt(2) * 11 * 2.0**-24 * float(np.abs(basis).max(axis=1).sum())
        self._total = float(np.abs(basis).sum(axis=0).max())
        self._fill(limit)

    def tightened(self, limit: float) -> LimitTables:
        """Tables of a higher limit, with the same frequencies."""
        tables = copy(self)
        tables._fill(limit)
        return tables

    def _fill(self, limit: float) -> None:
        self.limit = limit
        floor = max(limit * (1 - MARGIN) - self._error, 0.0)
        self.limit2 = np.float32(floor**2 * (1 - 2.0**-20))
        sums = dot(all_patterns(INNER), self.used[self.inner_at : self.inner_at + INNER]).T
        middle = sums.mean(axis=1)
        reach = limit + float(np.abs(sums - middle[:, None]).max(initial=0.0))
        self.step = max(_CELL * limit, 2 * reach / (_MOST_CELLS - 2), self._total / 4000)
        self.grid = 2 * int(np.ceil(reach / self.step)) + 2
        self.corner = -middle - self.step * self.grid / 2 * (1 + 1j)
        self.unit = self.step / 2**SHIFT
        self.first_cell = (np.arange(len(sums)) * self.grid**2).astype(np.int32)
        self.cells = fill_cells(
            np.ascontiguousarray(np.stack([sums.real, sums.imag], axis=1)),
            np.stack([self.corner.real, self.corner.imag], axis=1),
            self.step,
            # three parts are rounded to a unit; the rest is float64
            2 * self.unit + 1e-12 * self._total,
            limit * (1 - MARGIN),
            self.grid,
        )


class Scanner:
    """The codes of one length, as heads, near chips, inner chips and tails.

    Parameters
    ----------
    tables : LimitTables
    length : int
        At least 12.
    ends_open : bool
        Codes with both end chips open; otherwise all codes.
    mirrors : bool
        Of codes with both end chips open, one of each mirror pair.
    """

    def __init__(
        self, tables: LimitTables, length: int, *, ends_open: bool, mirrors: bool
    ) -> None:
        self.tables = tables
        limits = tables.limits
        head, near_chips, tail = _cut(length)
        start = tables.inner_at - head - near_chips
        places = np.cumsum([start, head, near_chips, INNER, tail])
        front = all_patterns(head)
        back = all_patterns(tail)
        if ends_open:
            front = front[front[:, 0] == 1]
            back = back[back[:, -1] == 1]
        # as seen from the ends of the code, over as many chips as both have
        seen_front = front[:, :tail] @ (1 << np.arange(tail)[::-1])
        seen_back = back[:, ::-1] @ (1 << np.arange(tail)[::-1])
        patterns = [front, all_patterns(near_chips), all_patterns(INNER), back]
        sides = [(True, False), (False, False), (False, False), (False, True)]
        keep = [possible(rows, limits, side) for rows, side in zip(patterns, sides, strict=True)]
        order = np.argsort(seen_back, kind="stable")
        order = order[keep[3][order]]
        front = front[keep[0]]
        seen_front = seen_front[keep[0]]
        back = back[order]
        seen_back = seen_back[order]
        middle = patterns[1][keep[1]]
        middle = middle[np.argsort(middle.sum(axis=1), kind="stable")]
        near_open_chips = middle.sum(axis=1)
        # of a pair of mirror images, the one whose tail does not come after its head; ties go both
        # ways
        tails = np.full(len(front), len(back), dtype=np.int64)
        if ends_open and mirrors:
            tails[:] = np.searchsorted(seen_back, seen_front, side="right")
        inner = patterns[2]
        outside = np.arange(8 * BYTES + 1)[:, None] + inner.sum(axis=1)
        fits_light = keep[2] & (outside >= limits.low) & (outside <= limits.high)
        self.blocks = CodeBlocks(
            head=self._group(front, int(places[0]), tables.corner),
            middle=self._group(middle, int(places[1])),
            tail=self._group(back, int(places[3])),
            tails=tails,
            near_at=np.searchsorted(near_open_chips, np.arange(near_chips + 2)).astype(np.int64),
            inner_bits=_bits(inner, tables.inner_at),
            inner_left=np.packbits(fits_light, axis=1, bitorder="little").view(np.uint64),
            inner_count=fits_light.sum(axis=1).astype(np.int64),
        )

    def spans(self, codes: int) -> Iterator[tuple[int, int]]:
        """Ranges of heads of about so many codes."""
        heads = codes >> (INNER + self.blocks.near_at.size - 2)
        chunk = np.cumsum(self.blocks.tails) // max(heads, 1)
        edges = [0, *(np.flatnonzero(np.diff(chunk)) + 1).tolist(), chunk.size]
        yield from pairwise(edges)

    def buffer(self) -> NDArray[np.uint64]:
        """Buffer for the survivors of a call of :meth:`run`: twice what one pair may leave."""
        return np.zeros(
            2 * self.blocks.middle.bits.size * self.blocks.inner_bits.size, dtype=np.uint64
        )

    def run(
        self,
        span: NDArray[np.int64],
        buffer: NDArray[np.uint64],
        scanned: NDArray[np.int64],
        halt: NDArray[np.bool_],
    ) -> NDArray[np.uint64]:
        """Scan from ``span[0]``, ``span[2]`` on; returns the survivors."""
        tables = self.tables
        cells = CellTables(
            tables.first_cell, tables.cells, tables.grid, tables.dense, tables.limit2
        )
        number = scan(self.blocks, cells, tables.limits, span, buffer, scanned, halt)
        return buffer[:number].copy()

    def _group(
        self, patterns: Patterns, start: int, corner: ComplexArray | float = 0.0
    ) -> ChipGroup:
        """Lay out the patterns of the chips from ``start`` on; sums count from ``corner``."""
        tables = self.tables
        sums = dot(patterns, tables.used[start : start + patterns.shape[1]]) - corner
        fixed = np.rint(np.concatenate([sums.real, sums.imag], axis=1) / tables.unit).astype(
            np.int32
        )
        rises = np.diff(patterns, axis=1, prepend=0) == 1
        return ChipGroup(
            _bits(patterns, start),
            fixed,
            patterns.sum(axis=1, dtype=np.int64),
            rises.sum(axis=1, dtype=np.int64),
        )


def _cut(chips: int) -> tuple[int, int, int]:
    """Chips of head, near part and tail; the inner block is between the last two."""
    near_chips = min(_NEAR, chips - INNER - 2)
    return (chips - INNER - near_chips + 1) // 2, near_chips, (chips - INNER - near_chips) // 2


def _order(basis: ComplexArray, limits: LoopLimits, limit: float) -> NDArray[np.intp]:
    """Order frequencies so that each discards most of the codes that those before it left.

    Both are judged on a sample of random codes. Of very many frequencies only some are taken.
    """
    rng = np.random.default_rng(0)
    chips, size = basis.shape
    candidates = rng.permutation(size)[:_CANDIDATES]
    rank = rng.random((_SAMPLE, chips)).argsort(axis=1).argsort(axis=1)
    centre = np.clip(rng.binomial(chips, 0.5, size=(_SAMPLE, 1)), limits.low, limits.high)
    sampled = np.abs(
        (rank < centre).astype(np.complex64) @ basis[:, candidates].astype(np.complex64)
    )
    # a cell takes a part of the limit away
    below = np.ascontiguousarray((sampled < limit * (1 - _CELL_BITES * _CELL)).T)
    survives = np.ones(_SAMPLE, dtype=np.bool_)
    free = np.ones(candidates.size, dtype=np.bool_)
    picked = []
    for _ in range(min(3 * _FREQUENCIES, candidates.size)):
        discards = np.where(free, below[:, survives].sum(axis=1), -1)
        if discards.max() == 0:  # the sample is used up: start it again
            survives[:] = True
            discards = np.where(free, below.sum(axis=1), -1)
        pick = int(discards.argmax())
        picked.append(pick)
        free[pick] = False
        survives &= ~below[pick]
    unpicked = np.flatnonzero(free)
    unpicked = unpicked[np.argsort(-below[unpicked].sum(axis=1), kind="stable")]
    return np.asarray(candidates[[*picked, *unpicked.tolist()]], dtype=np.intp)


def _bits(patterns: Patterns, start: int) -> NDArray[np.uint64]:
    places = np.uint64(1) << (start + np.arange(patterns.shape[1])).astype(np.uint64)
    return np.asarray((patterns.astype(np.uint64) * places).sum(axis=1), dtype=np.uint64)
