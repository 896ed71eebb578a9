"""Uniform random codes within limits.

The codes of k open chips in p pulses are pairs of compositions (k into p runs, the rest into p + 1
gaps), a closed form. A longest run and a least period need dynamic programming over the walks of
:mod:`cep.search.limits`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cep.search.limits import CLOSED, MOST_NUMBERS, OPEN, OVER, Limits
from motdiff.types import FloatArray

IntArray = NDArray[np.intp]
_TILT_BATCH = 256  # walks by which a weight is tried
_TILT_ACCEPTED = 0.25  # share of walks drawn with a weight on pulses that keep the limit on them


def draw(limits: Limits, count: int, *, rng: np.random.Generator) -> NDArray[np.int8]:
    """Draw ``count`` codes within feasible limits, (count, n) of 0 and 1.

    All codes are equally likely, with one exception: if runs are limited by ``max_open`` or
    ``min_period``, and the table over open chips and pulses would exceed 12 million numbers (as
    for 512 chips and 16 pulses), codes of few pulses are somewhat likelier than others.
    """
    if not limits.counts_runs:
        return _draw_free(limits, count, rng)
    if _size(limits) <= MOST_NUMBERS:
        return _walks(limits, True, 0.0).draw(count, rng)
    return _draw_tilted(limits, count, rng)


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


@dataclass(frozen=True)
class _Walks:
    """Logarithms of the number of ways to go on: state, position, open chips and pulses left.

    Where the open chips or the pulses are free, their axis has length 1 and nothing moves along
    it.
    """

    limits: Limits
    log_counts: FloatArray  # (3, n + 1, K, P)
    # steps along the axis of open chips that one of them takes: 1, or 0 when they are free
    opens: int
    pulses: int
    tilt: float  # added per pulse

    @property
    def by_count(self) -> FloatArray:
        """Logarithms of the number of codes by open chips in their range, or of all."""
        low, high = (self.opens * count for count in self.limits.open_range)
        return self.log_counts[CLOSED, 0, low : high + 1, -1]

    def draw(self, count: int, rng: np.random.Generator) -> NDArray[np.int8]:
        n = self.limits.chips
        columns = map(np.array, zip(*self.limits.steps(), strict=True))
        source, open_chips, closed_chips, target, pulses, fits = (
            columns  # (S,), and (S, n + 1) of fits
        )
        open_left = _pick(self.by_count, count, rng) + self.opens * self.limits.open_range[0]
        budget = np.full(count, self.log_counts.shape[3] - 1)
        place = np.zeros(count, dtype=np.intp)
        state = np.full(count, CLOSED, dtype=np.intp)
        edges = np.zeros((count, n + 1), dtype=np.int8)
        rows = np.arange(count)
        while rows.size:
            position = place[rows]
            # (S, R): every step of every walk
            after = position + (open_chips + closed_chips)[:, None]
            k = open_left[rows] - self.opens * open_chips[:, None]
            p = budget[rows] - self.pulses * pulses[:, None]
            possible = (source[:, None] == state[rows]) & fits[:, position] & (k >= 0) & (p >= 0)
            log_count = self.log_counts[
                target[:, None], np.minimum(after, n), k.clip(0), p.clip(0)
            ]
            # the counts themselves may overflow: weights relative to the largest
            weights = np.where(possible, log_count + self.tilt * pulses[:, None], -np.inf)
            share = np.cumsum(np.exp(weights - weights.max(axis=0)), axis=0)
            # a product rounded up to the total would pick the last step, possible or not
            threshold = np.minimum(rng.random(rows.size) * share[-1], np.nextafter(share[-1], 0))
            step = (threshold >= share[:-1]).sum(axis=0)
            edges[rows, position] += pulses[step].astype(np.int8)
            pulse_ends = ((source[step] == OPEN) | (pulses[step] == 1)) & (target[step] != OPEN)
            edges[rows, position + open_chips[step]] -= pulse_ends.astype(np.int8)
            chosen = step, np.arange(rows.size)
            place[rows] = after[chosen]
            open_left[rows] = k[chosen]
            budget[rows] = p[chosen]
            state[rows] = target[step]
            rows = rows[target[step] != OVER]
        return np.cumsum(edges, axis=1, dtype=np.int8)[:, :-1]


@lru_cache(maxsize=2)
def _walks(limits: Limits, counting_pulses: bool, tilt: float) -> _Walks:
    n = limits.chips
    most_pulses = None
    if counting_pulses:
        most_pulses = limits.most_pulses
    opens = int(limits.counts_opens)
    pulses = int(most_pulses is not None)
    log_counts = np.full(
        (3, n + 1, limits.open_range[1] * opens + 1, (most_pulses or 0) + 1), -np.inf
    )
    log_counts[OVER, :, 0] = 0.0
    steps = limits.steps()
    for i in reversed(range(n + 1)):
        for state, open_chips, closed_chips, next_state, starts, fits in steps:
            if fits[i]:
                onwards = log_counts[next_state, i + open_chips + closed_chips] + tilt * starts
                _add(log_counts[state, i], onwards, open_chips * opens, pulses * starts)
    return _Walks(limits, log_counts, opens, pulses, tilt)


def _add(total: FloatArray, log_counts: FloatArray, opens: int, pulses: int) -> None:
    """Add, in logarithms and in place, ways that are some open chips and pulses short."""
    rows = max(len(total) - opens, 0)
    columns = total.shape[1] - pulses
    target = total[opens:, pulses:]
    np.logaddexp(target, log_counts[:rows, :columns], out=target)


def _size(limits: Limits) -> int:
    """Numbers in the table over open chips and pulses."""
    opens = limits.open_range[1] * limits.counts_opens + 1
    return 3 * (limits.chips + 1) * opens * ((limits.most_pulses or 0) + 1)


def _draw_tilted(limits: Limits, count: int, rng: np.random.Generator) -> NDArray[np.int8]:
    """Draw with a weight per pulse, and leave out codes of too many pulses."""
    walks = _walks(limits, False, _tilt(limits))
    accepted = np.empty((0, limits.chips), dtype=np.int8)
    while len(accepted) < count:
        codes = walks.draw(2 * count, rng)
        accepted = np.concatenate([accepted, codes[_few_pulses(limits, codes)]])
    return accepted[:count]


@lru_cache(maxsize=16)
def _tilt(limits: Limits) -> float:
    """Log weight per pulse with which a good share of the walks keeps the limit on pulses."""
    tilt = 0.0
    rng = np.random.default_rng(0)  # the weight must not depend on the caller's draws
    while (
        _few_pulses(limits, _walks(limits, False, tilt).draw(_TILT_BATCH, rng)).mean()
        < _TILT_ACCEPTED
    ):
        tilt = 2 * tilt - 0.25
    return tilt


def _few_pulses(limits: Limits, codes: NDArray[np.int8]) -> NDArray[np.bool_]:
    pulses = (np.diff(codes, axis=1, prepend=0) > 0).sum(axis=1)
    return np.asarray(pulses <= (limits.runs.max_pulses or limits.chips), dtype=np.bool_)


def _pick(log_weights: FloatArray, count: int, rng: np.random.Generator) -> IntArray:
    """Draw ``count`` indices with these relative weights."""
    share = np.cumsum(np.exp(log_weights - log_weights.max()))
    # an index without weight is never picked: ties go to the right, and the last with weight is
    # the first at the total
    picked = np.searchsorted(share, rng.random(count) * share[-1], side="right")
    return np.asarray(np.minimum(picked, np.searchsorted(share, share[-1])), dtype=np.intp)
