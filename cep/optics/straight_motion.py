"""Straight motions: whether a path is one, its axis, and its length at constant speed."""

from __future__ import annotations

import numpy as np

from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_STILL_PX = 1e-9  # widest path that stays in place: its |H| is that of a point, but for rounding
_STRAIGHT = 1e-9  # sideways px per px of extent below which a path counts as straight


def stays_in_place(trajectory: Trajectory) -> bool:
    """Whether a path is practically a point, along which a code has no effect."""
    return trajectory.extent_px <= _STILL_PX


def straight_axis(trajectory: Trajectory) -> FloatArray | None:
    """Return the unit vector (2,) of a straight motion, (1, 0) for a point, else None."""
    if stays_in_place(trajectory):
        return np.array([1.0, 0.0])
    extent = trajectory.extent_px
    # from the first sample to the one farthest from it: a path may end where it began
    from_first = trajectory.xy - trajectory.xy[0]
    farthest = from_first[np.argmax(np.linalg.norm(from_first, axis=1))]
    axis: FloatArray = farthest / np.linalg.norm(farthest)
    sideways = trajectory.xy @ np.array([-axis[1], axis[0]])
    if np.ptp(sideways) > _STRAIGHT * extent:
        return None
    return axis


def uniform_length_px(trajectory: Trajectory) -> float | None:
    """Find the length of a straight motion of constant speed, px, or None for any other."""
    axis = straight_axis(trajectory)
    if axis is None or stays_in_place(trajectory):
        return None
    along = trajectory.xy @ axis
    uniform = along[0] + (along[-1] - along[0]) * trajectory.t
    if np.abs(along - uniform).max() > _STRAIGHT * trajectory.extent_px:
        return None
    return trajectory.length_px
