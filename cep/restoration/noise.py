"""Power spectra of scene and noise in a blurred photo, fitted to its periodogram."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, optimize

from cep.optics.camera import Camera
from cep.restoration.blur import Blur, frequencies, power_law
from motdiff.types import FloatArray

# far below one 16-bit step (2e-11): keeps logarithms finite on noise-free photos
_SMALLEST_VARIANCE = 1e-14


@dataclass(frozen=True)
class Spectrum:
    """Power spectral density of a photo: ``scene |H|^2 / f^2 + noise``.

    Attributes
    ----------
    scene : float
        Constant A of the scene's spectrum A / f^2, f in cy/px, per pixel.
    noise : float
        Variance of the white noise per pixel.
    cost : float
        Mean negative log-likelihood per frequency at these values.
    """

    scene: float
    noise: float
    cost: float


def check_noise(camera: Camera | None, noise_variance: float | None) -> None:
    """Refuse a noise variance beside a camera, which has its own, and a negative one."""
    if camera is not None and noise_variance is not None:
        raise ValueError("noise_variance: give either a camera or the variance, not both")
    if noise_variance is not None and not noise_variance >= 0:
        raise ValueError(f"noise_variance: must be 0 or more, got {noise_variance}")


def fit_spectrum(
    image: FloatArray, blur: Blur, *, noise_variance: float | None = None, shaped: bool = False
) -> Spectrum:
    """Fit the scene's spectrum, and the noise when it is not given, to one channel.

    Parameters
    ----------
    image : (H, W) float
    blur : Blur
        Of the light-true PSF, on the periodic grid of the image.
    noise_variance : float, optional
        Known noise variance per pixel.
    shaped : bool
        Let the scene's spectrum deviate from A / f^2 by a smooth factor: another exponent, and
        stronger or weaker in some directions. ``scene`` is then its value at ``f = exp(-2)``
        cy/px, times f^2.

    References
    ----------
    Whittle, "Estimation and information in stationary time series", 1953: the periodogram's
    likelihood.
    """
    density, power, log_f, angle = _periodogram(image, blur)
    if density.max(initial=0.0) <= _SMALLEST_VARIANCE:
        # a flat photo: rounding is all there is, and without a floor under the noise a filter
        # would amplify that
        return Spectrum(_SMALLEST_VARIANCE, max(noise_variance or 0.0, _SMALLEST_VARIANCE), 0.0)
    terms = np.ones((1, density.size))
    if shaped:
        terms = _smooth_terms(log_f, angle)
    law = power * np.exp(-2 * log_f)

    def cost(parameters: FloatArray) -> tuple[float, FloatArray]:
        # beyond exp(60) a step of the line search would overflow
        scene = np.exp(np.clip(parameters[: len(terms)] @ terms, -60, 60)) * law
        noise = noise_variance
        if noise is None:
            noise = np.exp(np.clip(parameters[-1], -60, 60))
        expected = scene + noise + _SMALLEST_VARIANCE
        slope = (1 / expected - density / expected**2) / density.size
        gradient = terms @ (slope * scene)
        if noise_variance is None:
            gradient = np.append(gradient, slope.sum() * noise)
        return float(np.mean(np.log(expected) + density / expected)), gradient

    start = np.zeros(len(terms) + (noise_variance is None))
    # an exponential law's median is log 2 times its mean
    start[0] = np.log(
        np.median(density / np.maximum(law, 1e-300)) / np.log(2) + _SMALLEST_VARIANCE
    )
    if noise_variance is None:
        # where the scene is weakest noise is left
        start[-1] = np.log(np.quantile(density, 0.05) + _SMALLEST_VARIANCE)
    fit = optimize.minimize(cost, start, jac=True, method="L-BFGS-B")
    noise = noise_variance
    if noise is None:
        noise = np.exp(fit.x[-1])
    return Spectrum(float(np.exp(fit.x[0])), float(noise), float(fit.fun))


def _periodogram(
    image: FloatArray, blur: Blur
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Hann-windowed periodogram, |H|^2, log |f| and angle, (n,) each, without the DC lobe."""
    window = np.outer(np.hanning(image.shape[0] + 2)[1:-1], np.hanning(image.shape[1] + 2)[1:-1])
    mean = float((image * window).sum() / window.sum())
    density = np.abs(fft.rfft2((image - mean) * window)) ** 2 / (window**2).sum()
    f2 = power_law(image.shape)
    fy, fx = frequencies(image.shape)
    # the main lobe of the Hann window around f = 0 reaches 2 bins
    usable = f2 > (3 / min(image.shape)) ** 2
    return (
        density[usable],
        blur.power[usable],
        0.5 * np.log(f2[usable]),
        np.arctan2(fy + 0 * fx, fx + 0 * fy)[usable],
    )


def _smooth_terms(log_f: FloatArray, angle: FloatArray) -> FloatArray:
    """Factors of a smooth log spectrum, (9, n): in log f, and even angular harmonics."""
    u = log_f + 2  # about the middle of the band, so that the terms are nearly independent
    c2 = np.cos(2 * angle)
    s2 = np.sin(2 * angle)
    return np.array(
        [np.ones_like(u), u, u**2, c2, s2, np.cos(4 * angle), np.sin(4 * angle), u * c2, u * s2]
    )
