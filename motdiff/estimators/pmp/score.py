"""Figures that tell a good kernel from a lost one, without the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from motdiff.metrics import mnc_subpixel

__all__ = ["FEATURES", "agreement", "kernel_features", "noise_sigma", "whittle"]

FloatArray = NDArray[np.float64]

FEATURES = ("agreement", "best_agreement", "whittle_gain", "whittle_lead", "compactness", "edge_light", "texture")

_TOP = 3
_CLOSE_PX = 0.06


def agreement(kernels: Sequence[FloatArray]) -> FloatArray:
    """Mutual sub-pixel MNC of candidate kernels, (K, K) with ones on the diagonal.

    Lost kernels differ from start to start; good ones come out alike.
    """
    count = len(kernels)
    table = np.eye(count)
    for i in range(count):
        for j in range(i):
            table[i, j] = table[j, i] = mnc_subpixel(kernels[i], kernels[j])
    return table


def noise_sigma(photo: FloatArray) -> float:
    """Standard deviation of white noise in a photo (H, W), from its mixed second differences.

    References
    ----------
    Immerkaer, "Fast noise variance estimation", CVIU 1996; here with the median, which blurred edges leave alone.
    """
    second = photo[:, :-2] - 2 * photo[:, 1:-1] + photo[:, 2:]
    mixed = second[:-2] - 2 * second[1:-1] + second[2:]
    return float(np.median(np.abs(mixed)) / 0.6745 / 6)


def whittle(photos: FloatArray, kernel: FloatArray, *, sigma: float) -> float:
    r"""Mean log-likelihood of the photos' power spectra under ``A |K(f)|^2 / |f|^2 + sigma^2``, A at its best.

    The power spectrum sees |K| but no phase, so it judges independently of the sparse gradients that made the kernel.

    Parameters
    ----------
    photos : (C, H, W) float
        Crops.
    kernel : (k, k) float, sum 1
    sigma : float
        Standard deviation of the noise.

    References
    ----------
    Whittle, "Estimation and information in stationary time series", 1953.
    """
    height, width = photos.shape[-2:]
    window = np.hanning(height)[:, None] * np.hanning(width)[None, :]
    window = window / np.sqrt(np.mean(window**2))
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]
    radius2 = fx**2 + fy**2
    used = (radius2 > 0.02**2) & (radius2 < 0.45**2)
    transfer = np.abs(np.fft.rfft2(kernel, s=(height, width))[used]) ** 2 / radius2[used]
    total = 0.0
    for photo in photos:
        centred = (photo - photo.mean()) * window
        power = np.abs(np.fft.rfft2(centred)[used]) ** 2 / (height * width)
        floor = max(sigma, 1e-3) ** 2
        best = -np.inf
        scale = np.median(power) / np.median(transfer)
        for amplitude in scale * np.geomspace(1e-2, 1e2, 25):
            model = amplitude * transfer + floor
            best = max(best, -float(np.mean(np.log(model) + power / model)))
        total += best
    return total / len(photos)


def kernel_features(photos: FloatArray, kernels: Sequence[FloatArray]) -> FloatArray:
    """Features (K, len(FEATURES)) of the candidate kernels of one photo.

    Parameters
    ----------
    photos : (C, H, W) float
        Crops that share one blur.
    kernels : sequence of (k, k) float
        Candidates; their frames may differ.

    Returns
    -------
    (K, F) float: mean MNC with the three candidates most alike, the largest such figure of the photo; Whittle
    log-likelihood over the best isotropic Gaussian, and over the mean candidate; participation
    ``1 / (sum k^2 * extent^2)``; light on the outermost frame pixels; log of the crops' gradient-to-noise ratio.
    """
    table = agreement(kernels)
    np.fill_diagonal(table, -1)
    top = min(_TOP, max(len(kernels) - 1, 1))
    alike = np.sort(table, axis=1)[:, -top:].mean(axis=1)
    sigma = float(np.median([noise_sigma(photo) for photo in photos]))
    likelihood = np.array([whittle(photos, kernel, sigma=sigma) for kernel in kernels])
    null = max(whittle(photos, _gaussian(s), sigma=sigma) for s in (0.5, 1.0, 2.0, 3.0, 4.5, 6.5))
    gradients = np.mean([np.mean(np.diff(photo, axis=0) ** 2) + np.mean(np.diff(photo, axis=1) ** 2) for photo in photos])
    texture = np.log10(max(gradients / (4 * max(sigma, 1e-3) ** 2) - 1, 1e-2))
    rows = []
    for i, kernel in enumerate(kernels):
        y, x = np.nonzero(kernel)
        extent = max(np.ptp(y), np.ptp(x)) + 1
        rim = 1 - kernel[1:-1, 1:-1].sum() / kernel.sum()
        compact = np.log(kernel.sum() ** 2 / np.sum(kernel**2) / extent)
        rows.append(
            (alike[i], alike.max(), likelihood[i] - null, likelihood[i] - likelihood.mean(), compact, rim, texture)
        )
    return np.array(rows, dtype=np.float64)


def _gaussian(sigma_px: float) -> FloatArray:
    offsets = np.arange(-24, 25)
    profile = np.exp(-0.5 * (offsets / sigma_px) ** 2)
    kernel = profile[:, None] * profile[None, :]
    return np.asarray(kernel / kernel.sum(), dtype=np.float64)
