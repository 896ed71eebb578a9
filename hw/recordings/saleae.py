"""Reader of the CSV of Saleae Logic's digital exports, versions 1 and 2."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from decimal import Decimal

from hw.recordings.traces import Recording, Signal

_TIME_COLUMN = re.compile(r"time ?(\[s\])?", re.IGNORECASE)
_SECONDS = re.compile(r"[+-]?[0-9]{1,12}(\.[0-9]{1,18})?([eE]-[0-9]{1,2})?")
_ISO = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d)?", re.ASCII)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LATE_NS = 2**43  # some 2.4 hours: from there on a float of nanoseconds loses its thousandths


def is_saleae(text: str) -> bool:
    """Whether the text begins like an export of Saleae Logic."""
    return (
        _TIME_COLUMN.fullmatch(re.split(r"[,\t\n]", text, maxsplit=1)[0].strip('" \r')) is not None
    )


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
