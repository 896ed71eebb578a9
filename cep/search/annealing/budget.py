"""Moves and seconds of a search: what is used, how long its next chains may be, how long its closing polish."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, TypeVar

__all__ = ["CHAINS", "Budget", "Stopped"]

Stopped = Literal["steps", "time", "interrupted", "complete"]
"""What ended a search: all its moves made, the time limit, Ctrl-C, or that no other code keeps the limits."""

_Piece = TypeVar("_Piece")
CHAINS = 8  # of a round: enough for most machines' cores, and the outcome must not depend on their number
_SHORTEST, _LONGEST = 2**15, 2**22  # moves of a chain in the first and the last rounds
_POLISH_SHARE, _POLISH_S = 0.1, 0.5  # of the time limit, or seconds if that is more: what the polish may take on top


@dataclass
class Budget:
    """Moves and seconds: how much of them is used, and whether any is left."""

    steps: int | None
    time_s: float
    began: float
    done: int = 0

    def __post_init__(self) -> None:
        if self.steps is not None and self.steps < 1:
            raise ValueError(f"steps: must be at least 1, got {self.steps}")
        if not self.time_s > 0:
            raise ValueError(f"time_s: must be above 0 seconds, got {self.time_s}")

    def used(self) -> float:
        """Fraction used, 0..1."""
        return min(1.0, max(self.elapsed() / self.time_s, 0.0 if self.steps is None else self.done / self.steps))

    def elapsed(self) -> float:
        """Seconds since it began."""
        return time.monotonic() - self.began

    def left(self) -> bool:
        """Whether neither the moves nor the time is used up."""
        return self.elapsed() < self.time_s and (self.steps is None or self.done < self.steps)

    def chain(self, round_number: int) -> int:
        """Say how many moves each chain of a round makes."""
        wanted: int = min(_SHORTEST << round_number, _LONGEST)
        if self.steps is not None:
            return min(wanted, -(-(self.steps - self.done) // CHAINS))
        if not self.done:
            return wanted
        # a chain that the clock cuts off has cooled for nothing
        affordable = self.done / max(self.elapsed(), 1e-3) * (self.time_s - self.elapsed()) / CHAINS
        return max(256, int(min(wanted, 0.95 * affordable)))

    def stopped(self) -> Stopped:
        """Say what has used it up: the moves, where they and the time ran out together."""
        return "steps" if self.steps is not None and self.done >= self.steps else "time"

    def polished(
        self, found: _Piece, pieces: Iterable[_Piece], tell: Callable[[_Piece, bool], None], *, stopped: Stopped
    ) -> tuple[_Piece, Stopped]:
        """Take the pieces of a closing polish until it ends or must: sooner where Ctrl-C has stopped the search.

        Parameters
        ----------
        found : piece
            Stands where the polish is stopped before its first piece.
        pieces : iterable
            Each the best so far.
        tell : callable
            Called with each piece and False, and at the end with the last one and True. It may raise KeyboardInterrupt.
        stopped : {"steps", "time", "interrupted", "complete"}
            What ended the search before.

        Returns
        -------
        The last piece, and what ended the search with its polish.
        """
        ends_s = self.time_s + max(_POLISH_S, _POLISH_SHARE * self.time_s)
        if stopped == "interrupted":
            ends_s = self.elapsed() + _POLISH_S
        try:
            for found in pieces:
                tell(found, False)
                if self.elapsed() > ends_s:
                    stopped = "time" if stopped == "steps" else stopped
                    break
            tell(found, True)
        except KeyboardInterrupt:
            stopped = "interrupted"
        return found, stopped
