"""Reader of gyroscope recordings as tables: columns and units by the header, rates in rad/s."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from motdiff.files.inputs import one_line, read_text
from motdiff.gyro import GyroTrace
from motdiff.types import FloatArray

TimeUnit = Literal["ns", "us", "ms", "s"]
RateUnit = Literal["rad", "deg"]

_SECONDS: dict[str, float] = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
_RADIANS: dict[str, float] = {"rad": 1.0, "deg": math.pi / 180}
# spellings that recorders use, in names such as t_ns or "time [s]"
_TIME_UNITS: dict[TimeUnit, str] = {
    "ns": "ns|nsec|nanos|nanoseconds?",
    "us": "us|µs|μs|usec|micros|microseconds?",
    "ms": "ms|msec|millis|milliseconds?",
    "s": "s|secs?|seconds?",
}
_RATE_UNITS: dict[RateUnit, str] = {
    "rad": "(rad|radians?)((_per)?_?(s|sec|seconds?)(_1)?)?",
    "deg": "dps|(deg|degrees?|°)((_per)?_?(s|sec|seconds?)(_1)?)?",
}
_TIME = "t|ts|time|timestamps?|(gyro|motion)timestamp_sincereboot|elapsed(_time)?"
_NAMED_TIMES: dict[str, TimeUnit] = {"seconds_elapsed": "s", "cts": "ms", "timeus": "us"}
_RATE = (
    "w|g|gyro|gyr|gyroscope|gyrorotation|omega|rate|rot|(motion)?rotation_?rate|"
    "(.*_)?angular_(velocity|rate)|w_rs_s|"
)
_GYROSCOPE = re.compile("gyr|angular_?(vel|rate)|rotation_?rate|omega", re.IGNORECASE)
_OTHER_SENSOR = re.compile(
    "accel|(^|_)acc(_|$)|magnet|(^|_)mag(_|$)|gravity|baro|gps|orientation", re.IGNORECASE
)
_SENSOR_COLUMN = re.compile("(.*_)?(sensors?|kind|stream|topic|type)(_(id|name|type))?")
_FEWEST_NUMBERS = 3  # in a row; a line above the table has fewer
_LONGEST_HEAD = 1000  # lines above the table
_LEAST_US = 100.0  # step at 10 kHz
_MOST_LABELS = 32  # of sensors: a column with more different cells holds measurements
_MOST_REPEATS = 0.05  # of the rows: more are two sensors in one table
_FEWEST_ROWS = 8  # with fewer a rate that only rises is no surprise

_Row = tuple[int, list[str]]
"""Number of a line, and its cells."""


@dataclass(frozen=True)
class _Columns:
    """Columns of the time and of the rates about x, y and z."""

    index: tuple[int, int, int, int]
    names: tuple[str, ...]
    time_unit: TimeUnit | None = None
    rate_unit: RateUnit | None = None
    assumed: str = ""


def read_gyro(
    path: Path | str, *, time_unit: TimeUnit | None = None, rate_unit: RateUnit | None = None
) -> GyroTrace:
    """Read a recording: a timestamp and three angular rates per row.

    Commas, semicolons, tabs or spaces separate the columns. With a header, columns are found by
    name in any order (``t_ns``, ``time [s]``, ``timestamp``, ...; ``wx``, ``gyro_y (deg/s)``,
    ``gyro_rad[2]``, ``z``, ...). Lines above it are passed over, and so are lines that start with
    ``#``, unless one of them is the header. Without a header the first column is the time, or in a
    table of four columns the only one that rises as a clock does; the rates follow in the order x,
    y, z. Of a table of several sensors, with a column such as ``sensor``, the gyroscope's rows are
    read. A row that repeats the time of the row before is left out. Between semicolons or tabs a
    decimal comma is read as a point.

    What was read, and what was taken for granted, is in ``columns`` and ``warnings`` of the trace.
    The directions of x, y and z are no part of a table: see
    :func:`motdiff.gyro.image_rates_rad_s`.

    Parameters
    ----------
    time_unit : {"ns", "us", "ms", "s"}, optional
        Unit of the timestamps. When omitted, the header decides (``t_ns``, ``time[s]``), and
        without one the spacing does, where only one of ns, us and s gives a sample rate within 10
        Hz .. 10 kHz.
    rate_unit : {"rad", "deg"}, optional
        Unit of the rates, per second. When omitted, the header decides (``wx [deg/s]``,
        ``gx_dps``); rad/s without.

    Raises
    ------
    ValueError
        If the file is not such a table: one line naming the file, the row and what is wrong.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     log = Path(folder, "gyro.csv")
    ...     header = "t_ms gx_dps gy_dps gz_dps"
    ...     np.savetxt(log, [[0, 0, 90, 0], [5, 0, 90, 0]], header=header, comments="")
    ...     trace = read_gyro(log)
    >>> round(trace.sample_rate_hz), trace.rate_rad_s[0].round(4).tolist()
    (200, [0.0, 1.5708, 0.0])
    """
    for name, unit, units in (
        ("time_unit", time_unit, _SECONDS),
        ("rate_unit", rate_unit, _RADIANS),
    ):
        if unit is not None and unit not in units:
            raise ValueError(f"{name}: must be one of {', '.join(units)}, got {unit!r}")
    lines = [
        (number, line.strip())
        for number, line in enumerate(read_text(path).splitlines(), 1)
        if line.strip()
    ]
    table = [(number, _fields(line)) for number, line in lines if line[0] != "#"]
    if not table:
        raise ValueError(
            f"{path}: no rows; wanted a timestamp and three angular rates (rad/s) in each"
        )
    header = _header(lines)
    names: list[str] = []
    if header is None:
        rows = _rows_without_header(table, path)
        width = len(rows[0][1])
        columns = _ordered(rows, path, time_unit)
    else:
        start, names, columns = header
        width = len(names)
        rows = [row for row in table if row[0] > start]
        if rows and len(rows[0][1]) == width and not any(map(_is_number, rows[0][1])):
            columns = _with_units(names, rows.pop(0), path)
    _check_widths(rows, width, path)
    rows, sensor = _gyroscope_rows(rows, names, columns, path)
    values, repeats = _numbers(rows, columns, path)
    if len(values) < 2:
        raise ValueError(f"{path}: needs at least 2 rows of numbers, got {len(values)}")
    stated_time = time_unit or columns.time_unit
    stated_rate = rate_unit or columns.rate_unit
    seconds = stated_time or _guessed_unit(values[:, 0], path)
    angle = stated_rate or "rad"
    assumptions = {
        columns.assumed: bool(columns.assumed) and not sensor,
        f"times in {seconds}, by their spacing": not stated_time,
        "rates in rad/s": not stated_rate,
    }
    warnings = []
    if assumed := "; ".join(text for text, is_assumed in assumptions.items() if is_assumed):
        warnings.append(f"{path}: not stated in the file, and taken for granted: {assumed}")
    if repeats:
        more = f", and so are {len(repeats) - 1} others" * (len(repeats) > 1)
        warnings.append(
            f"{path}: line {repeats[0]} repeats the time of the row before and is left out{more}"
        )
    time, *rates = (one_line(columns.names[index]) for index in columns.index)
    read = f"time: {time}, in {seconds}; rates: {', '.join(rates)}, in {angle}/s{sensor}"
    t_s = values[:, 0] * _SECONDS[seconds]
    try:
        return GyroTrace(t_s, values[:, 1:] * _RADIANS[angle], read, tuple(warnings))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


# -- headers --------------------------------------------------------------------------------------


def _header(lines: list[tuple[int, str]]) -> tuple[int, list[str], _Columns] | None:
    """Find the line of names above the first row of numbers: its number, names and columns."""
    for number, line in lines[:_LONGEST_HEAD]:
        cells = _fields(line)
        if line[0] != "#" and _is_row(cells):
            return None
        if sum(map(_is_number, cells)) < _FEWEST_NUMBERS:
            names = _names(line.lstrip("#"))
            if columns := _columns(names):
                return number, names, columns
    return None


def _with_units(names: Sequence[str], row: _Row, path: Path | str) -> _Columns:
    """Find the columns of a header whose units stand in the line below it."""
    number, units = row
    columns = _columns(
        [f"{name} [{unit}]".removesuffix(" []") for name, unit in zip(names, units, strict=True)]
    )
    if columns is None:
        raise ValueError(
            f"{path}: line {number} holds no numbers, and no units of time and rates that are"
            " known"
        )
    return columns


def _rows_without_header(table: list[_Row], path: Path | str) -> list[_Row]:
    """Return the rows from the first one of numbers on; refuse what looks like a header above."""
    first = next((i for i, (_, cells) in enumerate(table) if _is_row(cells)), None)
    # the line that a message names: the first without any row of numbers, else the last above them
    suspects = table[:1]
    if first is not None:
        width = len(table[first][1])
        suspects = [row for row in table[:first] if len(row[1]) == width or len(row[1]) > 3][-1:]
    for number, cells in suspects:
        if sum(map(_is_number, cells)) >= _FEWEST_NUMBERS:
            raise ValueError(
                f"{path}: line {number} begins with {one_line(cells[0])!r}, which is not a number,"
                " and no header names the columns, as t_s,wx,wy,wz would"
            )
        names = _names(one_line(", ".join(cells)))
        raise ValueError(
            f"{path}: missing column {', '.join(_missing(names))}; the header is"
            f" {', '.join(names)}"
        )
    assert first is not None
    return table[first:]


def _ordered(rows: list[_Row], path: Path | str, time_unit: TimeUnit | None) -> _Columns:
    """Find the time among columns without names: the first, or the only one like a clock."""
    width = len(rows[0][1])
    if width < 4:
        raise ValueError(
            f"{path}: line {rows[0][0]} has {width} columns, wanted a time and three rates"
        )
    clocks = {
        place: step
        for place in range(width)
        if (step := _clock_step(rows, place, time_unit)) is not None
    }
    # no rate changes by so much from row to row
    counters = [place for place, step in clocks.items() if step >= _LEAST_US]
    likely = counters or list(clocks)
    if len(rows) < _FEWEST_ROWS:
        likely = [*clocks][:1]
    if not likely:
        _check_first_rises(rows, path)
    time = next(iter(likely), 0)
    if len(likely) > 1 and not (counters and time == 0):
        which = " and ".join(str(place + 1) for place in likely)
        raise ValueError(
            f"{path}: columns {which} rise as a time does; a header such as t_s,wx,wy,wz must name"
            " them"
        )
    if time and width > 4:
        raise ValueError(
            f"{path}: column {time + 1} of {width} rises as a time does; a header such as"
            " t_s,wx,wy,wz must name them"
        )
    x, y, z = [place for place in range(width) if place != time][:3]
    names = tuple(f"column {place + 1}" for place in range(width))
    assumed = (
        f"{names[time]} is the time, columns {x + 1}, {y + 1}, {z + 1} the rates about x, y, z"
    )
    return _Columns((time, x, y, z), names, assumed=assumed)


def _check_first_rises(rows: list[_Row], path: Path | str) -> None:
    """Refuse a table where another column than the first rises, in a unit that is not known."""
    rising = [
        place for place in range(len(rows[0][1])) if _clock_step(rows, place, "ms") is not None
    ]
    if rising and rising[0] > 0:
        raise ValueError(
            f"{path}: column {rising[0] + 1} rises as a time does, and the first one does not; a"
            " header such as wx,wy,wz,t_ms must name them, and the unit of the time"
        )


def _clock_step(rows: list[_Row], place: int, time_unit: TimeUnit | None) -> float | None:
    """Median step of a column that rises, but for few repeats, at a gyroscope's rate; or None."""
    try:
        with np.errstate(invalid="ignore"):  # infinite less infinite
            steps = np.diff([_number(cells[place]) for _, cells in rows])
    except (ValueError, IndexError):
        return None
    if not steps.size or not (steps >= 0).all() or (steps == 0).mean() > _MOST_REPEATS:
        return None
    step = float(np.median(steps))
    if not (time_unit or _unit_of_step(step)):
        return None
    return step


def _columns(header: Sequence[str]) -> _Columns | None:
    """Find the time and three rates of one kind, named ones before bare x, y, z; or None."""
    times = [(index, unit) for index, unit in enumerate(map(_as_time, header)) if unit is not None]
    kinds: dict[str, dict[str, tuple[int, RateUnit | None]]] = {}
    for index, name in enumerate(header):
        if rate := _as_rate(name):
            kind, axis, unit = rate
            kinds.setdefault(kind, {}).setdefault(axis, (index, unit))
    for kind, axes in sorted(kinds.items(), key=lambda item: item[0] == ""):
        units = {unit for _, unit in axes.values() if unit}
        if times and len(axes) == 3 and len(units) < 2:
            x, y, z = (axes[axis][0] for axis in "xyz")
            time, time_unit = times[0]
            # bare x, y, z may be an accelerometer's
            assumed = f"{header[x]}, {header[y]}, {header[z]} are a gyroscope's" * (not kind)
            return _Columns(
                (time, x, y, z), tuple(header), time_unit or None, next(iter(units), None), assumed
            )
    return None


def _as_time(name: str) -> TimeUnit | Literal[""] | None:
    """Return the unit of a column of times, as ``t_ns``, empty if unnamed; None for others."""
    plain = _plain(name)
    units = "|".join(f"(?P<{unit}>{spelled})" for unit, spelled in _TIME_UNITS.items())
    if plain in _NAMED_TIMES:
        return _NAMED_TIMES[plain]
    if match := re.fullmatch(f"({_TIME})(_({units}))?", plain):
        return next((unit for unit in _TIME_UNITS if match[unit]), "")
    return None


def _as_rate(name: str) -> tuple[str, str, RateUnit | None] | None:
    """Recognise a column of rates, as ``wx`` or ``gyro_y [rad/s]``: its kind, axis and unit."""
    # numbered components of a vector: gyro_rad[2] becomes gyro_z_rad
    name = re.sub(
        r"^(.+?)(_rad|_deg)?\[([012])\]$", lambda m: f"{m[1]}_{'xyz'[int(m[3])]}{m[2] or ''}", name
    )
    plain = _plain(name)
    units = "|".join(f"(?P<{unit}>{spelled})" for unit, spelled in _RATE_UNITS.items())
    match = re.fullmatch(f"(?P<kind>{_RATE})_?(?P<axis>[xyz])(_axis)?(_({units}))?", plain)
    if match is None:
        return None
    return match["kind"], match["axis"], next((unit for unit in _RATE_UNITS if match[unit]), None)


def _plain(name: str) -> str:
    """Spell a column's name in small letters, digits and single underscores."""
    return re.sub(r"[^a-z0-9°µμ]+", "_", name.lower()).strip("_")


def _missing(header: Sequence[str]) -> list[str]:
    axes = {rate[1] for name in header if (rate := _as_rate(name))}
    missing = [f"w{axis} (rad/s)" for axis in "xyz" if axis not in axes]
    if all(_as_time(name) is None for name in header):
        missing.insert(0, "timestamp (t_ns or t_s)")
    return missing or ["wx, wy, wz of one name and unit"]


# -- rows -----------------------------------------------------------------------------------------


def _names(line: str) -> list[str]:
    """Split a header; a unit in brackets belongs to the name before it."""
    if not re.search("[,;\t]", line):
        line = re.sub(r"\s+(?=[\[(])", "", line)
    return _fields(line)


def _fields(line: str) -> list[str]:
    """Split a row at semicolons, tabs or commas, else at spaces."""
    line = line.strip()
    # semicolons first: beside them a comma is a decimal point
    separator = next((mark for mark in ";\t," if mark in line), None)
    if separator is None:
        return line.split()
    cells = re.sub('"[^"]*"', lambda quoted: quoted[0].replace(separator, "\0"), line).split(
        separator
    )
    return [cell.replace("\0", separator).strip().strip('"') for cell in cells]


def _number(text: str) -> float:
    return float(text.replace(",", "."))


def _is_number(text: str) -> bool:
    try:
        _number(text)
    except ValueError:
        return False
    return True


def _is_row(cells: list[str]) -> bool:
    return _is_number(cells[0]) and sum(map(_is_number, cells)) >= _FEWEST_NUMBERS


def _check_widths(rows: list[_Row], width: int, path: Path | str) -> None:
    """Refuse rows with more or fewer cells than there are columns, but for empty last ones."""
    for number, cells in rows:
        if len(cells) < width or any(cells[width:]):
            raise ValueError(
                f"{path}: line {number} has {len(cells)} columns, wanted {width} as in the lines"
                " above"
            )


def _gyroscope_rows(
    rows: list[_Row], names: Sequence[str], columns: _Columns, path: Path | str
) -> tuple[list[_Row], str]:
    """Return the gyroscope's rows of a table of several sensors, with their label; else all."""
    for place in sorted(set(range(len(names))) - set(columns.index)):
        labels = {cells[place] for _, cells in rows}
        texts = {label for label in labels if not _is_number(label)}
        if len(labels) > _MOST_LABELS:
            continue
        gyroscopes = {label for label in texts if _GYROSCOPE.search(label)}
        if len(gyroscopes) > 1:
            gyroscopes = {label for label in gyroscopes if "uncal" not in label.lower()}
        if len(gyroscopes) == 1:
            (label,) = gyroscopes
            sensor = one_line(f"; {names[place]}: {label}")
            return [row for row in rows if row[1][place] == label], sensor
        is_sensor_column = _SENSOR_COLUMN.fullmatch(_plain(names[place])) and len(labels) > 1
        if gyroscopes or is_sensor_column or any(_OTHER_SENSOR.search(label) for label in texts):
            listed = one_line(", ".join(sorted(labels)))
            raise ValueError(
                f"{path}: column {one_line(names[place])} holds {listed}: leave the rows of one"
                " gyroscope alone"
            )
    return rows, ""


def _numbers(
    rows: list[_Row], columns: _Columns, path: Path | str
) -> tuple[FloatArray, list[int]]:
    """Return times and rates (N, 4), and the numbers of the lines that repeat a time."""
    values: list[list[float]] = []
    repeats: list[int] = []
    for number, cells in rows:
        for place in columns.index:
            if not _is_number(cells[place]):
                raise ValueError(
                    f"{path}: line {number} holds something that is not a number in column"
                    f" {one_line(columns.names[place]).removeprefix('column ')}:"
                    f" {one_line(cells[place])!r}"
                )
        row = [_number(cells[place]) for place in columns.index]
        if not np.isfinite(row).all():
            raise ValueError(f"{path}: line {number} holds NaN or infinity, all must be finite")
        if values and row[0] == values[-1][0]:
            repeats.append(number)
        elif values and row[0] < values[-1][0]:
            raise ValueError(
                f"{path}: timestamps must strictly increase, but line {number} does not"
            )
        else:
            values.append(row)
    if len(repeats) > _MOST_REPEATS * len(rows):
        raise ValueError(
            f"{path}: timestamps must strictly increase, but line {repeats[0]} does not;"
            f" {len(repeats)} of {len(rows)} rows repeat the time of the row before: are there two"
            " sensors?"
        )
    return np.array(values).reshape(-1, 4), repeats


def _unit_of_step(step: float) -> TimeUnit | None:
    """Return which of ns, us and s gives times of this median step 10 Hz to 10 kHz, or None."""
    if _LEAST_US <= step <= 1e8:
        return "ns" if step >= 1e5 else "us"
    return "s" if 1e-4 <= step <= 0.1 else None


def _guessed_unit(times: FloatArray, path: Path | str) -> TimeUnit:
    step = float(np.median(np.diff(times)))
    if unit := _unit_of_step(step):
        return unit
    raise ValueError(
        f"{path}: a median step of {step:g} fits neither ns, us nor s; name the unit in the"
        " header, as t_ms, or by time_unit"
    )
