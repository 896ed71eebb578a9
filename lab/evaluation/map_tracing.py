"""Ordered paths from HR maps: what order a drawn path alone shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from motdiff.psf_frame import MAP_CENTRE, MAP_PX
from motdiff.tracing.graph import branch_graph
from motdiff.tracing.path import path_of
from motdiff.types import BoolArray, FloatArray

_SOFT_HIGH = 0.5  # hysteresis on a soft map, as parts of its maximum
_SOFT_LOW = 0.25


def trace_map(hr_map: ArrayLike) -> FloatArray:
    """Trace the ordered path that an HR map draws, straight through crossings.

    Parameters
    ----------
    hr_map : (256, 256) array_like, binary or soft (0..1 or any non-negative scale)
        Displacement d px at index ``129.5 + 4 d``. Gaps of up to 1.5 px are bridged, dust is
        dropped.

    Returns
    -------
    (N, 2) float, px
        About four points per pixel of length; the order of the two ends is arbitrary.

    Raises
    ------
    ValueError
        If the map is not finite, non-negative and (256, 256), or empty.

    Notes
    -----
    Where strands share pixels, a binary map does not determine their number or pairing; the
    smoothest curve is taken.
    """
    soft = np.asarray(hr_map)
    if soft.shape != (MAP_PX, MAP_PX):
        raise ValueError(f"hr_map: must be ({MAP_PX}, {MAP_PX}), got shape {soft.shape}")
    return path_of(branch_graph(_path_pixels(soft)), MAP_CENTRE)


def _path_pixels(hr_map: ArrayLike) -> BoolArray:
    """Mask of the path's pixels in a binary or soft map, by hysteresis.

    Raises
    ------
    ValueError
        If the map is not a finite, non-negative (H, W) array with something drawn in it.
    """
    soft = np.asarray(hr_map, dtype=np.float64)
    if soft.ndim != 2 or not np.isfinite(soft).all() or soft.min(initial=0.0) < 0:
        raise ValueError(
            f"hr_map: must be a finite, non-negative (H, W) array, got shape {soft.shape}"
        )
    peak = float(soft.max(initial=0.0))
    if peak <= 0:
        raise ValueError(
            "hr_map: nothing is drawn in it (all zero); needs at least one pixel of path"
        )
    labels, _ = ndimage.label(soft >= _SOFT_LOW * peak, structure=np.ones((3, 3)))
    strong = np.unique(labels[soft >= _SOFT_HIGH * peak])
    return np.asarray(np.isin(labels, strong[strong > 0]), dtype=bool)
