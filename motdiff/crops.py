"""Textured, unsaturated crops of a large photo, and a test of uniform blur across them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motdiff.metrics import mnc_subpixel
from motdiff.photo_values import clipped_mask, luminance
from motdiff.types import FloatArray

CROP_PX = 256
"""Side of the crops in which motion is searched, px."""
# a crop with this share of clipped pixels is used only when there is nothing else
_CLIPPED_SHARE = 0.02
_OVERLAP_SHARE = 0.25  # of a crop's area, with any other
_WHOLE = 1.25  # a photo larger than a crop by up to this is taken whole


def centre_crop(image: NDArray[Any], rows: int, columns: int) -> NDArray[Any]:
    """Middle of an image, at most so many rows and columns; a view of it."""
    height, width = (min(image.shape[0], rows), min(image.shape[1], columns))
    row, column = ((image.shape[0] - height) // 2, (image.shape[1] - width) // 2)
    return image[row : row + height, column : column + width]


def pick_crops(photo: ArrayLike, *, size: int = CROP_PX, count: int = 4) -> list[tuple[int, int]]:
    """Choose crops that constrain the blur best: their first (row, column), the best first.

    They have edges in several directions, few clipped pixels, and little overlap. The value of a
    crop is the smaller eigenvalue of its structure tensor (the summed outer products of the
    gradient): stripes of one direction, which hide the motion along them, have the value 0.
    ValueError if the photo is not an image, or ``size`` or ``count`` is not positive.

    Parameters
    ----------
    photo : (H, W) or (H, W, C) array_like, linear light 0..1
    size : int, px
        Side of the square crops; a smaller photo is taken whole in that direction.
    count : int
        Most crops; there is at least one.

    References
    ----------
    Hu and Yang, "Good regions to deblur", ECCV 2012.
    """
    image = luminance(photo)
    if size < 2 or count < 1:
        raise ValueError(f"size, count: must be at least 2 and 1, got {size} and {count}")
    height, width = (min(size, n) for n in image.shape)
    clipped = clipped_mask(photo)
    dy = np.diff(image, axis=0, append=image[-1:])
    dx = np.diff(image, axis=1, append=image[:, -1:])
    dy[clipped], dx[clipped] = 0, 0
    rows, columns = (
        _starts(n, length) for n, length in zip(image.shape, (height, width), strict=True)
    )

    def window_mean(values: NDArray[np.float64]) -> FloatArray:
        summed = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
        np.cumsum(values, axis=0, out=summed[1:, 1:])
        np.cumsum(summed, axis=1, out=summed)
        low = summed[rows]
        high = summed[rows + height]
        total = (
            high[:, columns + width] - high[:, columns] - low[:, columns + width] + low[:, columns]
        )
        return np.asarray(total / (height * width), dtype=np.float64)

    xx = window_mean(dx * dx)
    yy = window_mean(dy * dy)
    xy = window_mean(dx * dy)
    smaller = 0.5 * (xx + yy - np.hypot(xx - yy, 2 * xy))
    # a clipped crop ranks behind every other one, by the same measure
    score = np.maximum(smaller, 0) * np.maximum(
        1 - window_mean(clipped.astype(np.float64)) / _CLIPPED_SHARE, 1e-6
    )
    chosen: list[tuple[int, int]] = []
    for index in np.argsort(-score, axis=None, kind="stable"):
        row = int(rows[index // len(columns)])
        column = int(columns[index % len(columns)])
        if all(_overlap(row - r, column - c, height, width) <= _OVERLAP_SHARE for r, c in chosen):
            chosen.append((row, column))
            if len(chosen) == count:
                break
    return chosen


def best_windows(grey: FloatArray, *, count: int) -> list[tuple[slice, slice]]:
    """Windows of a photo (H, W) to search its blur in: all of it, or :func:`pick_crops`."""
    # of a photo hardly larger than a crop they would all be the same
    if max(grey.shape) <= _WHOLE * CROP_PX:
        return [(slice(0, grey.shape[0]), slice(0, grey.shape[1]))]
    size = min(CROP_PX, *grey.shape)
    corners = pick_crops(grey, size=size, count=count)
    return [(slice(row, row + size), slice(column, column + size)) for row, column in corners]


def uniformity(psfs: Sequence[ArrayLike]) -> float:
    """Mean mutual sub-pixel MNC of PSFs (S, S) from places of a photo; 1 for a single one.

    ValueError without any.
    """
    if not psfs:
        raise ValueError("psfs: needs at least one")
    return float(np.mean([mnc_subpixel(a, b) for a, b in combinations(psfs, 2)] or [1.0]))


def blur_differs_warning(psfs: Sequence[ArrayLike], *, limit: float = 0.75) -> str | None:
    """Return a sentence for the user when the blur differs across the photo, else None.

    ``limit`` is the least mutual MNC of the crops' kernels (S, S) that counts as one blur.
    Unrelated motions of a hand reach 0.4 to 0.55.
    """
    score = uniformity(psfs)
    if score >= limit:
        return None
    return (
        f"The blur differs across the photo (mutual MNC {score:.2f} of {len(psfs)} crops): no"
        " single trajectory fits."
    )


def _starts(length: int, size: int) -> NDArray[np.intp]:
    return np.unique(np.append(np.arange(0, length - size + 1, max(1, size // 8)), length - size))


def _overlap(dy: int, dx: int, height: int, width: int) -> float:
    return max(0, height - abs(dy)) * max(0, width - abs(dx)) / (height * width)
