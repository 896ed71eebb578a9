"""Limits on runs and pulses as the scan keeps them: of a code, bit by bit, and of patterns that are parts of codes."""

from __future__ import annotations

from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled
from cep.search.problem import SearchProblem

__all__ = ["Limits", "free_runs", "keeps_runs", "possible"]

_NONE = 64  # more than any code has


class Limits(NamedTuple):
    """Limits on light and on runs, as in a search problem; ``max_pulses`` and ``max_open`` are 64 for none."""

    fewest: int
    most: int
    min_open: int
    min_closed: int
    max_pulses: int
    max_open: int
    min_period: int

    @classmethod
    def of(cls, problem: SearchProblem) -> Limits:
        """Limits of a problem."""
        low, high = problem.open_limits
        return cls(
            low,
            high,
            problem.min_open,
            problem.min_closed,
            problem.max_pulses or _NONE,
            problem.max_open or _NONE,
            problem.min_period,
        )


@compiled
def free_runs(limits: Limits) -> bool:
    """Whether every code keeps the limits on runs and pulses."""
    shortest = limits.min_open == 1 and limits.min_closed == 1 and limits.min_period == 1
    return shortest and limits.max_pulses >= _NONE and limits.max_open >= _NONE


@compiled
def keeps_runs(code: np.uint64, limits: Limits) -> bool:
    """Whether every run limit holds; closed chips before the first and after the last pulse do not count."""
    pulses, run, is_open, since = 0, limits.min_closed, False, 0
    while code:
        bit = (code & np.uint64(1)) != 0
        if bit != is_open:
            if is_open:
                if run < limits.min_open or run > limits.max_open:
                    return False
            elif pulses > 0 and (run < limits.min_closed or since < limits.min_period):
                return False
            if bit:
                pulses, since = pulses + 1, 0
            is_open, run = bit, 0
        run += 1
        since += 1
        code >>= np.uint64(1)
    return pulses <= limits.max_pulses and limits.min_open <= run <= limits.max_open


def possible(patterns: NDArray[np.int8], limits: Limits, ends: tuple[bool, bool]) -> NDArray[np.bool_]:
    """Which patterns may be part of a code that keeps the run limits; ``ends`` tells where the code itself ends."""
    if limits.min_open == limits.min_closed == limits.min_period == 1 and limits.max_open >= patterns.shape[1]:
        return np.ones(len(patterns), dtype=np.bool_)
    return np.array([_runs_fit(row.tolist(), limits, ends) for row in patterns], dtype=np.bool_)


def _runs_fit(row: list[int], limits: Limits, ends: tuple[bool, bool]) -> bool:
    runs = [(bit, len(list(group))) for bit, group in groupby(row)]
    place, began = 0, -limits.min_period
    for index, (bit, length) in enumerate(runs):
        starts_here, ends_here = index > 0 or (bit and ends[0]), index < len(runs) - 1 or (bit and ends[1])
        if starts_here and ends_here and length < (limits.min_open if bit else limits.min_closed):
            return False
        if bit and (length > limits.max_open or (starts_here and place - began < limits.min_period)):
            return False
        if bit and starts_here:
            began = place
        place += length
    return True
