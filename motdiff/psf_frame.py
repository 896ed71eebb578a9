"""The frame of PSFs and HR maps: its size, its zero displacement, and how kernels get there.

Zero displacement of a PSF lies at index ``size // 2`` of each axis, in odd and even frames alike.
An HR map covers the same field more finely: displacement d px lies at index ``MAP_CENTRE +
MAP_PITCH * d``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from motdiff.types import FloatArray

PSF_PX = 64
"""Side of the PSF frame, px: fixed for the networks and the field of HR maps, the default
elsewhere."""
ODD_PX = PSF_PX - 1
"""Side of the frame of kernels that are reflected: an odd one has a middle pixel."""
MAP_PITCH = 4
"""HR-map pixels per PSF pixel."""
MAP_PX = MAP_PITCH * PSF_PX
"""Side of an HR map, in map pixels."""
MAP_CENTRE = MAP_PITCH * (PSF_PX // 2) + (MAP_PITCH - 1) / 2
"""Index of zero displacement in an HR map: the middle of the map pixels within the PSF's pixel of
it."""

_FAINT_SHARE = 0.05  # of the peak: noise of a fitted kernel, docs/decisions/tracing.md
_SPECK_SHARE = 0.1  # of the light: a part with less is noise


def margins(side: int, size: int = PSF_PX) -> tuple[int, int]:
    """Pixels before and after a kernel of ``side`` px in a frame of ``size``; negative if cut.

    Examples
    --------
    >>> margins(39), margins(65), margins(64, 63)
    ((13, 12), (0, -1), (-1, 0))
    """
    before = size // 2 - side // 2
    return before, size - side - before


def in_frame(kernels: ArrayLike, size: int = PSF_PX) -> FloatArray:
    """Pad or cut kernels (..., H, W) to (..., size, size); zero displacement stays in place."""
    light = np.asarray(kernels, dtype=np.float64)
    edges = [margins(side, size) for side in light.shape[-2:]]
    rows, columns = (slice(max(-low, 0), min(high, 0) or None) for low, high in edges)
    pads = [(max(low, 0), max(high, 0)) for low, high in edges]
    return np.pad(light[..., rows, columns], [(0, 0)] * (light.ndim - 2) + pads)


def moved(psf: ArrayLike, *, down_px: int, right_px: int) -> FloatArray:
    """Move a PSF (H, W) by whole pixels, its frame enlarged by as much on every side."""
    grown = np.pad(np.asarray(psf, dtype=np.float64), max(abs(down_px), abs(right_px)))
    return np.roll(grown, (down_px, right_px), axis=(0, 1))


def centroid_px(psf: ArrayLike) -> tuple[float, float]:
    """Centre of mass (down, right), px, of a PSF (H, W) from zero displacement; 0 if empty."""
    light = np.asarray(psf, dtype=np.float64)
    total = float(light.sum())
    if total <= 0:
        return 0.0, 0.0
    down, right = (np.arange(n) - n // 2 for n in light.shape)
    return float(down @ light.sum(axis=1)) / total, float(right @ light.sum(axis=0)) / total


def centred(psf: ArrayLike) -> FloatArray:
    """Move a PSF's centroid to zero displacement, to whole pixels as in :func:`moved`."""
    down_px, right_px = (-round(offset) for offset in centroid_px(psf))
    return moved(psf, down_px=down_px, right_px=right_px)


def without_faint_light(kernels: ArrayLike, *, below: float) -> FloatArray:
    """Set kernels (..., H, W) to 0 below the share ``below`` of their peak; not renormalised."""
    light = np.asarray(kernels, dtype=np.float64)
    return np.where(light < below * light.max(axis=(-2, -1), keepdims=True), 0.0, light)


def without_faint_parts(kernel: FloatArray) -> FloatArray:
    """Drop values below 5 % of the peak, and specks, which add side branches to the path.

    The kernel (k, k) is non-negative, with some light; what is left of it sums to 1.
    """
    bright = without_faint_light(kernel, below=_FAINT_SHARE)
    label, count = ndimage.label(bright, structure=np.ones((3, 3)))
    light = ndimage.sum_labels(bright, label, np.arange(count + 1))
    light[0] = 0  # the background's label
    bright = np.where(light[label] >= min(light.max(), _SPECK_SHARE * bright.sum()), bright, 0.0)
    return np.asarray(bright / bright.sum(), dtype=np.float64)
