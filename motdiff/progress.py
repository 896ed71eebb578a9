"""Progress as a share of planned work: it never falls, though the plan may change on the way."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock

_MOST = 0.999  # before the work is finished, however wrong its plan was


class Progress:
    """Finished share of a work whose parts cost differently, and whose plan may change.

    The share moves through what is left of it as the work moves through what is left of the plan:
    a longer plan slows it down, a shorter one speeds it up. Several threads may work.

    Parameters
    ----------
    tell : callable, optional
        Called with the finished share 0..1, which never falls, one call at a time.
    """

    def __init__(self, tell: Callable[[float], None] | None = None) -> None:
        self._tell = tell or (lambda _share: None)
        self._lock = Lock()
        self._share = 0.0
        self._left = 0.0

    def expect(self, cost: float) -> None:
        """Plan what is left from now on, in any unit; it replaces the plan so far."""
        with self._lock:
            self._left = cost

    def expect_more(self, cost: float) -> None:
        """Lengthen the plan, or shorten it by a negative cost."""
        with self._lock:
            self._left += cost

    def spend(self, cost: float) -> None:
        """Tell that so much of the plan is done."""
        with self._lock:
            if cost > 0:
                # a plan that is used up: whatever share is left
                share = 1.0
                if self._left > 0:
                    share = min(1.0, cost / self._left)
                self._share = min(_MOST, self._share + (1 - self._share) * share)
                self._left = max(0.0, self._left - cost)
            self._tell(self._share)

    def piece(self, cost: float) -> Callable[[float], None]:
        """Return the callback of a piece of the plan, which takes the piece's own share, 0..1."""
        reported = 0.0

        def tell(share: float) -> None:
            nonlocal reported
            more = cost * share - reported
            reported = cost * share
            self.spend(more)

        return tell

    def finish(self) -> None:
        """Tell that all is done."""
        with self._lock:
            self._share = 1.0
            self._left = 0.0
            self._tell(1.0)


def in_words(time_s: float) -> str:
    """Word a time in the largest unit that it fills.

    Examples
    --------
    >>> in_words(90), in_words(12)
    ('1.5 min', '12 s')
    """
    for unit, size_s in (("h", 3600.0), ("min", 60.0)):
        if time_s >= size_s:
            return f"{time_s / size_s:.1f} {unit}"
    return f"{time_s:.0f} s"
