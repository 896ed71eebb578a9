"""Whether any code keeps all limits at once, and which of them conflict if none does."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cep.search.limits import CLOSED, OPEN, OVER, Limits

__all__ = ["check_feasible", "conflicting", "feasible"]

_NEVER = 1 << 30  # pulses of a code that does not exist


@lru_cache(maxsize=64)
def feasible(limits: Limits) -> bool:
    """Whether any code keeps the limits, exactly."""
    low, high = max(limits.open_range[0], 1), min(limits.open_range[1], limits.chips)
    if low > high or limits.min_open > high:
        return False
    if limits.fixed is None:
        fewest = _fewest_free_pulses(limits)
    else:
        # the same for every range: a front asks for each number of open chips
        fewest = _fewest_pulses(replace(limits, open_range=(1, limits.chips), max_pulses=None))
    return bool(fewest[low : high + 1].min() <= (limits.chips if limits.max_pulses is None else limits.max_pulses))


def conflicting(limits: Limits) -> tuple[str, ...]:
    """Name limits that no code keeps together, though it could if any one of them were dropped; none if feasible."""
    dropped = {
        "open_range": replace(limits, open_range=(1, limits.chips)).open_range,
        "min_open": 1,
        "min_closed": 1,
        "max_open": None,
        "min_period": 1,
        "max_pulses": None,
        "fixed": None,
    }
    if feasible(limits):
        return ()
    kept = []
    for name, none in dropped.items():
        if getattr(limits, name) == none:
            continue
        without = replace(limits, **{name: none})  # type: ignore[arg-type]
        if feasible(without):
            kept.append(name)
        else:
            limits = without
    return tuple(kept)


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
    marks = limits.fixed or ""
    values = {
        "open_range": "{}..{}".format(*limits.open_range),
        "fixed": f"({marks.count('1')} forced open, {marks.count('0')} forced closed)",
    }
    words = [f"{name} {values.get(name, getattr(limits, name))}" for name in names]
    code = f"no code of {limits.chips} chips keeps"
    if len(words) == 1:
        raise ValueError(f"{words[0]}: {code} it")
    listed = f"{', '.join(words[:-1])} and {words[-1]}"
    raise ValueError(f"{listed} conflict: {code} {'both' if len(words) == 2 else f'all {len(words)}'}")


def _fewest_free_pulses(limits: Limits) -> NDArray[np.int64]:
    """Fewest pulses of a code with each number of open chips, (n + 1,), where none is forced."""
    opened = np.arange(limits.chips + 1)
    pulses = np.maximum(-(-opened // limits.longest), 1)
    # all but the last take a period at least, and within it may be open but for the gap
    full = min(limits.longest, limits.period - limits.min_closed)
    span = (pulses - 1) * limits.period + np.maximum(opened - (pulses - 1) * full, limits.min_open)
    # more pulses would take longer, and more open chips
    return np.where((pulses * limits.min_open <= opened) & (span <= limits.chips), pulses, _NEVER)


@lru_cache(maxsize=8)
def _fewest_pulses(limits: Limits) -> NDArray[np.int64]:
    """Fewest pulses of a code with each number of open chips, (n + 1,): a shortest walk from the end."""
    n, steps = limits.chips, limits.steps()
    fewest = np.full((3, n + 1, n + 1), _NEVER, dtype=np.int64)  # state, position, open chips to come
    fewest[OVER, limits.rest(), 0] = 0
    for i in reversed(range(n + 1)):
        for state in (CLOSED, OPEN):
            for opened, closed, then, pulses, fits in steps[state]:
                if fits[i]:
                    target = fewest[state, i, opened:]
                    np.minimum(target, fewest[then, i + opened + closed, : n + 1 - opened] + pulses, out=target)
    return np.asarray(np.minimum(fewest[CLOSED, 0], _NEVER), dtype=np.int64)
