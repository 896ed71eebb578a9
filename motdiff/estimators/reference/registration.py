"""Registration of two photos to whole pixels, by cross-correlation of their fine detail."""

from __future__ import annotations

import numpy as np
from scipy import fft, ndimage

from motdiff.types import FloatArray

_LARGE_PX = 1_500_000  # photos with more pixels are first registered binned
_WINDOW_PX = 768  # px: enough texture for a peak, at a fraction of the time of the whole photo


def high_passed(light: FloatArray, *, sigma_px: float) -> FloatArray:
    """Take away the light that varies slowly (a Gaussian mean), and with it any offset.

    Parameters
    ----------
    light : (H, W) float
    sigma_px : float, px
    """
    return np.asarray(
        light - ndimage.gaussian_filter(light, sigma_px, truncate=3), dtype=np.float64
    )


def coarse_shift(
    sharp: FloatArray, blurred: FloatArray, *, sigma_px: float = 4.0
) -> tuple[float, float]:
    """Whole-pixel (dy, dx) that moves ``sharp`` onto ``blurred``; their sizes may differ.

    Parameters
    ----------
    sharp, blurred : (H, W) float
        Photos of one scene, in the same scale and orientation.
    sigma_px : float, px
        Only detail finer than this counts.
    """
    pixels = max(sharp.size, blurred.size)
    if pixels <= _LARGE_PX:
        return _peak(*(high_passed(image, sigma_px=sigma_px) for image in (sharp, blurred)))
    factor = int(np.ceil(np.sqrt(pixels / _LARGE_PX)))
    dy, dx = (
        factor * d
        for d in coarse_shift(_binned(sharp, factor), _binned(blurred, factor), sigma_px=sigma_px)
    )
    # the middle of the overlap, at full size, with room for what binning left open
    starts = []
    lengths = []
    for s, b, d in zip(sharp.shape, blurred.shape, (round(dy), round(dx)), strict=True):
        low = max(0, d)
        high = min(b, s + d)
        length = max(2, min(_WINDOW_PX, high - low))
        starts.append((low + high - length) // 2)
        lengths.append(length)
    windows = [slice(f, f + n) for f, n in zip(starts, lengths, strict=True)]
    firsts = [max(0, f - round(d)) for f, d in zip(starts, (dy, dx), strict=True)]
    beneath = [slice(f, f + n) for f, n in zip(firsts, lengths, strict=True)]
    pair = (sharp[beneath[0], beneath[1]], blurred[windows[0], windows[1]])
    fine = _peak(*(high_passed(image, sigma_px=sigma_px) for image in pair))
    return starts[0] - firsts[0] + fine[0], starts[1] - firsts[1] + fine[1]


def _binned(image: FloatArray, factor: int) -> FloatArray:
    rows, columns = (n // factor for n in image.shape)
    blocks = image[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float64)


def _peak(sharp: FloatArray, blurred: FloatArray) -> tuple[float, float]:
    # padded to both sizes together, so that no lag wraps onto another
    size = tuple(
        fft.next_fast_len(a + b, real=True)
        for a, b in zip(sharp.shape, blurred.shape, strict=True)
    )
    product = fft.rfft2(blurred, size) * np.conj(fft.rfft2(sharp, size))
    peak = np.unravel_index(int(fft.irfft2(product, size).argmax()), size)
    # lags from the blurred photo's size on are negative ones, wrapped round
    dy, dx = (float(p - n * (p >= b)) for p, n, b in zip(peak, size, blurred.shape, strict=True))
    return dy, dx
