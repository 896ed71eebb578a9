"""Gyroscope recordings, and the trajectory of one exposure integrated from their rates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from motdiff.path_psfs import interpolated
from motdiff.trajectory import Trajectory, check_positive
from motdiff.types import FloatArray

DEFAULT_AXES = "right,down,forward"
"""Directions of a sensor's x, y and z axes where none are given: the axes of the camera itself."""

_DIRECTIONS = {
    "right": (1, 0, 0),
    "left": (-1, 0, 0),
    "down": (0, 1, 0),
    "up": (0, -1, 0),
    "forward": (0, 0, 1),
    "back": (0, 0, -1),
}
# trajectory samples per gyro interval: rates are linear there, hence angles quadratic
_SUBSTEPS = 8


@dataclass(frozen=True)
class GyroTrace:
    """Angular rates of a camera over time.

    Parameters
    ----------
    t_s : (N,) float, seconds
        Strictly increasing, on the recording's own clock.
    rate_rad_s : (N, 3) float, rad/s
        Right-handed rates about the sensor's x, y and z axes.
    columns : str
        Columns and units that a file was read by; empty where there is no file.
    warnings : tuple of str
        Warnings for the user: what a reader took for granted or left out, one sentence each.

    Raises
    ------
    ValueError
        If there are fewer than two rows, a value is not finite, or the times do not increase.
    """

    t_s: FloatArray
    rate_rad_s: FloatArray
    columns: str = ""
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        t = np.array(self.t_s, dtype=np.float64)
        rate = np.array(self.rate_rad_s, dtype=np.float64)
        if t.ndim != 1 or rate.shape != (t.size, 3):
            raise ValueError(
                f"gyro trace: t_s must be (N,) and rate_rad_s (N, 3), got {t.shape} and"
                f" {rate.shape}"
            )
        if t.size < 2:
            raise ValueError(f"gyro trace: needs at least 2 rows, got {t.size}")
        bad = ~(np.isfinite(t) & np.isfinite(rate).all(axis=1))
        if bad.any():
            raise ValueError(
                f"gyro trace: row {int(bad.argmax()) + 1} holds NaN or infinity, all must be"
                " finite"
            )
        if not (np.diff(t) > 0).all():
            row = int(np.argmax(np.diff(t) <= 0)) + 2
            raise ValueError(
                f"gyro trace: timestamps must strictly increase, but row {row} does not follow row"
                f" {row - 1}"
            )
        for name, values in (("t_s", t), ("rate_rad_s", rate)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last, seconds."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def sample_rate_hz(self) -> float:
        """Median sample rate, Hz."""
        return float(1 / np.median(np.diff(self.t_s)))


def image_rates_rad_s(trace: GyroTrace, *, axes: str = DEFAULT_AXES) -> FloatArray:
    """Angular rates (N, 2), rad/s, that move the image to the right and down.

    A camera that turns about the axis that points down pans to the right, so the scene moves left;
    one that turns about the axis that points right tilts up, so the scene moves down.

    Parameters
    ----------
    axes : str
        Directions in which the sensor's x, y and z axes point, as one sees them from behind the
        camera with the photo upright: three of right, left, up, down, forward, back. The default
        "right,down,forward" is that of a camera; a phone held upright (Android, iOS; rear camera)
        is "right,up,back"; held sideways, its top to the left, it is "up,left,back", and its top
        to the right "down,right,back"; a drone that looks ahead is often "forward,right,down".
        A ValueError says where they are not three, or not right-handed.
    """
    about = _camera_rates_rad_s(trace, axes)
    # turned right about its down axis, the camera sees the image move left; up, it moves down
    return np.stack([-about[:, 1], about[:, 0]], axis=1)


def _camera_rates_rad_s(trace: GyroTrace, axes: str) -> FloatArray:
    """Rates (N, 3), rad/s, about the camera's axes: right, down, forward."""
    names = [name.strip() for name in axes.split(",")]
    if len(names) != 3 or not all(name in _DIRECTIONS for name in names):
        raise ValueError(
            f"axes: must be the directions of x, y and z such as {DEFAULT_AXES} or right,up,back,"
            f" of {', '.join(_DIRECTIONS)}; got {axes!r}"
        )
    rotation = np.array([_DIRECTIONS[name] for name in names], dtype=np.float64)
    # the determinant of a rotation; a mirrored triple has -1, a repeated axis 0
    if round(float(np.linalg.det(rotation))) != 1:
        raise ValueError(
            f"axes: must be at right angles and right-handed, as {DEFAULT_AXES} or right,up,back"
            f" are; got {axes!r}"
        )
    return trace.rate_rad_s @ rotation


def trajectory_from_gyro(
    trace: GyroTrace,
    *,
    focal_px: float,
    start_s: float,
    exposure_s: float,
    axes: str = DEFAULT_AXES,
) -> Trajectory:
    """Integrate the rates over the exposure: the trajectory, with known direction and dwell.

    Small angles: image displacement = focal length x angle, the same over the whole photo. Roll
    about the optical axis (see :func:`roll_rad`), translation of the camera and rolling shutter
    are left out. Rates are taken as linear between rows. ValueError if the exposure does not lie
    within the trace, a number is not positive, or the axes are none.

    Parameters
    ----------
    focal_px : float, px
        Focal length divided by the pixel pitch.
    start_s : float, seconds
        Opening of the shutter, on the trace's clock.
    axes : str, as of :func:`image_rates_rad_s`
    """
    check_positive("focal_px", focal_px)
    check_positive("exposure_s", exposure_s)
    times, angles = _integrated(trace, image_rates_rad_s(trace, axes=axes), start_s, exposure_s)
    return Trajectory.from_samples(focal_px * angles, t=times, direction="known")


def roll_rad(
    trace: GyroTrace, *, start_s: float, exposure_s: float, axes: str = DEFAULT_AXES
) -> float:
    """Largest change of roll, rad, in the exposure: :func:`trajectory_from_gyro` leaves it out.

    A pixel r px from the photo's centre moves by up to ``r * roll`` px in addition to the
    trajectory.
    """
    _, angles = _integrated(trace, _camera_rates_rad_s(trace, axes)[:, 2:], start_s, exposure_s)
    return float(np.ptp(angles))


def _integrated(
    trace: GyroTrace, rates: FloatArray, start_s: float, exposure_s: float
) -> tuple[FloatArray, FloatArray]:
    """Integrate to times (T,) s and angles (T, K) rad; exact for rates linear between rows."""
    span_s = float(trace.t_s[0]), float(trace.t_s[-1])
    t = trace.t_s - start_s  # a clock that counts from 1970 has no digits to spare
    # what rounding may cost at the ends
    slack = 8 * float(np.spacing(max(abs(start_s), *map(abs, span_s))))
    if not (t[0] <= slack and exposure_s <= t[-1] + slack):
        raise ValueError(
            f"start_s: the exposure {start_s:.4f}..{start_s + exposure_s:.4f} s must lie within"
            " the trace,"
            f" {math.ceil(1e4 * span_s[0]) / 1e4:.4f}..{math.floor(1e4 * span_s[1]) / 1e4:.4f} s"
        )
    # readings within the rounding of an end would make pieces of no duration
    inner = t[(t > slack) & (t < exposure_s - slack)]
    knots = np.concatenate([[0.0], inner, [exposure_s]])
    fine = np.arange((knots.size - 1) * _SUBSTEPS + 1) / _SUBSTEPS
    times = np.interp(fine, np.arange(knots.size), knots)
    at = interpolated(times, t, rates)
    steps = 0.5 * (at[1:] + at[:-1]) * np.diff(times)[:, None]
    return times, np.concatenate([np.zeros((1, rates.shape[1])), np.cumsum(steps, axis=0)])
