"""Uniform random codes within limits.

The codes of k open chips in p pulses are pairs of compositions (k into p runs, the rest into p + 1
gaps), a closed form. A longest run and a least period need dynamic programming over the walks of
:mod:`cep.search.limits`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cep.search.limits import CLOSED, OPEN, OVER, Limits
from motdiff.types import FloatArray

IntArray = NDArray[np.intp]
_MOST_COUNTS = 2**26  # numbers of a table of walks: 512 MB
_DRAWN = 256  # codes at a time, of which those whose complement keeps the limits are left
_MOST_DRAWS = 256


def draw(limits: Limits, count: int, *, rng: np.random.Generator) -> NDArray[np.int8]:
    """Draw ``count`` codes within feasible limits, all equally likely: (count, n) of 0 and 1.

    Raises
    ------
    ValueError
        If there are too many chips, thousands, for a limit on pulses beside one on their length or
        period; or of 65,536 codes the complement of none keeps the limits, where it must.
    """
    if not limits.with_complement:
        return _draw_alone(limits, count, rng)
    codes = np.empty((0, limits.chips), dtype=np.int8)
    for _ in range(_MOST_DRAWS):
        candidates = _draw_alone(limits, max(count, _DRAWN), rng)
        codes = np.concatenate([codes, candidates[limits.satisfied(candidates)]])
        if len(codes) >= count:
            return codes[:count]
    raise ValueError(
        f"frames: no code of {limits.chips} chips was drawn whose complement keeps the shutter's"
        " limits as well"
    )


def _draw_alone(limits: Limits, count: int, rng: np.random.Generator) -> NDArray[np.int8]:
    """Draw codes that keep the limits by themselves."""
    if limits.counts_runs:
        return _draw_walks(limits, count, rng)
    return _draw_free(limits, count, rng)


# -- no pulse's length decides what may follow: compositions --------------------------------------


@lru_cache(maxsize=4)
def _free_table(limits: Limits) -> FloatArray:
    """Logarithm of the number of codes, by open chips (row) and pulses (column)."""
    n = limits.chips
    low = max(limits.open_range[0], 1)
    high = min(limits.open_range[1], limits.chips)
    most_pulses = limits.most_pulses or limits.fitting_pulses
    k = np.arange(n + 1)[:, None]
    p = np.arange(most_pulses + 1)[None]
    spare_open = k - p * limits.runs.min_open
    spare_closed = n - k - (p - 1) * limits.runs.min_closed
    possible = (k >= low) & (k <= high) & (p >= 1) & (spare_open >= 0) & (spare_closed >= 0)
    log_factorial = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, 2 * n + 2)))])

    def log_compositions(total: IntArray, parts: IntArray) -> FloatArray:
        # stars and bars: C(total + parts - 1, parts - 1) ways
        total = np.where(possible, total, 0)
        parts = np.where(possible, parts, 1)
        chosen = log_factorial[total + parts - 1] - log_factorial[total] - log_factorial[parts - 1]
        return np.asarray(chosen, dtype=np.float64)

    table = np.where(
        possible,
        log_compositions(spare_open, p + 0 * k) + log_compositions(spare_closed, p + 1 + 0 * k),
        -np.inf,
    )
    table.setflags(write=False)
    return table


def _draw_free(limits: Limits, count: int, rng: np.random.Generator) -> NDArray[np.int8]:
    table = _free_table(limits)
    k, pulses = np.divmod(_pick(table.ravel(), count, rng), table.shape[1])
    most_pulses = int(pulses.max(initial=1))
    index = np.arange(most_pulses)
    lengths = _compositions(k - pulses * limits.runs.min_open, pulses, most_pulses, rng)
    lengths += limits.runs.min_open * (index < pulses[:, None])
    gaps = _compositions(
        limits.chips - k - (pulses - 1) * limits.runs.min_closed, pulses + 1, most_pulses + 1, rng
    )[:, :-1]
    gaps[:, 1:] += limits.runs.min_closed * (index[1:] < pulses[:, None])
    stops = np.cumsum(gaps + lengths, axis=1)
    return _filled(limits.chips, stops - lengths, stops, index < pulses[:, None])


def _compositions(
    total: IntArray, parts: IntArray, width: int, rng: np.random.Generator
) -> IntArray:
    """Split (R,) totals into (R,) parts, all splits equally likely: (R, width), zero-filled."""
    slots = total + parts - 1
    most_slots = int(slots.max(initial=0))
    keys = np.where(
        np.arange(most_slots) < slots[:, None], rng.random((len(total), most_slots)), 2.0
    )
    # the parts - 1 smallest keys say where the bars stand among the stars
    bars = np.argsort(keys, axis=1)[:, : width - 1]
    bars = np.pad(bars, ((0, 0), (0, width - 1 - bars.shape[1])))
    bars = np.sort(
        np.where(np.arange(width - 1) < parts[:, None] - 1, bars, slots[:, None]), axis=1
    )
    before = np.full((len(total), 1), -1)
    parts_with_bars = np.diff(np.concatenate([before, bars, slots[:, None]], axis=1))
    return np.asarray(np.maximum(parts_with_bars - 1, 0), dtype=np.intp)


def _filled(
    chips: int, starts: IntArray, stops: IntArray, is_pulse: NDArray[np.bool_]
) -> NDArray[np.int8]:
    steps = np.zeros((len(starts), chips + 1), dtype=np.int8)
    rows = np.nonzero(is_pulse)[0]
    steps[rows, starts[is_pulse]] += 1
    steps[rows, stops[is_pulse]] -= 1
    return np.cumsum(steps, axis=1, dtype=np.int8)[:, :-1]


# -- otherwise: walks -----------------------------------------------------------------------------


def _draw_walks(limits: Limits, count: int, rng: np.random.Generator) -> NDArray[np.int8]:
    n = limits.chips
    opens, pulses = _counted(limits)
    log_counts = _walk_counts(limits)
    columns = map(np.array, zip(*limits.steps(), strict=True))
    # of each step, (S,); where it fits, (S, n + 1)
    source, open_chips, closed_chips, target, starts, fits = columns
    open_left = _pick(_by_open_chips(limits), count, rng) + opens * limits.open_range[0]
    pulses_left = np.full(count, log_counts.shape[3] - 1)
    place = np.zeros(count, dtype=np.intp)
    state = np.full(count, CLOSED, dtype=np.intp)
    edges = np.zeros((count, n + 1), dtype=np.int8)
    rows = np.arange(count)
    while rows.size:
        position = place[rows]
        # (S, R): every step of every walk
        after = position + (open_chips + closed_chips)[:, None]
        k = open_left[rows] - opens * open_chips[:, None]
        p = pulses_left[rows] - pulses * starts[:, None]
        possible = (source[:, None] == state[rows]) & fits[:, position] & (k >= 0) & (p >= 0)
        log_count = log_counts[target[:, None], np.minimum(after, n), k.clip(0), p.clip(0)]
        # the counts themselves may overflow: weights relative to the largest
        weights = np.where(possible, log_count, -np.inf)
        share = np.cumsum(np.exp(weights - weights.max(axis=0)), axis=0)
        # a product rounded up to the total would pick the last step, possible or not
        threshold = np.minimum(rng.random(rows.size) * share[-1], np.nextafter(share[-1], 0))
        step = (threshold >= share[:-1]).sum(axis=0)
        edges[rows, position] += starts[step].astype(np.int8)
        pulse_ends = ((source[step] == OPEN) | (starts[step] == 1)) & (target[step] != OPEN)
        edges[rows, position + open_chips[step]] -= pulse_ends.astype(np.int8)
        chosen = step, np.arange(rows.size)
        place[rows] = after[chosen]
        open_left[rows] = k[chosen]
        pulses_left[rows] = p[chosen]
        state[rows] = target[step]
        rows = rows[target[step] != OVER]
    return np.cumsum(edges, axis=1, dtype=np.int8)[:, :-1]


def _counted(limits: Limits) -> tuple[int, int]:
    """Whether open chips are counted, and pulses, 1 or 0: limits on the others never bind."""
    return int(limits.counts_opens), int(limits.most_pulses is not None)


@lru_cache(maxsize=2)
def _walk_counts(limits: Limits) -> FloatArray:
    """Logarithms of the number of ways to go on: state, position, open chips and pulses left.

    The axis of what is not counted has length 1, and nothing moves along it.
    """
    n = limits.chips
    opens, pulses = _counted(limits)
    shape = (3, n + 1, limits.open_range[1] * opens + 1, (limits.most_pulses or 0) + 1)
    if np.prod(shape) > _MOST_COUNTS:
        raise ValueError(
            f"chips: {n} are too many for a limit on pulses beside one on their length or period"
        )
    log_counts = np.full(shape, -np.inf)
    log_counts[OVER, :, 0] = 0.0
    steps = limits.steps()
    for i in reversed(range(n + 1)):
        for state, open_chips, closed_chips, next_state, starts, fits in steps:
            if fits[i]:
                target = log_counts[state, i, open_chips * opens :, pulses * starts :]
                counts, columns = target.shape
                onwards = log_counts[next_state, i + open_chips + closed_chips]
                np.logaddexp(target, onwards[:counts, :columns], out=target)
    return log_counts


def _by_open_chips(limits: Limits) -> FloatArray:
    """Logarithms of the number of codes by open chips in their range, or of all."""
    low, high = (_counted(limits)[0] * count for count in limits.open_range)
    return _walk_counts(limits)[CLOSED, 0, low : high + 1, -1]


def _pick(log_weights: FloatArray, count: int, rng: np.random.Generator) -> IntArray:
    """Draw ``count`` indices with these relative weights."""
    share = np.cumsum(np.exp(log_weights - log_weights.max()))
    # an index without weight is never picked: ties go to the right, and the last with weight is
    # the first at the total
    picked = np.searchsorted(share, rng.random(count) * share[-1], side="right")
    return np.asarray(np.minimum(picked, np.searchsorted(share, share[-1])), dtype=np.intp)
