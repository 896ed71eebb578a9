"""Limits of a code, and the codes that keep them as walks.

A code is a walk between states. *Closed* may stay closed or start a pulse, *open* may stay open, close for a gap, or
close for good (*over*); a pulse starts with ``min_open`` chips at once and a gap with ``min_closed``, so no state needs
to count a run. Where a pulse may become too long, or end too early for the next one's start, each of its lengths is a
step of its own, from closed to the end of its gap. Every code within the limits is exactly one walk.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["CLOSED", "OPEN", "OVER", "Limits", "Step", "checked_mask", "fixed_mask"]

BoolArray = NDArray[np.bool_]
CLOSED, OPEN, OVER = 0, 1, 2  # states of a walk


class Step(NamedTuple):
    """A step of a walk.

    Attributes
    ----------
    opened, closed : int
        Chips that it opens, and then closes.
    then : int
        State that it leads to: CLOSED, OPEN, or OVER, where all that follows is closed.
    pulses : int
        1 if it starts a pulse, else 0.
    fits : (n + 1,) bool
        Whether the forced chips and the code's length allow it at each chip.
    """

    opened: int
    closed: int
    then: int
    pulses: int
    fits: BoolArray


@dataclass(frozen=True)
class Limits:
    """Limits of a code of ``chips`` chips.

    Parameters
    ----------
    chips : int
    open_range : (int, int)
        Fewest and most open chips.
    min_open, min_closed : int
        Shortest open run, and shortest closed run between two open ones: the shutter rests closed before and after.
    max_pulses : int, optional
        Most open runs.
    fixed : str, optional
        One character per chip: "1" forced open, "0" forced closed, "?" free.
    max_open : int, optional
        Longest open run.
    min_period : int
        Fewest chips from the start of one open run to the start of the next.
    """

    chips: int
    open_range: tuple[int, int]
    min_open: int = 1
    min_closed: int = 1
    max_pulses: int | None = None
    fixed: str | None = None
    max_open: int | None = None
    min_period: int = 1

    @property
    def counts_runs(self) -> bool:
        """Whether a pulse's length decides what may follow: on its longest length, or on the gap after it."""
        return self.longest < self.chips or self.period > self.min_open + self.min_closed

    @property
    def longest(self) -> int:
        """Longest open run that any code within the light can have."""
        light = min(self.open_range[1], self.chips)
        return self.chips if self.max_open is None or self.max_open >= light else self.max_open

    @property
    def period(self) -> int:
        """Fewest chips from the start of one pulse to the start of the next, whichever limit says so."""
        return max(self.min_period, self.min_open + self.min_closed)

    @property
    def fitting_pulses(self) -> int:
        """Most pulses for which there is time."""
        return 1 + (self.chips - self.min_open) // self.period

    @property
    def counts_opens(self) -> bool:
        """Whether ``open_range`` says anything that the other limits do not."""
        return self.open_range[0] > self.min_open or self.open_range[1] < self.chips

    @property
    def most_pulses(self) -> int | None:
        """Most pulses, or None when so many never fit anyway."""
        return None if self.max_pulses is None or self.max_pulses >= self.fitting_pulses else self.max_pulses

    def may_be(self, bit: int) -> BoolArray:
        """Which chips (n,) the mask lets be open (1) or closed (0)."""
        return np.array([mark in ("?", str(bit)) for mark in self.fixed or "?" * self.chips])

    def room(self, bit: int, length: int) -> BoolArray:
        """Whether a run of ``length`` chips of ``bit`` may start at each chip, (n + 1,)."""
        refused = np.concatenate([[0], np.cumsum(~self.may_be(bit))])
        fits = np.zeros(self.chips + 1, dtype=np.bool_)
        last = self.chips - length
        if last >= 0:
            fits[: last + 1] = refused[length:] == refused[: last + 1]
        return fits

    def rest(self) -> BoolArray:
        """Whether every chip from each one on may be closed, (n + 1,)."""
        return np.concatenate([np.logical_and.accumulate(self.may_be(0)[::-1])[::-1], [True]])

    def steps(self) -> tuple[tuple[Step, ...], tuple[Step, ...]]:
        """List the steps from CLOSED and those from OPEN."""
        gap, rest = self.min_closed, self.rest()

        def step(opened: int, closed: int, then: int, pulses: int = 0) -> Step:
            fits, after = self.room(1, opened), rest if then == OVER else self.room(0, closed)
            fits[: after.size - opened] &= after[opened:]
            return Step(opened, closed, then, pulses, fits)

        bounded = self.longest < self.chips
        # longer pulses may last and end as they like: nothing needs to remember when they began
        free = min(max(self.min_open, self.min_period - gap), self.chips + 1)
        closed = [step(0, 1, CLOSED)]
        if not bounded:
            closed.append(step(free, 0, OPEN, 1))
        for length in range(self.min_open, self.longest + 1 if bounded else free):
            closed += [step(length, max(gap, self.min_period - length), CLOSED, 1), step(length, 0, OVER, 1)]
        return tuple(closed), (step(1, 0, OPEN), step(0, gap, CLOSED), step(0, 0, OVER))


def fixed_mask(
    chips: int,
    *,
    first_open: bool = False,
    last_open: bool = False,
    forced_open: Iterable[int] = (),
    forced_closed: Iterable[int] = (),
) -> str:
    """Make a mask of forced chips: "1" open, "0" closed, "?" free.

    Parameters
    ----------
    chips : int
    first_open, last_open : bool
        Whether the first and the last chip must be open.
    forced_open, forced_closed : iterable of int
        Chips by their index, 0 .. chips - 1.

    Raises
    ------
    ValueError
        If an index is outside the code, or a chip is forced both ways.

    Examples
    --------
    >>> fixed_mask(8, first_open=True, forced_closed=[3, 4])
    '1??00???'
    """
    opened, closed = set(forced_open), set(forced_closed)
    for name, indices in (("forced_open", opened), ("forced_closed", closed)):
        outside = sorted(index for index in indices if not 0 <= index < chips)
        if outside:
            raise ValueError(f"{name}: chips of a code of {chips} are 0..{chips - 1}, got {outside[0]}")
    opened |= ({0} if first_open else set()) | ({chips - 1} if last_open else set())
    both = sorted(opened & closed)
    if both:
        raise ValueError(f"forced_closed: chip {both[0]} is forced open as well")
    return "".join("1" if i in opened else "0" if i in closed else "?" for i in range(chips))


def checked_mask(fixed: str | None, chips: int) -> str | None:
    """Return a mask, or None when it leaves every chip free.

    Raises
    ------
    ValueError
        If it has another length or other characters.
    """
    if fixed is None:
        return None
    if not isinstance(fixed, str) or set(fixed) - set("01?"):
        raise ValueError(f"fixed: must be a string of 0 (forced closed), 1 (forced open) and ? (free), got {fixed!r}")
    if len(fixed) != chips:
        raise ValueError(f"fixed: must have one character for each of {chips} chips, got {len(fixed)}")
    return None if set(fixed) == {"?"} else fixed
