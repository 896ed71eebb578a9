"""Gyroscope recordings: reading them, and integrating one exposure of them into a trajectory."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from motdiff.trajectory import Trajectory

__all__ = [
    "DEFAULT_AXES",
    "GyroTrace",
    "TimeUnit",
    "image_rates_rad_s",
    "read_gyro",
    "roll_rad",
    "trajectory_from_gyro",
]

FloatArray = NDArray[np.float64]
TimeUnit = Literal["ns", "us", "ms", "s"]

DEFAULT_AXES = ("+y", "+x")
_SECONDS: dict[str, float] = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
_TIME_NAMES = {"t", "time", "timestamp", "timestamps", "ts"}
_RATE_PREFIXES = ("w", "g", "gyro", "gyr", "omega", "rate", "rot", "gyroscope", "angular_velocity", "")
_SUBSTEPS = 8  # trajectory samples per gyro interval: rates are linear there, hence angles quadratic


@dataclass(frozen=True)
class GyroTrace:
    """Angular rates of a camera over time.

    Parameters
    ----------
    t_s : (N,) float, seconds
        Strictly increasing, on the recording's own clock.
    rate_rad_s : (N, 3) float, rad/s
        Right-handed rates about the sensor's x, y and z axes.

    Raises
    ------
    ValueError
        If there are fewer than two rows, a value is not finite, or the times do not increase.
    """

    t_s: FloatArray
    rate_rad_s: FloatArray

    def __post_init__(self) -> None:
        t, rate = np.array(self.t_s, dtype=np.float64), np.array(self.rate_rad_s, dtype=np.float64)
        if t.ndim != 1 or rate.shape != (t.size, 3):
            raise ValueError(f"gyro trace: t_s must be (N,) and rate_rad_s (N, 3), got {t.shape} and {rate.shape}")
        if t.size < 2:
            raise ValueError(f"gyro trace: needs at least 2 rows, got {t.size}")
        bad = ~(np.isfinite(t) & np.isfinite(rate).all(axis=1))
        if bad.any():
            raise ValueError(f"gyro trace: row {int(bad.argmax()) + 1} holds NaN or infinity, all must be finite")
        if not (np.diff(t) > 0).all():
            row = int(np.argmax(np.diff(t) <= 0)) + 2
            raise ValueError(
                f"gyro trace: timestamps must strictly increase, but row {row} does not follow row {row - 1}"
            )
        t.setflags(write=False)
        rate.setflags(write=False)
        object.__setattr__(self, "t_s", t)
        object.__setattr__(self, "rate_rad_s", rate)

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last, seconds."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def sample_rate_hz(self) -> float:
        """Median sample rate, Hz."""
        return float(1 / np.median(np.diff(self.t_s)))


def read_gyro(path: Path | str, *, time_unit: TimeUnit | None = None) -> GyroTrace:
    """Read a recording: a timestamp and three angular rates in rad/s per row, comma, semicolon, tab or space separated.

    With a header, columns are found by name (``t_ns``, ``t_s``, ``timestamp``, ...; ``wx``, ``gyro_y``, ``z``, ...);
    without one they are the first four. Lines starting with ``#`` are skipped.

    Parameters
    ----------
    path : path of the file
    time_unit : {"ns", "us", "ms", "s"}, optional
        Unit of the timestamps. When omitted, the header's suffix decides (``t_ns``, ``time[s]``), and without one the
        spacing does, where only one of ns and s gives a sample rate within 10 Hz .. 10 kHz.

    Raises
    ------
    ValueError
        If the file is not such a table: one line naming the file, the row and what is wrong.
    OSError
        If the file cannot be read.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file; wanted a table of timestamps and angular rates") from None
    rows = [(number, _fields(line)) for number, line in enumerate(lines, 1) if line.strip() and line.strip()[0] != "#"]
    if not rows:
        raise ValueError(f"{path}: no rows; wanted a timestamp and three angular rates (rad/s) in each")
    columns, unit = [0, 1, 2, 3], time_unit
    if not _is_number(rows[0][1][0]):
        columns, header_unit = _columns(rows[0][1], path)
        unit = unit or header_unit
        rows = rows[1:]
    values = _numbers(rows, columns, path)
    if len(values) < 2:
        raise ValueError(f"{path}: needs at least 2 rows of numbers, got {len(values)}")
    unit = unit or _guessed_unit(values[:, 0], path)
    if unit not in _SECONDS:
        raise ValueError(f'time_unit: must be "ns", "us", "ms" or "s", got {unit!r}')
    try:
        return GyroTrace(values[:, 0] * _SECONDS[unit], values[:, 1:])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def image_rates_rad_s(trace: GyroTrace, *, axes: Sequence[str] = DEFAULT_AXES) -> FloatArray:
    """Angular rates (N, 2), rad/s, that move the image to the right and down.

    Parameters
    ----------
    trace : GyroTrace
    axes : two of "+x", "-x", "+y", "-y", "+z", "-z"
        Sensor axis that moves the image along +x, and along +y. The default fits a phone held upright whose sensor has
        x right, y up, z towards the user (Android, iOS) and whose rear camera looks along -z: turning about +y pans
        the camera left, so the scene moves right; turning about +x tilts it up, so the scene moves down.

    Raises
    ------
    ValueError
        If ``axes`` does not name two different sensor axes with a sign.
    """
    names = tuple(axes)
    if len(names) != 2 or any(re.fullmatch("[+-][xyz]", name) is None for name in names) or names[0][1] == names[1][1]:
        raise ValueError(f'axes: must name two different signed sensor axes such as ("+y", "+x"), got {names}')
    columns = [float(f"{name[0]}1") * trace.rate_rad_s[:, "xyz".index(name[1])] for name in names]
    return np.stack(columns, axis=1)


def trajectory_from_gyro(
    trace: GyroTrace, *, focal_px: float, start_s: float, exposure_s: float, axes: Sequence[str] = DEFAULT_AXES
) -> Trajectory:
    """Integrate the rates over the exposure: the trajectory, with known direction and dwell.

    Small angles: image displacement = focal length x angle, the same over the whole photo. Roll about the optical axis
    (see :func:`roll_rad`), translation of the camera and rolling shutter are left out. Rates are taken as linear
    between rows.

    Parameters
    ----------
    trace : GyroTrace
    focal_px : float, px
        Focal length divided by the pixel pitch.
    start_s : float, seconds
        Opening of the shutter, on the trace's clock.
    exposure_s : float, seconds
    axes : two signed sensor axes, as :func:`image_rates_rad_s`

    Raises
    ------
    ValueError
        If the exposure does not lie within the trace, or a number is not positive.
    """
    for name, value in (("focal_px", focal_px), ("exposure_s", exposure_s)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name}: must be a positive number, got {value}")
    times, angles = _integrated(trace, image_rates_rad_s(trace, axes=axes), start_s, exposure_s)
    return Trajectory.from_samples(focal_px * angles, t=times, direction="known")


def roll_rad(trace: GyroTrace, *, start_s: float, exposure_s: float, axes: Sequence[str] = DEFAULT_AXES) -> float:
    """Largest change of the roll angle, rad, during the exposure: what :func:`trajectory_from_gyro` leaves out.

    A pixel r px from the photo's centre moves by up to ``r * roll`` px in addition to the trajectory.

    Parameters
    ----------
    trace : GyroTrace
    start_s, exposure_s : float, seconds
    axes : two signed sensor axes, as :func:`image_rates_rad_s`; the third is the roll axis
    """
    image_rates_rad_s(trace, axes=axes)  # checks the axes
    roll = next(i for i, axis in enumerate("xyz") if axis not in (axes[0][1], axes[1][1]))
    _, angles = _integrated(trace, trace.rate_rad_s[:, roll : roll + 1], start_s, exposure_s)
    return float(np.ptp(angles))


def _integrated(
    trace: GyroTrace, rates: FloatArray, start_s: float, exposure_s: float
) -> tuple[FloatArray, FloatArray]:
    """Integrate to times (T,) s and angles (T, K) rad over the exposure, exact for rates linear between rows."""
    end_s = start_s + exposure_s
    slack = 1e-9 * max(1.0, abs(start_s))  # a window given as duration may miss the last row by rounding
    if not (start_s >= trace.t_s[0] - slack and end_s <= trace.t_s[-1] + slack):
        raise ValueError(
            f"start_s: the exposure {start_s:.6g}..{end_s:.6g} s must lie within the trace, "
            f"{trace.t_s[0]:.6g}..{trace.t_s[-1]:.6g} s"
        )
    inner = trace.t_s[(trace.t_s > start_s + slack) & (trace.t_s < end_s - slack)]
    knots = np.concatenate([[start_s], inner, [end_s]])
    fine = np.arange((knots.size - 1) * _SUBSTEPS + 1) / _SUBSTEPS
    times = np.interp(fine, np.arange(knots.size), knots)
    at = np.stack([np.interp(times, trace.t_s, column) for column in rates.T], axis=1)
    steps = 0.5 * (at[1:] + at[:-1]) * np.diff(times)[:, None]
    return times - start_s, np.concatenate([np.zeros((1, rates.shape[1])), np.cumsum(steps, axis=0)])


def _fields(line: str) -> list[str]:
    line = line.strip()
    if "," in line or ";" in line:  # names may hold spaces, empty cells are seen
        return [cell.strip().strip('"') for cell in re.split("[,;]", line)]
    return line.split()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _columns(header: list[str], path: Path | str) -> tuple[list[int], TimeUnit | None]:
    """Column numbers of time, x, y, z and the unit of time that the header names."""
    unit: TimeUnit | None = None
    time_column: int | None = None
    rates: dict[str, int] = {}
    for index, raw in enumerate(header):
        name = re.sub(r"[\s\[\]().\-/]+", "_", raw.strip().lower()).strip("_")
        stem, _, suffix = name.rpartition("_")
        if name in _TIME_NAMES or (stem in _TIME_NAMES and suffix in _SECONDS):
            time_column = index if time_column is None else time_column
            unit = unit or (suffix if stem in _TIME_NAMES else None)  # type: ignore[assignment]
            continue
        name = re.sub("_rad(_per)?_?s$|_rads$", "", name)
        if name and name[-1] in "xyz" and name[:-1].rstrip("_") in _RATE_PREFIXES:
            rates.setdefault(name[-1], index)
    missing = [] if time_column is not None else ["timestamp (t_ns or t_s)"]
    missing += [f"w{axis} (rad/s)" for axis in "xyz" if axis not in rates]
    if time_column is None or missing:
        raise ValueError(f"{path}: missing column {', '.join(missing)}; the header is {', '.join(header)}")
    return [time_column, rates["x"], rates["y"], rates["z"]], unit


def _numbers(rows: list[tuple[int, list[str]]], columns: list[int], path: Path | str) -> FloatArray:
    values = np.empty((len(rows), 4))
    for i, (number, fields) in enumerate(rows):
        if len(fields) <= max(columns):
            raise ValueError(f"{path}: line {number} has {len(fields)} columns, wanted at least {max(columns) + 1}")
        try:
            values[i] = [float(fields[column]) for column in columns]
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
    raise ValueError(f"{path}: a median step of {step:g} fits neither ns nor s; name the unit with time_unit")
