"""Telling a good kernel from a lost one, without the truth.

Blind estimation fails silently: a lost kernel restores to a sparse picture too, so sparsity cannot choose. Two things
that the sparse search never looks at can. The photo's *power spectrum* has the kernel's zeros in it (no phase), and
the *phase* tells a kernel from its point reflection (same power). Both are compared with nothing but the photo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from motdiff.metrics import mnc_subpixel

__all__ = ["FEATURES", "Ranking", "kernel_features", "noise_sigma", "phase_evidence", "rank_kernels", "spectral_fit"]

FloatArray = NDArray[np.float64]

FEATURES = ("spectral_fit", "agreement", "phase_evidence", "rim_light")

_TOP = 3  # how many like-minded candidates count as agreement
_LEAST_SIGMA = 1e-3
_BAND_CY_PX = (0.02, 0.4)
_SPARSE_NORM = 0.8


@dataclass(frozen=True)
class Ranking:
    """Which of several kernels to believe, and how much.

    Attributes
    ----------
    best : int
        Index of the chosen kernel.
    probabilities : (K,) float
        Probability of each that its sub-pixel MNC is 0.7 or more.
    agreement : float
        Mean MNC of the chosen kernel with the candidates most like it.
    """

    best: int
    probabilities: FloatArray
    agreement: float

    @property
    def confidence(self) -> float:
        """Probability that the chosen kernel is good."""
        return float(self.probabilities[self.best])


def noise_sigma(photo: FloatArray) -> float:
    """Estimate the standard deviation of white noise in a photo (H, W) from its mixed second differences.

    References
    ----------
    Immerkaer, "Fast noise variance estimation", CVIU 1996; here with the median, which blurred edges leave alone.
    """
    second = photo[:, :-2] - 2 * photo[:, 1:-1] + photo[:, 2:]
    mixed = second[:-2] - 2 * second[1:-1] + second[2:]
    return float(np.median(np.abs(mixed)) / 0.6745 / 6)


def spectral_fit(photo: FloatArray, kernel: FloatArray, *, sigma: float) -> float:
    r"""Correlation, -1..1, of the photo's log power spectrum with the kernel's, over what scenes do by themselves.

    The model is ``A |K(f)|^2 / |f|^2 + sigma^2``, A at its maximum likelihood. A smooth scene spectrum (a power law
    with curvature, and two harmonics of orientation) is regressed out of both sides, so that what remains are the
    dips that only the kernel makes.

    Parameters
    ----------
    photo : (H, W) float
    kernel : (k, k) float, sum 1
    sigma : float
        Standard deviation of the noise.

    References
    ----------
    Whittle, "Estimation and information in stationary time series", 1953 (likelihood of a periodogram).
    """
    height, width = photo.shape
    window = np.hanning(height)[:, None] * np.hanning(width)[None, :]
    window /= np.sqrt(np.mean(window**2))
    centred = (photo - np.average(photo, weights=window)) * window
    power = np.abs(fft.fft2(centred)) ** 2 / (height * width)
    fy, fx = fft.fftfreq(height)[:, None], fft.fftfreq(width)[None, :]
    radius2 = fx**2 + fy**2
    used = (radius2 > _BAND_CY_PX[0] ** 2) & (radius2 < _BAND_CY_PX[1] ** 2) & (fx >= 0)
    radius2[0, 0] = 1.0
    scene = np.abs(fft.fft2(kernel, s=(height, width))) ** 2 / radius2
    floor = max(sigma, _LEAST_SIGMA) ** 2
    start = np.exp(np.median(np.log(power[used])) - np.median(np.log(scene[used] + 1e-12)))
    models = [amplitude * scene + floor for amplitude in start * np.geomspace(0.03, 30, 9)]
    misfits = [float(np.mean(np.log(model[used]) + power[used] / model[used])) for model in models]
    model = models[int(np.argmin(misfits))]
    log_radius, angle = np.log(radius2)[used], np.arctan2(fy, fx)[used]
    smooth = np.stack(
        [np.ones_like(angle), log_radius, log_radius**2]
        + [wave(order * angle) for order in (2, 4) for wave in (np.cos, np.sin)],
        axis=1,
    )
    basis, _ = np.linalg.qr(smooth)
    # 3 x 3 means tame the exponential scatter of a periodogram
    sides = [np.log(ndimage.uniform_filter(side, 3, mode="wrap"))[used] for side in (power, model)]
    seen, expected = (side - basis @ (basis.T @ side) for side in sides)
    return float(seen @ expected / np.sqrt((seen @ seen) * (expected @ expected) + 1e-12))


def phase_evidence(photo: FloatArray, kernel: FloatArray, *, sigma: float) -> float:
    """Log ratio of gradient sparsity after restoring with the point-reflected kernel, and with the kernel itself.

    Positive when the kernel's phase is right: the reflected one has the same power but rings.

    Parameters
    ----------
    photo : (H, W) float
    kernel : (k, k) float, odd k
    sigma : float
        Standard deviation of the noise.
    """
    energy = float(np.mean(np.diff(photo, axis=0) ** 2) + np.mean(np.diff(photo, axis=1) ** 2))
    noise_to_scene = 40 * max(sigma, 2e-3) ** 2 / max(energy - 4 * sigma**2, 1e-6)
    sparsities = []
    for candidate in (kernel, kernel[::-1, ::-1]):
        restored = _wiener(photo, candidate, noise_to_scene)
        gradients = np.concatenate([np.diff(restored, axis=axis).ravel() for axis in (0, 1)])
        norm = np.mean(np.abs(gradients) ** _SPARSE_NORM) / np.mean(gradients**2) ** (_SPARSE_NORM / 2)
        sparsities.append(float(np.log(norm)))
    return sparsities[1] - sparsities[0]


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
    (K, F) float: spectral fit and phase evidence (means over crops), mean sub-pixel MNC with the candidates most
    alike, and the share of light on the frame's rim.
    """
    count = len(kernels)
    alike = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            alike[i, j] = alike[j, i] = mnc_subpixel(kernels[i], kernels[j])
    top = max(min(_TOP, count - 1), 1)
    agreement = np.sort(alike, axis=1)[:, -top:].mean(axis=1) if count > 1 else np.ones(1)
    sigma = float(np.median([noise_sigma(photo) for photo in photos]))
    rows = []
    for kernel, agreed in zip(kernels, agreement, strict=True):
        fit = np.mean([spectral_fit(photo, kernel, sigma=sigma) for photo in photos])
        phase = np.mean([phase_evidence(photo, kernel, sigma=sigma) for photo in photos])
        rows.append((fit, agreed, phase, 1 - kernel[1:-1, 1:-1].sum() / kernel.sum()))
    return np.array(rows, dtype=np.float64)


# Fitted on simulated motions over training photos (120 photos, 8 or 9 starts each): the weights of FEATURES choose the
# kernel with the highest MNC on average; the slope and offset turn the winner's score into the share of winners with a
# sub-pixel MNC of 0.7 or more.
_WEIGHTS = np.array([0.8, 0.4, 2.0, -1.0])
_SLOPE, _OFFSET = 8.3, -5.15


def rank_kernels(photos: FloatArray, kernels: Sequence[FloatArray]) -> Ranking:
    """Choose among candidate kernels of one photo.

    Parameters
    ----------
    photos : (C, H, W) float
        Crops that share one blur.
    kernels : sequence of (k, k) float, odd k, sum 1
    """
    features = kernel_features(photos, kernels)
    probabilities = 1 / (1 + np.exp(-(_SLOPE * (features @ _WEIGHTS) + _OFFSET)))
    best = int(np.argmax(probabilities))
    return Ranking(best, probabilities, float(features[best, FEATURES.index("agreement")]))


def _wiener(photo: FloatArray, kernel: FloatArray, noise_to_scene: float) -> FloatArray:
    """Wiener restoration with a 1/f^2 scene; mirrored margins, cropped with 8 px more."""
    margin = min(32, min(photo.shape) // 4)
    padded = np.pad(photo, margin, mode="symmetric")
    centre = kernel.shape[0] // 2
    frame = np.zeros_like(padded)
    frame[: kernel.shape[0], : kernel.shape[1]] = kernel
    transfer = fft.rfft2(np.roll(frame, (-centre, -centre), axis=(0, 1)))
    radius2 = fft.fftfreq(padded.shape[0])[:, None] ** 2 + fft.rfftfreq(padded.shape[1])[None, :] ** 2
    restored = fft.irfft2(
        transfer.conj() * fft.rfft2(padded) / (np.abs(transfer) ** 2 + noise_to_scene * radius2 + 1e-12),
        s=padded.shape,
    )
    inner = slice(margin + 8, -margin - 8)
    return np.asarray(restored[inner, inner], dtype=np.float64)
