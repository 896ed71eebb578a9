"""Compiled scan of a proof in blocks: codes are judged by folded sums, whole families at once.

On the N = 4 q roots of unity a code may be rotated: chips that leave at one end come in at the
other, and no |P| changes. There P splits, as in a fast Fourier transform. At every fourth root it
depends on the sums g of chips a quarter apart, at the others of even order on the differences d of
chips half folded, at the rest on the differences e of chips half a ring apart:

    g[i] = a[i] + a[i + q] + a[i + 2 q] + a[i + 3 q]           0..4, q of them
    f[i] = a[i] + a[i + 2 q],  d[i] = f[i] - f[i + q]
    e[i] = a[i] - a[i + 2 q]

One g below the limit discards up to 6^q codes, one f below it up to 2^(2 q). Of all g that are
rotations or mirror images of each other one is taken. What is left at all N roots is turned to
each of its N rotations and judged between the roots, where rotations differ, as codes of at most n
<= N chips.

Nothing is discarded without a frequency at which its |P| is below the limit, less an allowance for
float32.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled, inlined

LANES = 16  # codes or frequencies side by side
COUNTS = (
    "folds",
    "folds_left",
    "halves",
    "halves_left",
    "rings",
    "rings_left",
    "turns",
    "turns_left",
)
"""Counters of :func:`scan_prefixes`: sums g, sums f, codes up to rotation, and codes; judged, and
left."""

_PREFIX = 6  # sums by which blocks are cut
_INNER = 96  # combinations of d side by side, at least where there are so many
_WITHIN = 8  # places e whose signs are side by side
_ROUNDING = 128 * 64 * 2.0**-24  # of at most 64 chips in float32: 128 additions, no sum above 64

Floats = NDArray[np.float32]
Words = NDArray[np.uint64]
Counts = NDArray[np.int64]


class Folding(NamedTuple):
    """Frequencies and limits of a scan.

    Attributes
    ----------
    quarter : int
        q; the ring has N = 4 q chips.
    chips : int
        Longest code of interest, at most N.
    fewest, most : int
        Open chips.
    prefix : int
        Sums g by which blocks are cut.
    g_waves : (q, 2, F) float32
        Contribution of each sum at the roots that depend on g alone: real and imaginary parts.
    d_waves : (q, 2, F), e_waves : (2 q, 2, F) float32
        Of each difference; F is a multiple of four and sixteen, the last frequencies repeat the
        first.
    between : (B, N, 2, 16) float32
        Of each chip at frequencies between the roots, sixteen at a time.
    limit2 : float32
        Smallest |P|^2 of interest, less rounding.
    """

    quarter: int
    chips: int
    fewest: int
    most: int
    prefix: int
    g_waves: Floats
    d_waves: Floats
    e_waves: Floats
    between: Floats
    limit2: np.float32


class WorkSpace(NamedTuple):
    """Arrays that a scan fills anew for each fold.

    Attributes
    ----------
    g, f : (q,), (2 q,) int64
        Sums of chips a quarter apart, and a half.
    d_places, d_number, d_value : (q,) int64
        Places of the differences d that a fold leaves open; how many values each takes, and one.
    d_low : (q,) float32
        The first of each one's values, which are two apart.
    e_places : (2 q,) int64
        Places of the differences e that are not 0.
    d_table, e_table : (F, 2, blocks, 16) float32
        Sums of the waves of all combinations of the first places.
    d_outer, e_outer : (2, 16) float32
        Sum of the waves of the other places.
    signs : (4, 16) float32
        Both signs of four places, all combinations.
    d_indices, e_indices : (C,) int64
        Combinations in a table that are not below the limit.
    keep : (16,) float32
    sums, more_sums : (2, 16) float32
        Of a code's waves.
    opened_at : (N,) int64
        Places of a code's open chips.
    """

    g: Counts
    f: Counts
    d_places: Counts
    d_number: Counts
    d_value: Counts
    d_low: Floats
    e_places: Counts
    d_table: Floats
    e_table: Floats
    d_outer: Floats
    e_outer: Floats
    signs: Floats
    d_indices: Counts
    e_indices: Counts
    keep: Floats
    sums: Floats
    more_sums: Floats
    opened_at: Counts


def folding(chips: int, open_range: tuple[int, int], limit: float) -> Folding:
    """Set up a scan of codes of at most so many chips for those whose |P| may be nowhere below the
    limit.
    """
    quarter = max(3, -(-chips // 4))
    ring = 4 * quarter

    def waves(places: int, order: int, turns: NDArray[np.int64], multiple: int) -> Floats:
        turns = np.resize(turns, -(-turns.size // multiple) * multiple)
        angle = -2 * np.pi * (np.outer(turns, np.arange(places)) % order) / order
        return np.ascontiguousarray(
            np.stack([np.cos(angle), np.sin(angle)]).transpose(2, 0, 1), dtype=np.float32
        )

    odd = np.arange(1, 4 * ring, 2)
    between = np.concatenate(
        [waves(ring, order, odd[: order // 4], LANES) for order in (2 * ring, 4 * ring, 8 * ring)],
        axis=2,
    )
    limit2 = max(limit - np.sqrt(2) * _ROUNDING, 0.0) ** 2
    return Folding(
        quarter,
        chips,
        *open_range,
        min(_PREFIX, quarter - 1),
        waves(quarter, quarter, np.arange(1, quarter // 2 + 1), 1),
        waves(quarter, 2 * quarter, odd[odd <= quarter], 4),
        waves(2 * quarter, ring, odd[:quarter], LANES),
        np.ascontiguousarray(between.reshape(ring, 2, -1, LANES).transpose(2, 0, 1, 3)),
        np.float32(limit2 * (1 - 2.0**-20)),
    )


@compiled
def _images(packed: int, quarter: int) -> int:
    """Rotations and mirror images of a fold that differ from each other; 0 where another one is
    the larger.

    ``packed`` has three bits a sum, the first sum in the highest.
    """
    mask = (1 << (3 * quarter)) - 1
    mirror = 0
    remaining = packed
    for _ in range(quarter):
        mirror = (mirror << 3) | (remaining & 7)
        remaining >>= 3
    same = 0
    rotated = packed
    for _ in range(quarter):
        rotated = ((rotated << 3) | (rotated >> (3 * (quarter - 1)))) & mask
        if rotated > packed:
            return 0
        same += rotated == packed
    rotated = mirror
    for _ in range(quarter):
        rotated = ((rotated << 3) | (rotated >> (3 * (quarter - 1)))) & mask
        if rotated > packed:
            return 0
        same += rotated == packed
    return 2 * quarter // same


@compiled
def _letters(index: int, count: int, into: Counts, at: int) -> bool:
    """Write the sums of a prefix or suffix from ``at`` on; whether, at 0, the largest rotation may
    begin so.
    """
    for place in range(count):
        into[at + count - 1 - place] = index % 5
        index //= 5
    if at == 0:
        for shift in range(1, count):
            for place in range(count - shift):
                if into[shift + place] != into[place]:
                    if into[shift + place] > into[place]:
                        return False
                    break
    return True


@compiled
def _codes_of(g: Counts, multiplicity: Counts, fewest: int, most: int) -> int:
    """Codes that a fold accounts for; 0 where its open chips are out of range, or another of its
    images is the larger.

    ``multiplicity`` has the number of four chips with each sum.
    """
    open_chips = 0
    packed = 0
    for i in range(g.size):
        open_chips += g[i]
        packed = (packed << 3) | g[i]
    if open_chips < fewest or open_chips > most:
        return 0
    codes = _images(packed, g.size)
    if codes == 0:
        return 0
    for i in range(g.size):
        codes *= multiplicity[g[i]]
    return codes


@compiled
def codes_by_prefix(quarter: int, prefix: int, fewest: int, most: int) -> Counts:
    """Count the codes, of N = 4 q chips each way round, that each prefix accounts for, (5^prefix,)
    int64.
    """
    total = np.zeros(5**prefix, np.int64)
    binomials = np.array([1, 4, 6, 4, 1])
    g = np.zeros(quarter, np.int64)
    suffix = quarter - prefix
    for p in range(total.size):
        if not _letters(p, prefix, g, 0):
            continue
        for s in range(5**suffix):
            _letters(s, suffix, g, prefix)
            total[p] += _codes_of(g, binomials, fewest, most)
    return total


@inlined
def _spread(
    low: Floats, number: Counts, places: Counts, until: int, waves: Floats, flat: Floats
) -> int:
    """Sum all combinations of the first places' values, (F, 2, C); returns how many there are.

    Place i takes ``number[i]`` values from ``low[i]`` on, two apart; the first place's change
    fastest.
    """
    count = 1
    for j in range(flat.shape[0]):
        flat[j, 0, 0] = 0.0
        flat[j, 1, 0] = 0.0
    for i in range(until):
        for j in range(flat.shape[0]):
            for axis in range(2):
                wave = waves[places[i], axis, j]
                summed = flat[j, axis, :count]
                for k in range(number[i] - 1, -1, -1):
                    new = flat[j, axis, k * count : (k + 1) * count]
                    add = (low[i] + np.float32(2 * k)) * wave
                    for c in range(count):
                        new[c] = summed[c] + add
        count *= number[i]
    return count


@inlined
def _spread_signs(places: Counts, within: int, waves: Floats, signs: Floats, table: Floats) -> int:
    """Sum the first places' waves, the first one's as it is, the others' with either sign; returns
    how many blocks.
    """
    for j in range(table.shape[0]):
        for axis in range(2):
            first = waves[places[0], axis, j]
            w1 = waves[places[1], axis, j] if within > 1 else np.float32(0)
            w2 = waves[places[2], axis, j] if within > 2 else np.float32(0)
            w3 = waves[places[3], axis, j] if within > 3 else np.float32(0)
            w4 = waves[places[4], axis, j] if within > 4 else np.float32(0)
            for i in range(5, within):
                first -= waves[places[i], axis, j]
            for q in range(LANES):
                table[j, axis, 0, q] = (
                    (first + signs[0, q] * w1)
                    + signs[1, q] * w2
                    + (signs[2, q] * w3 + signs[3, q] * w4)
                )
            filled = 1
            for i in range(5, within):
                add = np.float32(2) * waves[places[i], axis, j]
                for block in range(filled):
                    for q in range(LANES):
                        table[j, axis, filled + block, q] = table[j, axis, block, q] + add
                filled *= 2
    return 1 << max(within - 5, 0)


@inlined
def _kept(
    outer: Floats,
    table: Floats,
    blocks: int,
    count: int,
    limit2: np.float32,
    keep: Floats,
    out: Counts,
) -> int:
    """Find the combinations that with the outer sums, (2, F), are nowhere below the limit; returns
    how many.
    """
    number = 0
    for block in range(blocks):
        remaining = np.float32(1)
        for q in range(LANES):
            keep[q] = np.float32(1)
        for j in range(0, table.shape[0], 4):  # F is a multiple of four
            remaining = np.float32(0)
            x0 = outer[0, j]
            y0 = outer[1, j]
            x1 = outer[0, j + 1]
            y1 = outer[1, j + 1]
            x2 = outer[0, j + 2]
            y2 = outer[1, j + 2]
            x3 = outer[0, j + 3]
            y3 = outer[1, j + 3]
            for q in range(LANES):
                a0 = x0 + table[j, 0, block, q]
                b0 = y0 + table[j, 1, block, q]
                a1 = x1 + table[j + 1, 0, block, q]
                b1 = y1 + table[j + 1, 1, block, q]
                a2 = x2 + table[j + 2, 0, block, q]
                b2 = y2 + table[j + 2, 1, block, q]
                a3 = x3 + table[j + 3, 0, block, q]
                b3 = y3 + table[j + 3, 1, block, q]
                low = min(
                    min(a0 * a0 + b0 * b0, a1 * a1 + b1 * b1),
                    min(a2 * a2 + b2 * b2, a3 * a3 + b3 * b3),
                )
                lane = keep[q] if low >= limit2 else np.float32(0)
                keep[q] = lane
                remaining += lane
            if remaining == 0:
                break
        if remaining > 0:
            for q in range(LANES):
                if keep[q] > 0 and block * LANES + q < count:
                    out[number] = block * LANES + q
                    number += 1
    return number


@inlined
def _turned(code: np.uint64, at: int, ring: int) -> np.uint64:
    """Return the code that begins at a chip of the ring."""
    if at == 0:
        return code
    mask = (np.uint64(1) << np.uint64(ring)) - np.uint64(1)
    return ((code >> np.uint64(at)) | (code << np.uint64(ring - at))) & mask


@compiled
def _reaches(
    code: np.uint64, ring: int, between: Floats, limit2: np.float32, sums: Floats
) -> bool:
    """Whether |P|^2 is not below the limit between the roots either."""
    for block in range(between.shape[0]):
        for q in range(LANES):
            sums[0, q] = np.float32(0)
            sums[1, q] = np.float32(0)
        for i in range(ring):
            if (code >> np.uint64(i)) & np.uint64(1):
                for q in range(LANES):
                    sums[0, q] += between[block, i, 0, q]
                    sums[1, q] += between[block, i, 1, q]
        below = 0
        for q in range(LANES):
            below += sums[0, q] * sums[0, q] + sums[1, q] * sums[1, q] < limit2
        if below:
            return False
    return True


@compiled
def _turns(
    code: np.uint64,
    fold: Folding,
    work: WorkSpace,
    survivors: Words,
    number: int,
    counts: Counts,
) -> int:
    """Judge the codes that begin at each open chip of a ring; returns the number of survivors so
    far, -1 for too many.
    """
    ring = 4 * fold.quarter
    between = fold.between
    limit2 = fold.limit2
    places = work.opened_at
    sums = work.sums
    # a length known only at run time: such loops become vector instructions
    lanes = sums.shape[1]
    open_chips = 0
    for q in range(lanes):
        sums[0, q] = np.float32(0)
        sums[1, q] = np.float32(0)
    for i in range(ring):
        if (code >> np.uint64(i)) & np.uint64(1):
            places[open_chips] = i
            open_chips += 1
            for q in range(lanes):
                sums[0, q] += between[0, i, 0, q]
                sums[1, q] += between[0, i, 1, q]
    for index in range(open_chips):
        at = places[index]
        before = places[index - 1] if index > 0 else places[open_chips - 1] - ring
        # closed chips after the last open one are no part of the code
        if at - before > ring - fold.chips:
            counts[6] += 1
            below = 0
            for q in range(lanes):
                below += sums[0, q] * sums[0, q] + sums[1, q] * sums[1, q] < limit2
            if below == 0:
                rotated = _turned(code, at, ring)
                if _reaches(rotated, ring, between, limit2, work.more_sums):
                    counts[7] += 1
                    if number == survivors.size:
                        return -1
                    survivors[number] = rotated
                    number += 1
        # this chip moves behind the others, where the wave has the other sign
        for q in range(lanes):
            sums[0, q] -= np.float32(2) * between[0, at, 0, q]
            sums[1, q] -= np.float32(2) * between[0, at, 1, q]
    return number


@compiled
def _work_space(fold: Folding) -> WorkSpace:
    """Make the arrays of a scan."""
    quarter = fold.quarter
    half = 2 * quarter
    blocks = 3 * _INNER // LANES
    signs = np.zeros((4, LANES), np.float32)
    for q in range(LANES):
        for i in range(4):
            signs[i, q] = 2 * ((q >> i) & 1) - 1
    return WorkSpace(
        np.zeros(quarter, np.int64),
        np.zeros(half, np.int64),
        np.zeros(quarter, np.int64),
        np.zeros(quarter, np.int64),
        np.zeros(quarter, np.int64),
        np.zeros(quarter, np.float32),
        np.zeros(half, np.int64),
        np.zeros((fold.d_waves.shape[2], 2, blocks, LANES), np.float32),
        np.zeros((-(-quarter // 4) * 4, 2, 1 << (_WITHIN - 5), LANES), np.float32),
        np.zeros((2, LANES), np.float32),
        np.zeros((2, LANES), np.float32),
        signs,
        np.zeros(blocks * LANES, np.int64),
        np.zeros(1 << (_WITHIN - 1), np.int64),
        np.zeros(LANES, np.float32),
        np.zeros((2, LANES), np.float32),
        np.zeros((2, LANES), np.float32),
        np.zeros(2 * half, np.int64),
    )


@inlined
def _is_below(g: Counts, waves: Floats, limit2: np.float32) -> bool:
    """Whether |P|^2 is below the limit at a root that depends on the sums g alone."""
    for j in range(waves.shape[2]):
        x = np.float32(0)
        y = np.float32(0)
        for i in range(g.size):
            x += g[i] * waves[i, 0, j]
            y += g[i] * waves[i, 1, j]
        if x * x + y * y < limit2:
            return True
    return False


@inlined
def _open_differences(work: WorkSpace) -> int:
    """List the places whose d the sums g leave open, with the values of each; returns how many."""
    g = work.g
    low = work.d_low
    number = work.d_number
    count = 0
    fixed = -1
    for i in range(g.size):
        if 0 < g[i] < 4:
            work.d_places[count] = i
            low[count], number[count] = (-2.0, 3) if g[i] == 2 else (-1.0, 2)
            if fixed < 0 or (g[i] != 2 and number[fixed] == 3):
                fixed = count
            count += 1
    if count == 0:
        return 0
    # the sign of one is free, as the ring may be turned by a quarter
    if number[fixed] == 3:
        low[fixed], number[fixed] = 0.0, 2
    else:
        low[fixed], number[fixed] = 1.0, 1
    return count


@inlined
def _set_outer_differences(
    outside: int, inner: int, count: int, waves: Floats, work: WorkSpace
) -> None:
    """Choose the values d of the places from ``inner`` on, by number, and sum their waves."""
    work.d_outer[:] = np.float32(0)
    for i in range(inner, count):
        value = work.d_low[i] + np.float32(2 * (outside % work.d_number[i]))
        work.d_value[i] = np.int64(value)
        outside //= work.d_number[i]
        for axis in range(2):
            for j in range(waves.shape[2]):
                work.d_outer[axis, j] += value * waves[work.d_places[i], axis, j]


@inlined
def _set_half_sums(combination: int, inner: int, count: int, work: WorkSpace) -> None:
    """Choose the values d of the first ``inner`` places, by number, and set all sums f."""
    g = work.g
    f = work.f
    quarter = g.size
    for i in range(inner):
        work.d_value[i] = np.int64(work.d_low[i]) + 2 * (combination % work.d_number[i])
        combination //= work.d_number[i]
    for i in range(quarter):
        f[i], f[i + quarter] = g[i] // 2, g[i] // 2
    for i in range(count):
        at = work.d_places[i]
        f[at], f[at + quarter] = (g[at] + work.d_value[i]) // 2, (g[at] - work.d_value[i]) // 2


@inlined
def _set_outer_signs(around: int, within: int, count: int, waves: Floats, work: WorkSpace) -> None:
    """Choose the signs e of the places from ``within`` on, by number, and sum their waves."""
    work.e_outer[:] = np.float32(0)
    for i in range(within, count):
        sign = np.float32(2 * ((around >> (i - within)) & 1) - 1)
        at = work.e_places[i]
        for q in range(LANES):
            work.e_outer[0, q] += sign * waves[at, 0, q]
            work.e_outer[1, q] += sign * waves[at, 1, q]


@inlined
def _scan_rings(
    fold: Folding, work: WorkSpace, survivors: Words, number: int, counts: Counts
) -> int:
    """Judge all codes whose chips half a ring apart have the sums f; returns as :func:`_turns`."""
    half = work.f.size
    unit = np.uint64(1)
    one_code = np.int64(1)
    places = work.e_places
    count = 0
    twice_open = np.uint64(0)
    for i in range(half):
        if work.f[i] == 2:
            twice_open |= (unit << np.uint64(i)) | (unit << np.uint64(i + half))
        elif work.f[i] == 1:
            places[count] = i
            count += 1
    if count == 0:
        return number  # no difference, |P| = 0
    within = min(count, _WITHIN)
    blocks = _spread_signs(places, within, fold.e_waves, work.signs, work.e_table)
    size = 1 << (within - 1)
    counts[4] += one_code << (count - 1)
    for around in range(one_code << (count - within)):
        _set_outer_signs(around, within, count, fold.e_waves, work)
        reaching = _kept(
            work.e_outer, work.e_table, blocks, size, fold.limit2, work.keep, work.e_indices
        )
        counts[5] += reaching
        for index in range(reaching):
            # the sign of the first is free, as the ring may be turned by a half
            code = twice_open | (unit << np.uint64(places[0]))
            signs = work.e_indices[index] | (around << (within - 1))
            for i in range(1, count):
                code |= unit << np.uint64(places[i] + (0 if signs & 1 else half))
                signs >>= 1
            number = _turns(code, fold, work, survivors, number, counts)
            if number < 0:
                return -1
    return number


@inlined
def _scan_halves(
    fold: Folding, work: WorkSpace, survivors: Words, number: int, counts: Counts
) -> int:
    """Judge all codes whose chips a quarter apart have the sums g; returns as :func:`_turns`."""
    count = _open_differences(work)
    if count == 0:
        return number  # every f is 0 or 2 or its neighbour's: no difference, |P| = 0
    inner = 0
    size = 1
    while inner < count and size < _INNER:
        size *= work.d_number[inner]
        inner += 1
    table = work.d_table
    flat = table.reshape((table.shape[0], 2, table.shape[2] * LANES))
    size = _spread(work.d_low, work.d_number, work.d_places, inner, fold.d_waves, flat)
    outer_count = 1
    for i in range(inner, count):
        outer_count *= work.d_number[i]
    counts[2] += size * outer_count
    blocks = (size + LANES - 1) // LANES
    for outside in range(outer_count):
        _set_outer_differences(outside, inner, count, fold.d_waves, work)
        reaching = _kept(work.d_outer, table, blocks, size, fold.limit2, work.keep, work.d_indices)
        counts[3] += reaching
        for index in range(reaching):
            _set_half_sums(work.d_indices[index], inner, count, work)
            number = _scan_rings(fold, work, survivors, number, counts)
            if number < 0:
                return -1
    return number


@compiled
def scan_prefixes(first: int, until: int, fold: Folding, survivors: Words, counts: Counts) -> int:
    """Go through all codes whose folds have a prefix within a range; returns how many were written
    to ``survivors``.

    Parameters
    ----------
    first, until : int
        Range of prefixes, read as numbers to the base 5.
    fold : Folding
    survivors : (M,) uint64
        Codes that reach the limit at all 8 N samples of the circle, the first chip in the lowest
        bit.
    counts : (9,) int64
        Raised by those of :data:`COUNTS`, and by the number of codes accounted for, each way round
        and closed chips at either end included.

    Returns
    -------
    int
        -1 where ``survivors`` is too small.
    """
    prefix = fold.prefix
    suffix = fold.quarter - prefix
    binomials = np.array([1, 4, 6, 4, 1])
    work = _work_space(fold)
    number = 0
    for p in range(first, until):
        if not _letters(p, prefix, work.g, 0):
            continue
        for s in range(5**suffix):
            _letters(s, suffix, work.g, prefix)
            codes = _codes_of(work.g, binomials, fold.fewest, fold.most)
            if codes == 0:
                continue
            counts[0] += 1
            counts[8] += codes
            if _is_below(work.g, fold.g_waves, fold.limit2):
                continue
            counts[1] += 1
            number = _scan_halves(fold, work, survivors, number, counts)
            if number < 0:
                return -1
    return number
