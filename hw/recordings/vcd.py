"""Logic-analyser recordings: the edges of a signal in a VCD file, whoever wrote it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Recording", "Trace", "parse_vcd", "read_vcd"]

_UNIT_NS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0, "ps": 1e-3, "fs": 1e-6}
_TIMESCALE = re.compile(r"(1|10|100)(s|ms|us|ns|ps|fs)")
_TIME = re.compile(r"#[0-9]{1,30}")
_DUMPS = {"$dumpvars", "$dumpall", "$dumpon", "$dumpoff", "$end"}
_WORD = re.compile(r"\S+")
_VALUES = frozenset("01xXzZuUwWlLhH-")
_ONE_BIT = frozenset({"wire", "reg", "logic", "bit", "tri", "wand", "wor", "integer", "parameter", "event"})


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
        File name for messages.
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
            Name with or without its scopes; None for the signal with most edges, the first of equals.

        Raises
        ------
        ValueError
            If there is no such signal, or several, or if None is asked for and no signal has an edge.
        """
        names = ", ".join(trace.name for trace in self.traces[:20])
        if name is None:
            busiest = max(self.traces, key=lambda trace: len(trace.edges))
            if not busiest.edges:
                raise ValueError(f"{self.source} has no edges on any signal ({names}): nothing was played into it")
            return busiest
        found = [trace for trace in self.traces if name in {trace.name, trace.name.rpartition(".")[2]}]
        if len(found) != 1:
            what = "several signals" if found else "no signal"
            raise ValueError(f"{self.source} has {what} {name[:40]!r}: its signals are {names}")
        return found[0]


class _Line:
    """A signal while it is being read. Before its first value it counts as 0, since a shutter rests closed."""

    def __init__(self) -> None:
        self.first = self.level = 0
        self.edges: list[tuple[float, int]] = []

    def set(self, value: str, time_ns: float, *, initial: bool) -> None:
        if value not in ("0", "1"):
            return  # x and z say nothing: the last level is taken to last
        level = int(value)
        if initial:
            self.first = level
        elif level != self.level:
            if self.edges and self.edges[-1][0] == time_ns:
                self.edges.pop()  # there and back at one moment is no edge
            else:
                self.edges.append((time_ns, level))
        self.level = level


def read_vcd(path: str | Path) -> Recording:
    """Read a VCD file.

    Raises
    ------
    ValueError
        If the file cannot be read or is no VCD.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")  # Windows programs write a mark first
    except UnicodeDecodeError:
        raise ValueError(f"{path} is no text: save or export the capture as VCD (value change dump)") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise ValueError(f"{path} cannot be read: {reason}; name a VCD file") from None
    return parse_vcd(text, source=str(path))


def parse_vcd(text: str, *, source: str = "VCD") -> Recording:
    """Read the one-bit signals of VCD text; vectors, numbers and texts in it are passed over.

    Parameters
    ----------
    text : str
        VCD as sigrok, PulseView, Saleae, simulators or `hw.export.vcd` write it: any timescale, any names.
    source : str
        File name for messages.

    Raises
    ------
    ValueError
        If the text is no VCD, was cut short in its header, has no one-bit signal, or contradicts itself.
    """
    words = (match.group() for match in _WORD.finditer(text))
    unit_ns, names, known = _header(words, source)
    if not names:
        raise ValueError(f"{source} has no one-bit signal: record the shutter line as a digital channel")
    lines = {code: _Line() for _, code in names}
    start_ns: float | None = None
    now_ns = 0.0
    for word in words:
        if _TIME.fullmatch(word):
            moment_ns = int(word[1:]) * unit_ns
            if start_ns is None:
                start_ns = moment_ns
            elif moment_ns < now_ns:
                raise ValueError(f"{source} goes back in time at {word}: times must increase")
            now_ns = moment_ns
        elif word == "$comment":
            while next(words, "$end") != "$end":
                pass
        elif word not in _DUMPS:
            value, code = (word[-1], next(words, "")) if word[0] in "bBrRsS" else (word[0], word[1:])
            if (value not in _VALUES and word[0] not in "rRsS") or code not in known:
                raise ValueError(f"{source} has {word[:20]!r} among its changes: it is damaged, record again")
            if code in lines:
                lines[code].set(value, now_ns, initial=start_ns is None or now_ns == start_ns)
    begin_ns = now_ns if start_ns is None else start_ns
    traces = (Trace(name, lines[code].first, tuple(lines[code].edges), begin_ns, now_ns) for name, code in names)
    return Recording(source, tuple(traces))


def _header(words: Iterator[str], source: str) -> tuple[float, list[tuple[str, str]], set[str]]:
    """Read up to $enddefinitions: the time unit, (name, code) of the one-bit signals, and the codes of all."""
    unit_ns = 0.0
    scopes: list[str] = []
    names: list[tuple[str, str]] = []
    known: set[str] = set()
    for word in words:
        if not word.startswith("$"):
            if known or unit_ns or scopes:
                break
            continue  # sigrok-cli puts a remark of its own in front of the file
        body: list[str] = []
        for inner in words:
            if inner == "$end":
                break
            body.append(inner)
        else:
            raise ValueError(f"{source} ends within its header: it was cut short, record again")
        if word == "$timescale":
            scale = _TIMESCALE.fullmatch("".join(body))
            if scale is None:
                raise ValueError(f"{source} has timescale {' '.join(body)[:20]!r}: one like '1 ns' is needed")
            unit_ns = int(scale[1]) * _UNIT_NS[scale[2]]
        elif word == "$scope" and body:
            scopes.append(body[-1])
        elif word == "$upscope" and scopes:
            scopes.pop()
        elif word == "$var":
            if len(body) < 4:
                raise ValueError(f"{source} declares {' '.join(body)[:40]!r}: type, size, code and name are needed")
            known.add(body[2])
            if body[1] == "1" and body[0] in _ONE_BIT:
                names.append((".".join([*scopes, "".join(body[3:])]), body[2]))
        elif word == "$enddefinitions":
            if not unit_ns:
                raise ValueError(f"{source} has no timescale: its times mean nothing without one")
            return unit_ns, names, known
    raise ValueError(f"{source} is no VCD file: a header that ends with $enddefinitions is needed")
