"""Code value of white in a photo's file, where the camera has fewer bits than the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motdiff.photo_noise import noise_sigma
from motdiff.photo_values import CLIPPED_LEVEL

_DEPTHS = (8, 10, 12)  # bits of cameras whose photo in a 16-bit file is too dark for any other
_UNSURE_DEPTH = 14  # a photo with light of a quarter of full scale may be one of 16 bits
_LEAST_CODES = 16  # that a photo holds; a mask or a chart has fewer
_WINDOW = 512  # parts of the range: what is saturated lies within one
_WINDOWS_BELOW = 8
_PILED = 10.0  # times as many pixels as in a window below
_LEAST_SATURATED = 1e-3  # share of the samples
_LEAST_NOISE = 0.5  # of a photo whose flat top is no part of a drawing, code values
_CHUNK = 2**22  # samples counted at once: bincount makes 64-bit integers of them


@dataclass(frozen=True)
class WhiteLevel:
    """Code value that stands for light 1, and what was assumed for it, if anything."""

    code: int
    assumption: str = ""


def white_level(codes: NDArray[Any]) -> WhiteLevel:
    """Find the code value of white from those that a photo holds, 8 or 16 bits, any channels.

    Many equal values at the top of a noisy photo are saturated. A 16-bit file of consecutive
    values up to 4095 at most holds the code values of 8, 10 or 12 bits: as light of 16 bits, it
    would be below 6 % of full scale throughout.
    """
    full = int(np.iinfo(codes.dtype).max)
    largest = int(codes.max())
    if largest >= CLIPPED_LEVEL * full:
        return WhiteLevel(full)
    flat = codes.reshape(-1)
    chunks = (flat[start : start + _CHUNK] for start in range(0, flat.size, _CHUNK))
    histogram = np.sum([np.bincount(chunk, minlength=full + 1) for chunk in chunks], axis=0)
    codes_present = np.flatnonzero(histogram)
    if codes_present.size <= _LEAST_CODES:
        return WhiteLevel(full)
    gap = int(np.diff(codes_present).min())  # 16 where 12 bits are shifted up to 16
    if _is_saturated(histogram, largest, gap) and _noise(codes) > _LEAST_NOISE * gap:
        share = histogram[largest - _window(largest, gap) + 1 :].sum() / histogram.sum()
        return WhiteLevel(
            largest, f"{share:.1%} of its values are at its largest, {largest}: taken as saturated"
        )
    # 8 bits leave none unused, and gaps are those of values already scaled to the file's range
    if full == 255 or gap > 1 or largest >= 2**_UNSURE_DEPTH:
        return WhiteLevel(full)
    bits = next((depth for depth in _DEPTHS if largest < 2**depth), None)
    if bits is None:
        times = 2 ** (16 - _UNSURE_DEPTH)
        hint = (
            f"if its camera has {_UNSURE_DEPTH} bits, it is {times} times brighter: multiply its"
            f" values by {times}"
        )
        return WhiteLevel(full, f"no value exceeds {largest} of {full}; {hint}")
    return WhiteLevel(
        2**bits - 1,
        f"no value exceeds {largest} of {full}: taken as {bits}-bit values, white at"
        f" {2**bits - 1}; if it is so dark, save it as floating point",
    )


def _window(largest: int, gap: int) -> int:
    return max(gap, largest // _WINDOW)


def _is_saturated(histogram: NDArray[np.int64], largest: int, gap: int) -> bool:
    """Whether the values pile up at the largest, above others that are all there."""
    window = _window(largest, gap)
    end = largest - window + 1
    piled = int(histogram[end:].sum())
    below = histogram[max(0, end - _WINDOWS_BELOW * window) : end]
    is_dense = 2 * gap * np.count_nonzero(below) >= below.size
    return bool(
        is_dense
        and piled > _LEAST_SATURATED * histogram.sum()
        and piled > _PILED * float(below.sum()) / _WINDOWS_BELOW
    )


def _noise(codes: NDArray[Any]) -> float:
    """Estimate the standard deviation of the noise, code values."""
    channels = np.atleast_3d(codes)
    green = channels[:, :, min(1, channels.shape[2] - 1)]  # the least interpolated
    return noise_sigma(green.astype(np.float64))
