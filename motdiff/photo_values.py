"""Values of a photo: linear light and display values, luminance, clipping, and what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motdiff.trajectory import check_positive
from motdiff.types import FloatArray

LEAST_PX = 48
"""Least side of a photo in which the classical search is tried, px."""
CLIPPED_LEVEL = 0.98  # JPEG and demosaicing leave a clipped area a little below full scale
_FULL = 0.95  # a dim photo is brightened up to the first
_DARKEST = 1e-6  # of full scale: a black photo gets a finite gain
_LEAST_GAIN = 1.5  # a photo that would gain less is bright enough, and stays as it is
_SRGB_KNEE_LINEAR = 0.0031308  # IEC 61966-2-1: below, the curve is straight
_SRGB_KNEE_DISPLAY = 0.0031308 * 12.92


def to_display(linear: ArrayLike, *, gamma: float | None = None) -> FloatArray:
    """Encode linear light for display, by a power law or the sRGB curve where ``gamma`` is None.

    It is odd in the value, so noise below 0 survives.
    """
    light = np.asarray(linear, dtype=np.float64)
    size = np.abs(light)
    if gamma is not None:
        check_positive("gamma", gamma)
        return np.copysign(size ** (1 / gamma), light)
    high = 1.055 * np.maximum(size, _SRGB_KNEE_LINEAR) ** (1 / 2.4) - 0.055
    return np.copysign(np.where(size <= _SRGB_KNEE_LINEAR, 12.92 * size, high), light)


def to_linear(display: ArrayLike, *, gamma: float | None = None) -> FloatArray:
    """Decode display values to linear light by a power law, or sRGB where ``gamma`` is None."""
    value = np.asarray(display, dtype=np.float64)
    size = np.abs(value)
    if gamma is not None:
        check_positive("gamma", gamma)
        return np.copysign(size**gamma, value)
    high = ((np.maximum(size, _SRGB_KNEE_DISPLAY) + 0.055) / 1.055) ** 2.4
    return np.copysign(np.where(size <= _SRGB_KNEE_DISPLAY, size / 12.92, high), value)


def luminance(photo: ArrayLike) -> FloatArray:
    """Mean of the colour channels, (H, W), of a photo in linear light; a grey photo as it is.

    ValueError if the shape is neither (H, W) nor (H, W, C), or a value is not finite.
    """
    image = np.asarray(photo)
    if image.dtype.kind != "f":
        image = image.astype(np.float64)
    if image.ndim not in (2, 3) or 0 in image.shape:
        raise ValueError(f"photo: must be (H, W) or (H, W, C), got shape {image.shape}")
    if not np.isfinite(image).all():
        raise ValueError("photo: must be finite, found NaN or infinity")
    # a large photo comes in single precision, and is never held in double with all its colours
    if image.ndim == 3:
        return np.asarray(image.mean(axis=2, dtype=np.float64))
    return np.asarray(image, dtype=np.float64)


def exposure_gain(photo: ArrayLike) -> float:
    """Factor that brightens a dim photo as far as full scale allows; 1 for a bright one.

    What is searched and chosen by limits on light and noise then hardly depends on a photo's
    exposure.

    Examples
    --------
    >>> round(exposure_gain([[0.05, 0.1]]), 3), exposure_gain([[0.1, 1.0]])
    (9.5, 1.0)
    """
    gain = _FULL / max(float(np.max(photo, initial=0.0)), _DARKEST)
    return 1.0 if gain < _LEAST_GAIN else gain


def clipped_mask(photo: ArrayLike) -> NDArray[np.bool_]:
    """Pixels (H, W) of a photo (H, W) or (H, W, C) with a channel at :data:`CLIPPED_LEVEL`."""
    high = np.asarray(photo) >= CLIPPED_LEVEL
    return np.asarray(high if high.ndim == 2 else high.any(axis=2))


def check_size(photo: ArrayLike, *, least_px: int) -> None:
    """Refuse a photo (H, W) or (H, W, C) with a side shorter than ``least_px``."""
    height, width = np.shape(photo)[:2]
    if min(height, width) < least_px:
        raise ValueError(
            f"photo: needs at least {least_px} x {least_px} px, got {width} x {height}"
        )


def textured_luminance(photo: ArrayLike, *, least_px: int) -> FloatArray:
    """:func:`luminance` of a photo in which motion can be searched.

    ValueError as there, if a side is shorter than ``least_px``, or if all pixels are the same.
    """
    grey = luminance(photo)
    check_size(grey, least_px=least_px)
    if np.ptp(grey) == 0:
        raise ValueError("photo: is constant; motion shows only where the scene has texture")
    return grey


@contextmanager
def numbered_photo(number: int, *, count: int) -> Iterator[None]:
    """Let an error about a photo begin with ``photo:``, of several with its number."""
    try:
        yield
    except ValueError as error:
        name = "photo" if count == 1 else f"photo {number}"
        raise ValueError(f"{name}: {str(error).removeprefix('photo: ')}") from None
