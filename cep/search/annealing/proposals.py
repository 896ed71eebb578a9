"""Proposals of the annealer: flips and swaps, or under run limits whole blocks of chips."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.compiled import compiled, inlined
from cep.search.problem import SearchProblem

Codes = NDArray[np.int8]
Ints = NDArray[np.int64]
Random = NDArray[np.uint64]
_TRIES = 16  # proposals drawn under run limits, to have one that keeps them
_MOST_CHANGES = 24  # chips that one move may change: the cost of judging it grows with them


class LoopLimits(NamedTuple):
    """Limits of a code for the compiled loops, which know no None.

    Attributes
    ----------
    chips : int
        Of one frame.
    low, high : int
        Fewest and most open chips, over all frames.
    min_open, min_closed, max_pulses, max_open, min_period : int
        Of every frame; ``chips`` where there is no maximum.
    constrained : bool
        Whether any of these five is a limit.
    with_complement : bool
        Whether they are limits of the complement too.
    """

    chips: int
    low: int
    high: int
    min_open: int
    min_closed: int
    max_pulses: int
    max_open: int
    min_period: int
    constrained: bool
    with_complement: bool

    @classmethod
    def of(cls, problem: SearchProblem) -> LoopLimits:
        """Limits of a problem on light, runs and pulses."""
        runs = problem.limits.runs
        chips = problem.chips
        return cls(
            chips,
            *problem.open_limits,
            runs.min_open,
            runs.min_closed,
            runs.max_pulses or chips,
            runs.max_open or chips,
            runs.min_period,
            problem.limits_runs,
            problem.limits.with_complement,
        )


@inlined
def uniform(random: Random) -> float:
    """Draw from [0, 1) by xorshift64*.

    References
    ----------
    Vigna, "An experimental exploration of Marsaglia's xorshift generators", 2016.
    """
    x = random[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    random[0] = x
    # the upper 53 bits, as many as a float64 holds
    return float((x * np.uint64(0x2545F4914F6CDD1D)) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@inlined
def draw_any(
    code: Codes, free: Ints, limits: Any, open_chips: int, random: Random, changed: Ints
) -> int:
    """Draw a flip or a swap into ``changed``; how many chips, 0 where none keeps the light."""
    # a swap keeps the light, so that flips are needed where it may change
    if limits.low < limits.high and uniform(random) < 0.5:
        pick = free[int(uniform(random) * free.size)]
        if limits.low <= open_chips + 1 - 2 * code[pick] <= limits.high:
            changed[0] = pick
            return 1
    first = free[int(uniform(random) * free.size)]
    for _ in range(_TRIES):
        second = free[int(uniform(random) * free.size)]
        if code[second] != code[first]:
            changed[0], changed[1] = first, second
            return 2
    return 0


@compiled
def draw_blocks(
    code: Codes,
    may_change: NDArray[np.bool_],
    limits: Any,
    open_chips: int,
    random: Random,
    trial: Codes,
    changed: Ints,
) -> int:
    """Draw a move that keeps run limits: swap two chips, flip a block, or move a block."""
    chips = limits.chips
    longest = min(chips, max(limits.min_open + 1, limits.min_closed + 1, limits.min_period))
    for _ in range(_TRIES):
        frame = chips * int(uniform(random) * (code.size // chips))
        trial[:] = code
        kind = uniform(random)
        first = frame + int(uniform(random) * chips)
        second = frame + int(uniform(random) * chips)
        length = 1 + int(uniform(random) * longest)
        if kind < 0.2:
            trial[first], trial[second] = code[second], code[first]
        elif kind < 0.5 and limits.low < limits.high:
            for j in range(first, min(first + length, frame + chips)):
                trial[j] = 1 - code[first]
        else:
            # rolling an interval moves a block from one of its ends to the other
            begin = min(first, second)
            size = abs(first - second) + 1
            shift = (length if first < second else size - length % size) % size
            for j in range(size):
                trial[begin + (j + shift) % size] = code[begin + j]
        count = 0
        light = open_chips
        for j in range(code.size):
            if trial[j] != code[j]:
                if not may_change[j] or count == _MOST_CHANGES:
                    count = 0
                    break
                changed[count] = j
                count += 1
                light += trial[j] - code[j]
        if count > 0 and limits.low <= light <= limits.high and keeps_runs(trial, limits):
            return count
    return 0


@compiled
def keeps_runs(code: Codes, limits: Any) -> bool:
    """Whether every frame, and its complement where it must, keeps the limits on runs."""
    if limits.with_complement and not _pulses_keep(code, np.int8(0), limits):
        return False
    return _pulses_keep(code, np.int8(1), limits)


@inlined
def _pulses_keep(code: Codes, pulse_value: np.int8, limits: Any) -> bool:
    """Whether the runs of one value, as pulses of a shutter, keep the limits in every frame."""
    # the shutter rests closed: the closed chips before and after the pulses are no run
    chips = limits.chips
    for start in range(0, code.size, chips):
        run = 0
        pulses = 0
        value = 1 - pulse_value
        pulse_start = 0
        for j in range(start, start + chips):
            if code[j] == value:
                run += 1
                continue
            if value == pulse_value:
                if run < limits.min_open or run > limits.max_open:
                    return False
            else:
                if pulses > 0 and (run < limits.min_closed or j - pulse_start < limits.min_period):
                    return False
                pulses += 1
                pulse_start = j
            value = code[j]
            run = 1
        if value == pulse_value and (run < limits.min_open or run > limits.max_open):
            return False
        if pulses > limits.max_pulses:
            return False
    return True
