"""Whether a traced path's order in time can be believed: a kernel shows strands, not which of them came first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motdiff.trajectory import Trajectory

__all__ = ["crossings", "is_tangled"]

FloatArray = NDArray[np.float64]

# of 72 traced paths with more than both, 16 had the right order; of 48 others 36 (docs/decisions.md)
_LENGTH_PER_EXTENT, _CROSSINGS = 2.5, 3


def is_tangled(path: Trajectory) -> bool:
    """Tell whether a path is so long within its extent, and crosses itself so often, that its order is a guess."""
    return path.length_px > _LENGTH_PER_EXTENT * path.extent_px and crossings(path) > _CROSSINGS


def crossings(path: Trajectory, *, step_px: float = 0.5) -> int:
    """Count how often a path crosses itself, looked at in pieces of about ``step_px``; strands that touch do not."""
    points = path.arc_resampled(max(2, round(path.length_px / step_px) + 1))
    side = _turn(points[:-1, None], points[1:, None], points[None])  # (pieces, points): of each piece, of each point
    parted = side[:, :-1] * side[:, 1:] < 0
    return int(np.triu(parted & parted.T, 2).sum())


def _turn(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Positive where the points ``a``, ``b``, ``c`` (..., 2) turn one way, negative where the other."""
    (ux, uy), (vx, vy) = np.moveaxis(b - a, -1, 0), np.moveaxis(c - a, -1, 0)
    return np.asarray(ux * vy - uy * vx, dtype=np.float64)
