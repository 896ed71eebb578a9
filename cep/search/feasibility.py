"""Whether codes keep given limits, which limits conflict, and the code within them nearest to one.

The nearest is a shortest walk between the states of :mod:`cep.search.limits`, from the end to the
start.
"""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cep.search.limits import CLOSED, OVER, Limits, RunLimits, Step
from motdiff.types import BoolArray

_MOST_NUMBERS = 3 * 2**22  # of a table over walks: 96 MB
_NEVER = 1 << 30  # pulses, or changes, of a code that does not exist: sums of two fit in int64


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
