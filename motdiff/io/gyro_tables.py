"""Reader of gyroscope recordings as tables: columns and units by the header, rates in rad/s."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from motdiff.gyro import GyroTrace
from motdiff.io.inputs import one_line, read_text

__all__ = ["RateUnit", "TimeUnit", "read_gyro"]

FloatArray = NDArray[np.float64]
TimeUnit = Literal["ns", "us", "ms", "s"]
RateUnit = Literal["rad", "deg"]

_SECONDS: dict[str, float] = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
_RADIANS: dict[str, float] = {"rad": 1.0, "deg": math.pi / 180}
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
_RATE = (
    "w|g|gyro|gyr|gyroscope|gyrorotation|omega|rate|rot|(motion)?rotation_?rate|(.*_)?angular_(velocity|rate)|w_rs_s|"
)


@dataclass(frozen=True)
class _Columns:
    """Columns of the time and of the rates about x, y and z, and their units where the header has them."""

    index: tuple[int, int, int, int] = (0, 1, 2, 3)
    time_unit: TimeUnit | None = None
    rate_unit: RateUnit | None = None


def read_gyro(path: Path | str, *, time_unit: TimeUnit | None = None, rate_unit: RateUnit | None = None) -> GyroTrace:
    """Read a recording: a timestamp and three angular rates per row, comma, semicolon, tab or space separated.

    With a header, columns are found by name in any order (``t_ns``, ``time [s]``, ``timestamp``, ...; ``wx``,
    ``gyro_y (deg/s)``, ``z``, ...); without one they are the first four. Lines starting with ``#`` are skipped, except
    for the last one before the numbers where it is a header. Between semicolons
    or tabs a decimal comma is read as a point.

    Parameters
    ----------
    path : path of the file
    time_unit : {"ns", "us", "ms", "s"}, optional
        Unit of the timestamps. When omitted, the header decides (``t_ns``, ``time[s]``), and without one the
        spacing does, where only one of ns and s gives a sample rate within 10 Hz .. 10 kHz.
    rate_unit : {"rad", "deg"}, optional
        Unit of the rates, per second. When omitted, the header decides (``wx [deg/s]``, ``gx_dps``); rad/s without.

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
    ...     np.savetxt(log, [[0, 0, 90, 0], [5, 0, 90, 0]], header="t_ms gx_dps gy_dps gz_dps", comments="")
    ...     trace = read_gyro(log)
    >>> round(trace.sample_rate_hz), trace.rate_rad_s[0].round(4).tolist()
    (200, [0.0, 1.5708, 0.0])
    """
    for name, unit, known in (("time_unit", time_unit, _SECONDS), ("rate_unit", rate_unit, _RADIANS)):
        if unit is not None and unit not in known:
            raise ValueError(f"{name}: must be one of {', '.join(known)}, got {unit!r}")
    lines = read_text(path).splitlines()
    rows = [(number, line) for number, line in enumerate(lines, 1) if line.strip() and line.strip()[0] != "#"]
    if not rows:
        raise ValueError(f"{path}: no rows; wanted a timestamp and three angular rates (rad/s) in each")
    if _is_number(_fields(rows[0][1])[0]):
        remarks = [line.strip().lstrip("#") for line in lines[: rows[0][0] - 1] if line.strip()]
        columns = (_columns(_names(remarks[-1])) if remarks else None) or _Columns()
    else:
        header = _names(rows.pop(0)[1])
        found = _columns(header)
        if found is None:
            raise ValueError(
                f"{path}: missing column {', '.join(_missing(header))}; the header is {one_line(', '.join(header))}"
            )
        columns = found
    values = _numbers(rows, columns.index, path)
    if len(values) < 2:
        raise ValueError(f"{path}: needs at least 2 rows of numbers, got {len(values)}")
    seconds = _SECONDS[time_unit or columns.time_unit or _guessed_unit(values[:, 0], path)]
    radians = _RADIANS[rate_unit or columns.rate_unit or "rad"]
    try:
        return GyroTrace(values[:, 0] * seconds, values[:, 1:] * radians)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


# -- headers ----------------------------------------------------------------------------------------------------------


def _columns(header: Sequence[str]) -> _Columns | None:
    """Find the time and the first three rates of one kind, named before bare x, y, z; None where some are missing."""
    times = [(index, unit) for index, unit in enumerate(map(_as_time, header)) if unit is not None]
    kinds: dict[str, dict[str, tuple[int, RateUnit | None]]] = {}
    for index, name in enumerate(header):
        if rate := _as_rate(name):
            kind, axis, unit = rate
            kinds.setdefault(kind, {}).setdefault(axis, (index, unit))
    for _, axes in sorted(kinds.items(), key=lambda item: item[0] == ""):
        units = {unit for _, unit in axes.values() if unit}
        if times and len(axes) == 3 and len(units) < 2:
            x, y, z = (axes[axis][0] for axis in "xyz")
            return _Columns((times[0][0], x, y, z), times[0][1] or None, next(iter(units), None))
    return None


def _as_time(name: str) -> TimeUnit | Literal[""] | None:
    """Return the unit of a column of times (``t_ns``, ``time [s]``), empty if unnamed; None for other columns."""
    plain, units = _plain(name), "|".join(f"(?P<{unit}>{spelled})" for unit, spelled in _TIME_UNITS.items())
    found = re.fullmatch(f"(?P<seconds_elapsed>seconds_elapsed)|({_TIME})(_({units}))?", plain)
    if found is None:
        return None
    return "s" if found["seconds_elapsed"] else next((unit for unit in _TIME_UNITS if found[unit]), "")


def _as_rate(name: str) -> tuple[str, str, RateUnit | None] | None:
    """Recognise a column of rates by kind, axis and unit, as ``wx``, ``gyro_y [rad/s]``, ``Gyroscope z (deg/s)``."""
    plain, units = _plain(name), "|".join(f"(?P<{unit}>{spelled})" for unit, spelled in _RATE_UNITS.items())
    found = re.fullmatch(f"(?P<kind>{_RATE})_?(?P<axis>[xyz])(_axis)?(_({units}))?", plain)
    if found is None:
        return None
    return found["kind"], found["axis"], next((unit for unit in _RATE_UNITS if found[unit]), None)


def _plain(name: str) -> str:
    """Spell a column's name in small letters, digits and single underscores."""
    return re.sub(r"[^a-z0-9°µμ]+", "_", name.lower()).strip("_")


def _missing(header: Sequence[str]) -> list[str]:
    axes = {rate[1] for name in header if (rate := _as_rate(name))}
    times = [] if any(_as_time(name) is not None for name in header) else ["timestamp (t_ns or t_s)"]
    rates = [f"w{axis} (rad/s)" for axis in "xyz" if axis not in axes]
    return times + rates or ["wx, wy, wz of one name and unit"]


# -- rows -------------------------------------------------------------------------------------------------------------


def _names(line: str) -> list[str]:
    """Split a header; a unit in brackets belongs to the name before it."""
    return _fields(re.sub(r"\s+(?=[\[(])", "", line) if not re.search("[,;\t]", line) else line)


def _fields(line: str) -> list[str]:
    """Split a row; between commas, semicolons and tabs names may hold spaces, and empty cells are seen."""
    line = line.strip()
    separator = next((mark for mark in ";\t," if mark in line), None)
    if separator is None:
        return line.split()
    return [cell.strip().strip('"') for cell in line.split(separator)]


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _numbers(rows: list[tuple[int, str]], columns: Sequence[int], path: Path | str) -> FloatArray:
    values = np.empty((len(rows), 4))
    for i, (number, line) in enumerate(rows):
        fields = _fields(line)
        if len(fields) <= max(columns):
            raise ValueError(f"{path}: line {number} has {len(fields)} columns, wanted at least {max(columns) + 1}")
        try:
            values[i] = [float(fields[column].replace(",", ".")) for column in columns]
        except ValueError:
            raise ValueError(f"{path}: line {number} holds something that is not a number") from None
        if not np.isfinite(values[i]).all():
            raise ValueError(f"{path}: line {number} holds NaN or infinity, all must be finite")
        if i and not values[i, 0] > values[i - 1, 0]:
            raise ValueError(f"{path}: timestamps must strictly increase, but line {number} does not")
    return values


def _guessed_unit(times: FloatArray, path: Path | str) -> TimeUnit:
    step = float(np.median(np.diff(times)))
    if 1e5 <= step <= 1e8:
        return "ns"
    if 1e-4 <= step <= 0.1:
        return "s"
    raise ValueError(
        f"{path}: a median step of {step:g} fits neither ns nor s; name the unit in the header, as t_ms, "
        "or by time_unit"
    )
