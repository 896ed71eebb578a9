"""The one-bit signals of a recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Trace:
    """One signal of a recording.

    Parameters
    ----------
    name : str
        Name with its scopes, as ``libsigrok.D0``.
    level : int
        Level before the first edge, 0 or 1.
    edges : tuple of (float, int)
        Changes as (time_ns, new level), in order of time; levels alternate.
    start_ns, end_ns : float
        First and last moment of the recording.
    """

    name: str
    level: int
    edges: tuple[tuple[float, int], ...]
    start_ns: float
    end_ns: float


@dataclass(frozen=True, slots=True)
class Recording:
    """All one-bit signals of a file.

    Parameters
    ----------
    source : str
        File, for messages.
    traces : tuple of Trace
        In the order of the file.
    """

    source: str
    traces: tuple[Trace, ...]

    def trace(self, name: str | None = None) -> Trace:
        """Find a signal.

        Parameters
        ----------
        name : str or None
            Name with or without its scopes; None for the signal with most edges, the first of
            equals.

        Raises
        ------
        ValueError
            If there is no such signal, or several, or if None is asked for and no signal has an
            edge.
        """
        names = ", ".join(trace.name for trace in self.traces[:20])
        if name is None:
            busiest = max(self.traces, key=lambda trace: len(trace.edges))
            if not busiest.edges:
                raise ValueError(
                    f"{self.source} has no edges on any signal ({names}): nothing was played"
                    " into it"
                )
            return busiest
        # the name alone, or with the scopes that it lies in
        matches = [
            trace for trace in self.traces if name in {trace.name, trace.name.rpartition(".")[2]}
        ]
        if len(matches) != 1:
            count = "several signals" if matches else "no signal"
            raise ValueError(f"{self.source} has {count} {name[:40]!r}: its signals are {names}")
        return matches[0]


class Signal:
    """A signal while it is read, closed (0) before its first value."""

    def __init__(self) -> None:
        self._first = self._level = 0
        self._edges: list[tuple[float, int]] = []

    def set(self, value: str, time_ns: float, *, initial: bool) -> None:
        """Take the value at a moment; what is neither 0 nor 1 leaves the level as it is."""
        if value not in ("0", "1"):
            return
        level = int(value)
        if initial:  # no edge was seen, only a level
            self._first = level
        elif level != self._level:
            if self._edges and self._edges[-1][0] == time_ns:
                self._edges.pop()  # there and back at one moment is no edge
            else:
                self._edges.append((time_ns, level))
        self._level = level

    def trace(self, name: str, *, start_ns: float, end_ns: float) -> Trace:
        """Return the signal as read, of a recording from `start_ns` to `end_ns`."""
        return Trace(name, self._first, tuple(self._edges), start_ns, end_ns)
