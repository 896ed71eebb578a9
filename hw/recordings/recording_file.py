"""Reader of logic analysers' recordings: VCD (value change dump), or CSV of Saleae Logic."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from pathlib import Path

from hw.files import content

_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF32_LE: "utf-32-le",  # begins like the mark of UTF-16
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
_BINARY = re.compile(r"[\0-\x08\x0e-\x1a\x1c-\x1f]")
_UNIT_NS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0, "ps": 1e-3, "fs": 1e-6}
_TIMESCALE = re.compile(r"(1|10|100)(s|ms|us|ns|ps|fs)")
_TIME = re.compile(r"#[0-9]{1,30}")
_DUMPS = {"$dumpvars", "$dumpall", "$dumpon", "$dumpoff", "$end"}
_WORD = re.compile(r"\S+")
# Besides 0 and 1 the states of Verilog (x, z) and VHDL, which leave a level as it is.
_VALUES = frozenset("01xXzZuUwWlLhH-")
_ONE_BIT = frozenset(
    {"wire", "reg", "logic", "bit", "tri", "wand", "wor", "integer", "parameter", "event"}
)
_TIME_COLUMN = re.compile(r"time ?(\[s\])?", re.IGNORECASE)
_SECONDS = re.compile(r"[+-]?[0-9]{1,12}(\.[0-9]{1,18})?([eE]-[0-9]{1,2})?")
_ISO = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d)?", re.ASCII)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LATE_NS = 2**43  # some 2.4 hours: from there on a float of nanoseconds loses its thousandths


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


def read_recording(path: str | Path) -> Recording:
    """Read a VCD file, or a digital CSV export of Saleae Logic, in any usual encoding.

    All that matters in them is ASCII but the signals' names: those in an 8-bit alphabet are read
    as Windows-1252.

    ValueError if the file cannot be read or is neither.
    """
    try:
        text = _decoded(content(path))
    except UnicodeDecodeError:
        raise ValueError(
            f"{path} is no text: save or export the capture as VCD (value change dump), or from"
            " Saleae Logic as CSV"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(
            f"{path} cannot be read: {reason}; name a VCD file, or a CSV export of Saleae Logic"
        ) from None
    # By content too: an export saved as .txt is read, and a damaged .csv is named as a CSV.
    if Path(path).suffix.lower() == ".csv" or _is_saleae(text):
        return parse_saleae(text, source=str(path))
    return parse_vcd(text, source=str(path))


def _decoded(data: bytes) -> str:
    """Decode UTF-8, -16 or -32, with a mark or without, else Windows-1252.

    UnicodeDecodeError if it is neither UTF-8 nor text at all.
    """
    mark = next((mark for mark in _MARKS if data.startswith(mark)), b"")
    if mark:
        # a cut end is the parser's to tell
        text = data.removeprefix(mark).decode(_MARKS[mark], errors="replace")
    # ASCII in UTF-16 has a zero in every second byte.
    elif len(data) > 1 and 0 in data[:2]:
        text = data.decode("utf-16-le" if data[0] else "utf-16-be", errors="replace")
    else:
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            text = data.decode("cp1252", errors="replace")
            if _BINARY.search(text):
                raise
    return text.replace("\r\n", "\n").replace("\r", "\n")


def parse_vcd(text: str, *, source: str = "VCD") -> Recording:
    """Read the one-bit signals of VCD text; vectors, numbers and texts in it are passed over.

    Parameters
    ----------
    text : str
        VCD as sigrok, PulseView, Saleae, simulators or `hw.export.vcd` write it: any timescale,
        any names.
    source : str
        File, for messages.

    Raises
    ------
    ValueError
        If the text is no VCD, was cut short in its header, has no one-bit signal, or contradicts
        itself.
    """
    words = (match.group() for match in _WORD.finditer(text))
    unit_ns, names, codes = _header(words, source)
    if not names:
        raise ValueError(
            f"{source} has no one-bit signal: record the shutter line as a digital channel"
        )
    signals = {code: Signal() for _, code in names}
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
        elif word == "$comment":  # may hold anything, changes too
            while next(words, "$end") != "$end":
                pass
        elif word not in _DUMPS:
            value = word[0]
            code = word[1:]
            if word[0] in "bBrRsS":  # a vector, number or text: its code is the next word
                value = word[-1]
                code = next(words, "")
            if (value not in _VALUES and word[0] not in "rRsS") or code not in codes:
                raise ValueError(
                    f"{source} has {word[:20]!r} among its changes: it is damaged, record again"
                )
            if code in signals:  # else a vector or a number
                signals[code].set(value, now_ns, initial=start_ns is None or now_ns == start_ns)
    begin_ns = now_ns if start_ns is None else start_ns
    traces = (signals[code].trace(name, start_ns=begin_ns, end_ns=now_ns) for name, code in names)
    return Recording(source, tuple(traces))


def _header(words: Iterator[str], source: str) -> tuple[float, list[tuple[str, str]], set[str]]:
    """Read up to $enddefinitions: time unit, (name, code) of one-bit signals, all codes."""
    unit_ns = 0.0
    scopes: list[str] = []
    names: list[tuple[str, str]] = []
    codes: set[str] = set()
    for word in words:
        if not word.startswith("$"):
            if codes or unit_ns or scopes:
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
                raise ValueError(
                    f"{source} has timescale {' '.join(body)[:20]!r}: one like '1 ns' is needed"
                )
            unit_ns = int(scale[1]) * _UNIT_NS[scale[2]]
        elif word == "$scope" and body:
            scopes.append(body[-1])
        elif word == "$upscope" and scopes:
            scopes.pop()
        elif word == "$var":
            if len(body) < 4:
                raise ValueError(
                    f"{source} declares {' '.join(body)[:40]!r}: type, size, code and name are"
                    " needed"
                )
            codes.add(body[2])
            if body[1] == "1" and body[0] in _ONE_BIT:
                names.append((".".join([*scopes, "".join(body[3:])]), body[2]))
        elif word == "$enddefinitions":
            if not unit_ns:
                raise ValueError(f"{source} has no timescale: its times mean nothing without one")
            return unit_ns, names, codes
    raise ValueError(f"{source} is no VCD file: a header that ends with $enddefinitions is needed")


def _is_saleae(text: str) -> bool:
    """Whether the text begins like an export of Saleae Logic."""
    first_cell = re.split(r"[,\t\n]", text, maxsplit=1)[0].strip('" \r')
    return _TIME_COLUMN.fullmatch(first_cell) is not None


def parse_saleae(text: str, *, source: str = "CSV") -> Recording:
    """Read the channels of a digital export: a row for the first levels, and one for each change.

    Times are read as decimals, hence exact to the nanosecond. Those in ISO 8601, and those that
    begin beyond some 2.4 hours, count from the first row. ``X``, a gap in the recording, leaves
    the level as it is.

    Parameters
    ----------
    text : str
        The export, with commas or tabs, and times in seconds or in ISO 8601.
    source : str
        File, for messages.

    Raises
    ------
    ValueError
        If the text is no such export, or a row of it cannot be read or goes back in time.
    """
    rows = _rows(text, source)
    names = _channels(next(rows, (0, []))[1], source)
    signals = [Signal() for _ in names]
    origin: Decimal | None = None
    start_ns = now_ns = 0.0
    iso = False
    for number, (time, *values) in rows:
        if origin is None:
            iso = "T" in time
        moment = _iso_ns(time) if iso else _seconds_ns(time)
        # Version 1 writes seconds, version 2 seconds or ISO 8601.
        if moment is None:
            example = "2024-05-12T20:47:43.123456789+00:00" if iso else "0.000200000"
            raise ValueError(
                f"{source}: line {number} has time {time[:40]!r}: one like {example} is needed"
            )
        initial = origin is None  # the first row has the levels at the beginning, no edges
        if origin is None:
            origin = moment if iso or abs(moment) > _LATE_NS else Decimal(0)
            start_ns = now_ns = _number(moment - origin)
        time_ns = _number(moment - origin)
        if time_ns < now_ns:
            raise ValueError(f"{source} goes back in time at line {number}: times must increase")
        now_ns = time_ns
        if len(values) != len(names):
            raise ValueError(
                f"{source}: line {number} has {len(values)} levels: {len(names)} are needed,"
                " export the capture again"
            )
        for name, signal, value in zip(names, signals, values, strict=True):
            if value not in ("0", "1", "X"):
                what = f"{source}: line {number} has {value[:20]!r} for {name[:40]}"
                raise ValueError(f"{what}: 0 or 1 is needed, export the digital channels")
            signal.set(value, now_ns, initial=initial)
    if origin is None:
        raise ValueError(f"{source} has no rows below its header: nothing was recorded")
    traces = (
        signal.trace(name, start_ns=start_ns, end_ns=now_ns)
        for name, signal in zip(names, signals, strict=True)
    )
    return Recording(source, tuple(traces))


def _rows(text: str, source: str) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, cells) of each row that is not blank."""
    header = text.split("\n", 1)[0]
    # Version 1 exports with either.
    delimiter = "\t" if "\t" in header and "," not in header else ","
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, [" ".join(cell.split()) for cell in cells]
    except csv.Error as error:
        raise ValueError(
            f"{source}: line {reader.line_num} cannot be read as CSV ({error})"
        ) from None


def _channels(header: list[str], source: str) -> list[str]:
    if not header:
        raise ValueError(f"{source} is empty: a digital export of Saleae Logic is needed")
    if not _TIME_COLUMN.fullmatch(header[0]):
        raise ValueError(
            f"{source} begins with {header[0][:40]!r}: a digital export of Saleae Logic begins"
            " with 'Time [s]' and the names of its channels"
        )
    if len(header) == 1:
        raise ValueError(
            f"{source} has no channel beside the time: export the shutter's digital channel too"
        )
    return header[1:]


def _seconds_ns(text: str) -> Decimal | None:
    if not _SECONDS.fullmatch(text):
        return None
    return Decimal(text).scaleb(9)


def _iso_ns(text: str) -> Decimal | None:
    """Nanoseconds since 1970; a time without a zone counts as UTC."""
    parts = _ISO.fullmatch(text)
    if parts is None:
        return None
    seconds, fraction, zone = parts.groups()
    try:
        since = datetime.fromisoformat(f"{seconds}{zone or 'Z'}") - _EPOCH
    except ValueError:  # as the thirteenth month
        return None
    return Decimal(since // timedelta(seconds=1) * 10**9 + int((fraction or "0").ljust(9, "0")))


def _number(time_ns: Decimal) -> float:
    whole_ns = int(time_ns)
    return whole_ns if whole_ns == time_ns else float(time_ns)
