"""Signals of a logic analyser's recording: levels and the times of their edges."""

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
