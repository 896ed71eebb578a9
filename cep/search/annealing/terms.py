"""Cost terms of the compiled loops: sums over frequencies, a row of the basis per changed chip.

A code's cost is made of sums over frequencies of terms that are never negative, so a move is
refused as soon as the terms seen exceed what would be accepted. Frequencies come in blocks of 64,
the worst ones first.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled, inlined
from cep.search.cost import CodeCost
from cep.search.objectives import FLATNESS, NO_TERM, RECIPROCAL, STEEP, Columns
from cep.search.problem import SearchProblem
from motdiff.types import FloatArray

Floats = NDArray[np.float32]
Ints = NDArray[np.int64]
BLOCK = 64  # frequencies: of constant length, so that loops become vector instructions
SMALLEST = np.float32(1e-8)  # of |P|^2: a chip has |P| of about 1
_STEEP_DB = 2.5  # per decade of a sum of 1 / |P|^8: its fourth root counts
_PLAIN_DB = 10.0


class Tables(NamedTuple):
    """Tables of a problem for the compiled loops; nb blocks, those of one part side by side.

    Attributes
    ----------
    rows : (chips, V, nb, 2, 64) float32
        Change of the OTF, in chips, when a chip opens: real and imaginary parts. V is 4 where its
        neighbours matter (2 left + right, open or closed), else 1.
    layout : (parts, 3) int64
        First block, one past the last, and scenario of each part: a scenario in one direction.
    kinds, weights : (objectives,) int64, float64
    scale, offset : (objectives, nb, Q, 64) float32
        The terms' x is ``light scale |P|^2 + offset``, of which Q belong to each frequency. The
        flatness sums ``scale (|P|^2 + offset)`` and its root.
    start : (1, nb, 2, 64) float32
        OTF without an open chip: 0, or minus half of the open shutter's of two cameras.
    light : (objectives, chips + 1) float32
        Factor of |P|^2 by number of open chips.
    shares : (scenarios,) float64
    mean_rule : bool
        Whether scenarios count by their shares, or as the worst.
    """

    rows: Floats
    layout: Ints
    kinds: Ints
    weights: NDArray[np.float64]
    scale: Floats
    offset: Floats
    start: Floats
    light: Floats
    shares: NDArray[np.float64]
    mean_rule: bool


@inlined
def _block_power(
    rows: Floats, otf: Floats, picked: Ints, count: int, chips: int, block: int, work: Floats
) -> None:
    """|P|^2 of a changed code on one block, summed over frames, into work[2]; see :func:`turn`."""
    for f in range(BLOCK):
        work[2, f] = SMALLEST
    for frame in range(otf.shape[0]):
        for f in range(BLOCK):
            work[0, f] = otf[frame, block, 0, f]
            work[1, f] = otf[frame, block, 1, f]
        for c in range(count):
            chip = picked[c, 0]
            variant = picked[c, 1]
            if chip // chips != frame:
                continue
            if picked[c, 2] > 0:
                for f in range(BLOCK):
                    work[0, f] += rows[chip, variant, block, 0, f]
                    work[1, f] += rows[chip, variant, block, 1, f]
            else:
                for f in range(BLOCK):
                    work[0, f] -= rows[chip, variant, block, 0, f]
                    work[1, f] -= rows[chip, variant, block, 1, f]
        for f in range(BLOCK):
            work[2, f] += work[0, f] * work[0, f] + work[1, f] * work[1, f]


@inlined
def _pair_sum(
    rows: Floats,
    otf: Floats,
    scale: Floats,
    offset: Floats,
    light: np.float32,
    plain: np.float32,
    sharp: np.float32,
    picked: Ints,
    block: int,
) -> np.float32:
    """One objective's terms on one block for the usual move: two chips of a single frame."""
    # nothing is stored on the way: all of it stays in registers
    unit = np.float32(1)
    total = np.float32(0)
    a = picked[0, 0]
    u = picked[0, 1]
    b = picked[1, 0]
    v = picked[1, 1]
    s = np.float32(picked[0, 2])
    t = np.float32(picked[1, 2])
    for f in range(BLOCK):
        x = otf[0, block, 0, f] + s * rows[a, u, block, 0, f] + t * rows[b, v, block, 0, f]
        y = otf[0, block, 1, f] + s * rows[a, u, block, 1, f] + t * rows[b, v, block, 1, f]
        term = unit / (
            light * scale[0, block, 0, f] * (x * x + y * y + SMALLEST) + offset[0, block, 0, f]
        )
        square = term * term
        total += plain * term + sharp * square * square
    return total


@inlined
def _pair_sums(
    tables: Any,
    otf: Floats,
    open_chips: int,
    picked: Ints,
    limit: float,
    sums: NDArray[np.float64],
) -> bool:
    """As :func:`sums_over` for the usual move."""
    rows = tables.rows
    layout = tables.layout
    scale = tables.scale
    offset = tables.offset
    light = tables.light[0, open_chips]
    steep = tables.kinds[0] == STEEP
    plain = np.float32(not steep)  # a branch would keep vector instructions away
    sharp = np.float32(steep)
    for band in range(layout.shape[0]):
        total = 0.0
        for block in range(layout[band, 0], layout[band, 1]):
            total += float(_pair_sum(rows, otf, scale, offset, light, plain, sharp, picked, block))
            if total > limit:
                return False
        sums[0, band, 0] = total
    return True


@compiled
def sums_over(
    tables: Any,
    otf: Floats,
    picked: Ints,
    count: int,
    chips: int,
    open_chips: int,
    limit: float,
    work: Floats,
    sums: NDArray[np.float64],
) -> bool:
    """Sum all terms of a changed code; False as soon as the first sum exceeds ``limit``."""
    rows = tables.rows
    layout = tables.layout
    kinds = tables.kinds
    scale = tables.scale
    offset = tables.offset
    unit = np.float32(1)
    for band in range(layout.shape[0]):
        for o in range(kinds.size):
            sums[o, band, 0] = 0.0
            sums[o, band, 1] = 0.0
        for block in range(layout[band, 0], layout[band, 1]):
            _block_power(rows, otf, picked, count, chips, block, work)
            for o in range(kinds.size):
                total = np.float32(0)
                mean = np.float32(0)
                light = tables.light[o, open_chips]
                if kinds[o] == STEEP:
                    for f in range(BLOCK):
                        term = unit / (scale[o, block, 0, f] * work[2, f] + offset[o, block, 0, f])
                        square = term * term
                        total += square * square
                elif kinds[o] == RECIPROCAL:
                    for q in range(scale.shape[2]):
                        for f in range(BLOCK):
                            total += unit / (
                                light * scale[o, block, q, f] * work[2, f] + offset[o, block, q, f]
                            )
                else:  # flatness: mean and mean square of |P|, whose difference is the variance
                    for f in range(BLOCK):
                        power = work[2, f] + offset[o, block, 0, f]
                        total += scale[o, block, 0, f] * power
                        mean += scale[o, block, 0, f] * np.sqrt(power)
                sums[o, band, 0] += total
                sums[o, band, 1] += mean
            if sums[0, band, 0] > limit:
                return False
    return True


@compiled
def decibels(tables: Any, sums: NDArray[np.float64], open_chips: int) -> float:
    """Cost of the sums: of a scenario's directions the worse one; of scenarios as of the rule."""
    layout = tables.layout
    kinds = tables.kinds
    worst = -np.inf
    mean = 0.0
    scenario = -1
    scenario_cost = -np.inf
    for band in range(layout.shape[0]):
        total = 0.0
        for o in range(kinds.size):
            value = sums[o, band, 0]
            if kinds[o] == FLATNESS:
                # rounding must not make a variance negative
                variance = max(value - sums[o, band, 1] ** 2, 1e-12 * value)
                value = variance * tables.light[o, open_chips]
            per_decade = _STEEP_DB if kinds[o] == STEEP else _PLAIN_DB
            total += tables.weights[o] * per_decade * np.log10(value)
        if layout[band, 2] != scenario:
            if scenario >= 0:
                mean += tables.shares[scenario] * scenario_cost
            scenario = layout[band, 2]
            scenario_cost = total
        else:
            scenario_cost = max(scenario_cost, total)
        worst = max(worst, total)
    mean += tables.shares[scenario] * scenario_cost
    return mean if tables.mean_rule else worst


@inlined
def one_sum_decides(tables: Any) -> bool:
    """Whether one sum over frequencies decides: the evaluation of a move may then end early."""
    return len(tables.kinds) == 1 and tables.kinds[0] != FLATNESS and not tables.mean_rule


@inlined
def sum_of_cost(tables: Any, cost_db: float) -> float:
    """Sum that costs so much, where one sum decides."""
    per_decade: float = tables.weights[0] * (_STEEP_DB if tables.kinds[0] == STEEP else _PLAIN_DB)
    total: float = 10.0 ** (cost_db / per_decade)
    return total


@inlined
def turn(
    code: NDArray[np.int8], changed: Ints, count: int, chips: int, variants: int, picked: Ints
) -> int:
    """Turn the changed chips over, one by one; how many more are open.

    ``picked`` (at least 2, 3) takes chip, variant, and 1 for opening, -1 for closing, 0 for
    neither.
    """
    more_open = 0
    for c in range(count):
        j = changed[c]
        picked[c, 0], picked[c, 1], picked[c, 2] = j, 0, 1 - 2 * code[j]
        if variants == 4:
            place = j % chips
            # beside a frame's ends the shutter is closed
            if place > 0:
                picked[c, 1] += 2 * code[j - 1]
            if place < chips - 1:
                picked[c, 1] += code[j + 1]
        more_open += picked[c, 2]
        code[j] = 1 - code[j]
    if count == 1:  # the usual move has two rows: the second with the sign 0
        picked[1, 0], picked[1, 1], picked[1, 2] = picked[0, 0], picked[0, 1], 0
    return more_open


@inlined
def judge(
    tables: Any,
    otf: Floats,
    picked: Ints,
    count: int,
    chips: int,
    open_chips: int,
    limit: float,
    work: Floats | None,
    sums: NDArray[np.float64],
) -> bool:
    """Sum the terms of a code changed by ``picked``; False as soon as a sum exceeds ``limit``."""
    # without work space only the usual moves are compiled
    if work is None:
        return _pair_sums(tables, otf, open_chips, picked, limit, sums)
    return sums_over(tables, otf, picked, count, chips, open_chips, limit, work, sums)


@inlined
def add_rows(rows: Floats, otf: Floats, picked: Ints, count: int, chips: int) -> None:
    """Add the rows of the changed chips to the OTF, in place."""
    for c in range(count):
        sign = np.float32(picked[c, 2])
        row = rows[picked[c, 0], picked[c, 1]].ravel()
        changed = otf[picked[c, 0] // chips].ravel()  # a view, as rows are
        for f in range(changed.size):
            changed[f] += sign * row[f]


def lay_out(code_cost: CodeCost) -> Tables:
    """Pack each part's columns into blocks, with the tables of each objective."""
    problem = code_cost.problem
    columns: list[NDArray[np.intp]] = []
    layout: list[tuple[int, int, int]] = []
    blocks = 0
    for motion in code_cost.parts:
        # the ends of a straight band may weigh nothing
        heavy = np.flatnonzero(motion.samples.weight > 0) + motion.columns.start
        size = -(-heavy.size // BLOCK)
        columns.append(np.pad(heavy, (0, size * BLOCK - heavy.size), constant_values=-1))
        layout.append((blocks, blocks + size, motion.scenario))
        blocks += size
    places = np.concatenate(columns)
    filling = places < 0
    weight = np.concatenate([motion.samples.weight for motion in code_cost.parts])[places]
    chips = problem.chips
    mix = problem.criteria
    samples = ~filling
    sampled = Columns(
        weight[samples],
        code_cost.priors[places[samples]],
        code_cost.shares_across[places[samples]],
        chips,
    )
    terms = [criterion.terms(sampled) for criterion, _ in mix]
    across = max(len(factors) for factors, _ in terms)
    scale = np.zeros((len(mix), across, places.size))
    # columns that fill up a block have no terms
    offset = np.full((len(mix), across, places.size), NO_TERM)
    # where the objectives differ in their nodes across, the others' terms are 0 as well
    for o, (factors, offsets) in enumerate(terms):
        scale[o, : len(factors), samples] = factors.T
        offset[o, : len(factors), samples] = offsets.T
    counts = np.arange(chips + 1.0)
    if problem.frames == 2:  # both cameras' mean
        counts = np.full(chips + 1, chips / 2)
    light = np.array([criterion.light(counts, code_cost.noise) for criterion, _ in mix])
    kinds = [criterion.kind for criterion, _ in mix]
    start = np.zeros((2, places.size))
    if code_cost.open_half is not None:
        start[:, samples] = -chips * code_cost.open_half[:, places[samples]]
    floor = (start**2).sum(axis=0)[samples]
    for o, kind in enumerate(kinds):
        if kind == FLATNESS:
            offset[o][:, samples] += floor
        else:
            offset[o][:, samples] += light[o, 1] * scale[o][:, samples] * floor
    rows = (chips * code_cost.rows)[..., np.where(filling, 0, places)]
    rows[..., filling] = 0
    packed = rows.reshape(*rows.shape[:3], -1, BLOCK).transpose(0, 1, 3, 2, 4)
    return Tables(
        rows=_contiguous(packed),
        layout=np.array(layout, dtype=np.int64),
        kinds=np.array(kinds, dtype=np.int64),
        weights=np.array([weight for _, weight in mix]),
        scale=_contiguous(scale.reshape(len(mix), across, -1, BLOCK).transpose(0, 2, 1, 3)),
        offset=_contiguous(offset.reshape(len(mix), across, -1, BLOCK).transpose(0, 2, 1, 3)),
        start=_contiguous(start.reshape(1, 2, -1, BLOCK).transpose(0, 2, 1, 3)),
        light=_contiguous(light),
        shares=code_cost.scenario_shares,
        mean_rule=problem.rule == "mean",
    )


def work_space(tables: Tables, problem: SearchProblem) -> NDArray[np.float32] | None:
    """Work space for the compiled loops: None where every move is the usual one.

    It then changes two chips at most, and one plain sum decides.
    """
    plain = len(tables.kinds) == 1 and tables.kinds[0] != FLATNESS and tables.scale.shape[2] == 1
    if plain and not problem.limits_runs:
        return None
    return np.empty((3, BLOCK), np.float32)


def _contiguous(array: FloatArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, dtype=np.float32)
