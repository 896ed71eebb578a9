"""Whether a traced path's order in time can be believed: a kernel shows strands, not which of them came first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motdiff.trajectory import Trajectory

__all__ = ["crossings", "is_tangled"]

FloatArray = NDArray[np.float64]

# of 141 traced paths beyond both 30 had the right order, of 99 others 72 (docs/decisions/tracing.md)
_LENGTH_PER_EXTENT, _CROSSINGS = 2.5, 1
_LEAST_SINE = 0.2  # between strands that cross
_STEP_PX = 0.25


def is_tangled(path: Trajectory) -> bool:
    """Tell whether a path is so long within its extent, and crosses itself so often, that its order is a guess."""
    return path.length_px > _LENGTH_PER_EXTENT * path.extent_px and crossings(path) > _CROSSINGS


def crossings(path: Trajectory) -> int:
    """Count how often a path crosses itself, looked at in pieces of a quarter of a pixel.

    Strands that touch do not cross, nor do strands that are retraced: within about a pixel of a crossing they part by
    a sine of 0.2 or more.
    """
    points = path.arc_resampled(max(2, round(path.length_px / _STEP_PX) + 1))
    side = _cross(np.diff(points, axis=0)[:, None], points - points[:-1, None])  # of pieces, of points
    parted = side[:, :-1] * side[:, 1:] < 0
    reach = round(1 / _STEP_PX)
    pieces = np.arange(len(points) - 1)
    ways = points[np.minimum(pieces + 1 + reach, len(points) - 1)] - points[np.maximum(pieces - reach, 0)]
    across = np.abs(_cross(ways[:, None], ways[None])) > _LEAST_SINE * ((2 * reach + 1) * _STEP_PX) ** 2
    return int(np.triu(parted & parted.T & across, 2).sum())


def _cross(u: FloatArray, v: FloatArray) -> FloatArray:
    (ux, uy), (vx, vy) = np.moveaxis(u, -1, 0), np.moveaxis(v, -1, 0)
    return np.asarray(ux * vy - uy * vx, dtype=np.float64)
