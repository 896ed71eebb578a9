"""Motions out of files: a trajectory with its alternatives, and one exposure of a gyroscope
recording.
"""

from __future__ import annotations

from pathlib import Path

from motdiff.files.gyro_tables import read_gyro
from motdiff.files.trajectories import read_motion, stated_uncertainty_px
from motdiff.gyro import DEFAULT_AXES, GyroTrace, trajectory_from_gyro
from motdiff.trajectory import Trajectory, check_length


def stored_paths(file: Path | str) -> tuple[tuple[tuple[float, Trajectory], ...], float | None]:
    """Return the paths of a ``trajectory.json`` with their weights, the likeliest first, and their
    error where stated.

    The error is px rms over time.

    Raises
    ------
    ValueError, OSError
        As of :func:`motdiff.files.trajectories.read_motion`.
    """
    stored = read_motion(file)
    return ((stored.weight, stored.trajectory), *stored.alternatives), stated_uncertainty_px(
        stored, file
    )


def gyro_motion(
    file: Path | str,
    *,
    focal_px: float,
    start_s: float,
    exposure_s: float,
    axes: str = DEFAULT_AXES,
) -> tuple[Trajectory, GyroTrace]:
    """Return the motion of one exposure of a recording, and the recording.

    Parameters
    ----------
    file : path of a table, see :func:`motdiff.files.gyro_tables.read_gyro`
    focal_px : float
        Focal length, px.
    start_s, exposure_s : float
        When on the recording's clock the shutter was open, and for how long, seconds.
    axes : str
        Directions of the recording's axes, as of :func:`motdiff.gyro.image_rates_rad_s`.

    Raises
    ------
    ValueError, OSError
        If the file is no recording or does not cover the exposure, or if the path is too long to
        be handled.
    """
    trace = read_gyro(file)
    path = trajectory_from_gyro(
        trace, focal_px=focal_px, start_s=start_s, exposure_s=exposure_s, axes=axes
    )
    check_length(path)
    return path, trace
