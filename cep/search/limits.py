"""Limits of a code, the codes that keep them as walks, and whether there are any.

A code is a walk between states. *Closed* may stay closed or start a pulse, *open* may stay open,
close for a gap, or close for good (*over*); a pulse starts with ``min_open`` chips at once and a
gap with ``min_closed``, so no state needs to count a run. Where a pulse may become too long, or
end too early for the next one's start, each of its lengths is a step of its own, from closed to
the end of its gap. Every code within the limits is exactly one walk; the code nearest to a given
one is a shortest walk, from the end to the start.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import is_whole
from motdiff.types import BoolArray

CLOSED = 0  # states of a walk
OPEN = 1
OVER = 2
_MOST_NUMBERS = 3 * 2**22  # of a table over walks: 96 MB
_NEVER = 1 << 30  # pulses, or changes, of a code that does not exist: sums of two fit in int64


class Step(NamedTuple):
    """A step of a walk.

    Attributes
    ----------
    state : int
        State that it leads on from: CLOSED or OPEN.
    open_chips, closed_chips : int
        Chips that it opens, and then closes.
    next_state : int
        State that it leads to: CLOSED, OPEN, or OVER, where all that follows is closed.
    pulses : int
        1 if it starts a pulse, else 0.
    fits : (n + 1,) bool
        Whether the code's length allows it at each chip.
    """

    state: int
    open_chips: int
    closed_chips: int
    next_state: int
    pulses: int
    fits: BoolArray


@dataclass(frozen=True, kw_only=True)
class RunLimits:
    """Limits of a shutter on the runs of open and closed chips of a code.

    Parameters
    ----------
    min_open, min_closed : int
        Shortest open run, and shortest closed run between two open ones: the shutter rests closed
        before and after.
    max_pulses : int, optional
        Most open runs.
    max_open : int, optional
        Longest open run.
    min_period : int
        Fewest chips from the start of one open run to the start of the next. Codes are not their
        mirror image's equals then: it swaps starts and ends.

    Raises
    ------
    ValueError
        If a number is not whole or below 1.

    Examples
    --------
    A shutter that opens for two chips or more, four times at most:

    >>> RunLimits(min_open=2, max_pulses=4).max_pulses
    4
    """

    min_open: int = 1
    min_closed: int = 1
    max_open: int | None = None
    min_period: int = 1
    max_pulses: int | None = None

    def __post_init__(self) -> None:
        for name in ("min_open", "min_closed", "max_pulses", "max_open", "min_period"):
            value = getattr(self, name)
            if value is None and name in ("max_pulses", "max_open"):
                continue
            if not is_whole(value) or value < 1:
                raise ValueError(f"{name}: must be a whole number of at least 1, got {value!r}")
            object.__setattr__(self, name, int(value))

    def tightened(self, limits: RunLimits) -> RunLimits:
        """Return the limits of codes that keep these and others.

        Examples
        --------
        >>> limits = RunLimits(min_open=2, max_open=9)
        >>> limits.tightened(RunLimits(min_closed=3, max_open=5)).max_open
        5
        """

        def smallest(*values: int | None) -> int | None:
            # None is no limit
            return min((limit for limit in values if limit is not None), default=None)

        return RunLimits(
            min_open=max(self.min_open, limits.min_open),
            min_closed=max(self.min_closed, limits.min_closed),
            max_pulses=smallest(self.max_pulses, limits.max_pulses),
            max_open=smallest(self.max_open, limits.max_open),
            min_period=max(self.min_period, limits.min_period),
        )


@dataclass(frozen=True)
class Limits:
    """Limits of a code of ``chips`` chips.

    Parameters
    ----------
    chips : int
    open_range : (int, int)
        Fewest and most open chips.
    runs : RunLimits
    with_complement : bool
        Whether the code that is open where this one is closed must keep them too, as a second
        shutter plays it. The walks know only what both ask of the runs between two others.
    """

    chips: int
    open_range: tuple[int, int]
    runs: RunLimits = RunLimits()
    with_complement: bool = False

    @classmethod
    def of_pair(cls, chips: int, open_range: tuple[int, int], runs: RunLimits) -> Limits:
        """Limits that a code and its complement both keep, of the limits of one shutter.

        Examples
        --------
        >>> limits = Limits.of_pair(10, (2, 7), RunLimits(min_open=2))
        >>> limits.open_range
        (3, 7)
        >>> limits.satisfied(np.array([[0, 0, 0, 1, 1, 1, 1, 0, 0, 0], [0, 1, 1, 1] + [0] * 6]))
        array([ True, False])
        """
        low, high = open_range
        fewest = max(low, runs.min_open)
        # a gap between two pulses is a pulse of the complement
        gap = max(runs.min_closed, runs.min_open)
        return cls(
            chips,
            (max(fewest, chips - high), min(high, chips - fewest)),
            replace(runs, min_closed=gap),
            with_complement=True,
        )

    @property
    def counts_runs(self) -> bool:
        """Whether a pulse's length matters: for its longest length, or for the gap after it."""
        return self.longest < self.chips or self.period > self.runs.min_open + self.runs.min_closed

    @property
    def longest(self) -> int:
        """Longest open run that any code within the light can have."""
        light = min(self.open_range[1], self.chips)
        if self.runs.max_open is None or self.runs.max_open >= light:
            return self.chips
        return self.runs.max_open

    @property
    def period(self) -> int:
        """Fewest chips from the start of one pulse to the start of the next, by all limits."""
        return max(self.runs.min_period, self.runs.min_open + self.runs.min_closed)

    @property
    def fitting_pulses(self) -> int:
        """Most pulses for which there is time."""
        return 1 + (self.chips - self.runs.min_open) // self.period  # the last needs no gap

    @property
    def counts_opens(self) -> bool:
        """Whether ``open_range`` excludes codes that the other limits allow."""
        return self.open_range[0] > self.runs.min_open or self.open_range[1] < self.chips

    @property
    def most_pulses(self) -> int | None:
        """Most pulses, or None when so many never fit anyway."""
        if self.runs.max_pulses is None or self.runs.max_pulses >= self.fitting_pulses:
            return None
        return self.runs.max_pulses

    def steps(self) -> list[Step]:
        """List the steps from CLOSED, then those from OPEN."""
        gap = self.runs.min_closed

        def step(state: int, open_chips: int, closed_chips: int, next_state: int) -> Step:
            fits = np.arange(self.chips + 1) + open_chips + closed_chips <= self.chips
            starts = int(state == CLOSED and open_chips > 0)
            return Step(state, open_chips, closed_chips, next_state, starts, fits)

        bounded = self.longest < self.chips  # then each length of a pulse is a step of its own
        # longer pulses may last and end as they like: nothing needs to remember when they began
        free = min(max(self.runs.min_open, self.runs.min_period - gap), self.chips + 1)
        steps = [step(CLOSED, 0, 1, CLOSED)]
        if not bounded:
            steps.append(step(CLOSED, free, 0, OPEN))
        for length in range(self.runs.min_open, self.longest + 1 if bounded else free):
            steps += [
                step(CLOSED, length, max(gap, self.runs.min_period - length), CLOSED),
                step(CLOSED, length, 0, OVER),
            ]
        return [*steps, step(OPEN, 1, 0, OPEN), step(OPEN, 0, gap, CLOSED), step(OPEN, 0, 0, OVER)]

    def satisfied(self, codes: NDArray[np.integer] | BoolArray) -> BoolArray:
        """Which of (R, n) codes keep every limit, (R,) bool."""
        is_open = np.asarray(codes) != 0
        ok = self._keep(is_open)
        if self.with_complement:
            ok &= self._keep(~is_open)
        return ok

    def _keep(self, is_open: BoolArray) -> BoolArray:
        """Which of (R, n) codes, each by itself, keep the limits."""
        runs = self.runs
        count = is_open.sum(axis=1)
        ok = (count >= max(self.open_range[0], runs.min_open)) & (count <= self.open_range[1])
        # a run is long enough if every chip of it lies in a window of that length: an opening
        if runs.min_open > 1:
            ok &= (_opening(is_open, runs.min_open) == is_open).all(axis=1)
        if runs.min_closed > 1:
            # before the first and after the last pulse the shutter stays closed
            is_closed = np.pad(
                ~is_open, ((0, 0), (runs.min_closed, runs.min_closed)), constant_values=True
            )
            ok &= (_opening(is_closed, runs.min_closed) == is_closed).all(axis=1)
        if runs.max_open is not None and runs.max_open < self.chips:
            ok &= ~_opening(is_open, runs.max_open + 1).any(axis=1)
        if runs.max_pulses is not None:
            ok &= _starts(is_open).sum(axis=1) <= runs.max_pulses
        if runs.min_period > 1:
            period = min(runs.min_period, self.chips)
            # pulses before each chip
            pulses_begun = np.pad(_starts(is_open).cumsum(axis=1), ((0, 0), (1, 0)))
            ok &= (pulses_begun[:, period:] - pulses_begun[:, :-period] <= 1).all(axis=1)
        return np.asarray(ok, dtype=np.bool_)


@lru_cache(maxsize=64)
def feasible(limits: Limits) -> bool:
    """Whether any code keeps the limits, exactly."""
    low = max(limits.open_range[0], 1)
    high = min(limits.open_range[1], limits.chips)
    if low > high or limits.runs.min_open > high:
        return False
    fewest = _fewest_pulses(limits)
    most_pulses = limits.runs.max_pulses or limits.chips
    return bool(fewest[low : high + 1].min() <= most_pulses)


def conflicting(limits: Limits) -> tuple[str, ...]:
    """Name a smallest set of limits that no code keeps together; none if feasible."""
    if feasible(limits):
        return ()
    # deletion filter: a limit without which codes exist belongs to the set, others are dropped
    names = []
    for name in ("open_range", *(run_limit.name for run_limit in fields(RunLimits))):
        if name == "open_range":
            without = replace(limits, open_range=(1, limits.chips))
        else:
            without = replace(
                limits, runs=replace(limits.runs, **{name: getattr(RunLimits(), name)})
            )
        if without == limits:
            continue
        if feasible(without):
            names.append(name)
        else:
            limits = without
    return tuple(names)


def check_feasible(limits: Limits) -> None:
    """Refuse limits that no code keeps.

    Raises
    ------
    ValueError
        The line names a smallest set of limits that conflict.
    """
    names = conflicting(limits)
    if not names:
        return
    values = {**asdict(limits.runs), "open_range": "{}..{}".format(*limits.open_range)}
    words = [f"{name} {values[name]}" for name in names]
    code = f"no code of {limits.chips} chips keeps"
    if len(words) == 1:
        raise ValueError(f"{words[0]}: {code} it")
    listed = f"{', '.join(words[:-1])} and {words[-1]}"
    number = {2: "both"}.get(len(words), f"all {len(words)}")
    raise ValueError(f"{listed} conflict: {code} {number}")


def _fewest_pulses(limits: Limits) -> NDArray[np.int64]:
    """Fewest pulses of a code with each number of open chips, (n + 1,)."""
    open_chips = np.arange(limits.chips + 1)
    pulses = np.maximum(-(-open_chips // limits.longest), 1)
    # all but the last take a period at least, and within it may be open but for the gap
    full = min(limits.longest, limits.period - limits.runs.min_closed)
    span = (pulses - 1) * limits.period + np.maximum(
        open_chips - (pulses - 1) * full, limits.runs.min_open
    )
    # more pulses would take longer, and more open chips
    return np.where(
        (pulses * limits.runs.min_open <= open_chips) & (span <= limits.chips), pulses, _NEVER
    )


def nearest(limits: Limits, code: NDArray[np.integer] | BoolArray) -> NDArray[np.int8] | None:
    """Find the code within feasible limits that differs from a code (n,) in the fewest chips.

    Returns
    -------
    (n,) int8 of 0 and 1, or None
        None where the walk's table would exceed 12 million numbers, as for 512 chips and 16
        pulses.

    Examples
    --------
    >>> nearest(Limits(6, (2, 3), RunLimits(min_open=2)), np.array([1, 0, 1, 1, 0, 1])).tolist()
    [0, 0, 1, 1, 0, 0]
    """
    n = limits.chips
    steps = limits.steps()
    high = limits.open_range[1]
    most_pulses = limits.most_pulses or 0  # 0: nothing moves along the axis of pulses
    if 3 * (n + 1) * (high + 1) * (most_pulses + 1) > _MOST_NUMBERS:
        return None
    opened_before = np.concatenate([[0], np.cumsum(np.asarray(code) != 0)])

    def changes(i: int, step: Step) -> int:
        middle = i + step.open_chips
        end = i + step.open_chips + step.closed_chips
        if step.next_state == OVER:
            end = n
        already_open = opened_before[middle] - opened_before[i]
        return int(step.open_chips - already_open + opened_before[end] - opened_before[middle])

    # state, position, open chips to come, pulses left
    cost = np.full((3, n + 1, high + 1, most_pulses + 1), _NEVER, dtype=np.int64)
    cost[OVER, :, 0] = 0  # what follows is counted by the step that leads there
    for i in reversed(range(n + 1)):
        for step in steps:
            if step.fits[i] and step.open_chips <= high:
                starts = min(step.pulses, most_pulses)
                after = i + step.open_chips + step.closed_chips
                target = cost[step.state, i, step.open_chips :, starts:]
                counts, pulses = target.shape
                total_changes = cost[step.next_state, after, :counts, :pulses] + changes(i, step)
                np.minimum(target, total_changes, out=target)
    k = max(limits.open_range[0], 1)
    k += int(cost[CLOSED, 0, k:, most_pulses].argmin())
    state = CLOSED
    i = 0
    pulses_left = most_pulses
    nearest_code = np.zeros(n, dtype=np.int8)
    while state != OVER:
        for step in steps:
            starts = min(step.pulses, most_pulses)
            after = i + step.open_chips + step.closed_chips
            possible = step.fits[i] and step.open_chips <= k and starts <= pulses_left
            if step.state != state or not possible:
                continue
            # costs are whole numbers: equality finds the step that the minimum came from
            if (
                cost[step.next_state, after, k - step.open_chips, pulses_left - starts]
                + changes(i, step)
                == cost[state, i, k, pulses_left]
            ):
                nearest_code[i : i + step.open_chips] = 1
                state = step.next_state
                i = after
                k = k - step.open_chips
                pulses_left = pulses_left - starts
                break
    return nearest_code


def _starts(is_open: BoolArray) -> BoolArray:
    """Tell where pulses start."""
    return np.asarray(np.diff(is_open.astype(np.int8), axis=1, prepend=0) == 1, dtype=np.bool_)


def _opening(mask: BoolArray, length: int) -> BoolArray:
    """Keep what is covered by runs of at least ``length``."""
    covered = np.zeros_like(mask)
    if length > mask.shape[1]:
        return covered
    full = np.lib.stride_tricks.sliding_window_view(mask, length, axis=1).all(axis=2)
    for shift in range(length):
        covered[:, shift : shift + full.shape[1]] |= full
    return covered
