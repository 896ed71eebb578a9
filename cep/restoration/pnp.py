"""Plug-and-play restoration: half-quadratic splitting with a trained denoiser for its prior."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from cep.optics.camera import Camera
from cep.restoration.borders import Border, reblurred_extension, working_shape
from cep.restoration.noise import fit_spectrum
from cep.restoration.spectral import (
    channels_first,
    channels_last,
    otf_on_grid,
    power_law,
    trimmed_psf,
)
from motdiff.types import FloatArray

Denoiser = Callable[[FloatArray, float], FloatArray]
_STEPS = 8
_FIRST_SIGMA = 0.1
_PRIOR = 0.4  # weight of the prior; at the paper's 0.23 noise comes through more often
_SMALLEST_POWER = 1e-12
_SMALLEST_VARIANCE = 1e-10  # keeps the levels apart from 0 on noise-free photos


def pnp(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    camera: Camera | None = None,
    noise_variance: float | None = None,
    denoiser: Denoiser | None = None,
    border: Border = "real",
    border_rounds: int = 10,
) -> FloatArray:
    r"""Minimise ``|K x - y|^2 / 2N + 0.4 R(z)`` with x = z, noise variance N, the prior R being a
    denoiser's.

    Eight times, x is found in closed form in the Fourier domain, ``|K x - y|^2 + a |x - z|^2``
    with ``a = 0.4 N / s^2``, and z is x denoised at the level s, which falls log-evenly from 0.1
    to the photo's noise. The first x is the Wiener filter's. Photo and PSF are first divided by
    the PSF's sum.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light
    psf : (S, S) array_like
        Light-true PSF, zero displacement at index ``size // 2``.
    camera : Camera, optional
        Gives N: the mean of its noise variance over the photo. Without it, and without
        ``noise_variance``, N is estimated from the photo's spectrum.
    noise_variance : float, optional
        N itself, in full-scale units squared per pixel.
    denoiser : callable, optional
        Takes an (H, W) image and the standard deviation of its white noise; the trained one of
        :mod:`cep.restoration.denoiser` when omitted.
    border : {"real", "periodic"}
        Whether light came in from outside the frame, or the photo is one period of a periodic
        scene.
    border_rounds : int
        Rounds of reblurring outside a real border.

    Returns
    -------
    float ndarray like ``photo``
        At the scale of the full open exposure. Within the PSF's reach of a real border it is a
        guess.

    Raises
    ------
    ValueError
        If an argument is malformed, or both ``camera`` and ``noise_variance`` are given.

    Notes
    -----
    With little noise and a PSF that is not quite right :func:`cep.restoration.tv.tv`, which trusts
    the PSF less, is better.

    References
    ----------
    Venkatakrishnan, Bouman, Wohlberg, "Plug-and-play priors for model based reconstruction",
    GlobalSIP 2013. Zhang, Li, Zuo, Zhang, Van Gool, Timofte, "Plug-and-play image restoration with
    deep denoiser prior", TPAMI 2022: the splitting and its levels.
    """
    if camera is not None and noise_variance is not None:
        raise ValueError("noise_variance: give either a camera or the variance, not both")
    if noise_variance is not None and not (np.isfinite(noise_variance) and noise_variance >= 0):
        raise ValueError(f"noise_variance: must be 0 or more, got {noise_variance}")
    channels = channels_first(photo)
    kernel = trimmed_psf(psf)
    channels, kernel, duty = channels / kernel.sum(), kernel / kernel.sum(), kernel.sum()
    size = (channels.shape[1], channels.shape[2])
    shape = working_shape(size, kernel.shape[0], border)
    transfer = otf_on_grid(kernel, shape)
    if denoiser is None:
        from cep.restoration.denoiser.weights import load_denoiser

        denoiser = load_denoiser()
    restored = np.empty_like(channels)
    for channel, out in zip(channels, restored, strict=True):
        known = (
            float(camera.noise_variance(duty * channel).mean())
            if camera is not None
            else noise_variance
        )
        found = fit_spectrum(
            channel, kernel, noise_variance=None if known is None else known / duty**2
        )
        noise = max(found.noise, _SMALLEST_VARIANCE)
        ratio = noise / found.scene
        extended = channel
        if border == "real":
            extended = reblurred_extension(
                channel, kernel, shape, noise_to_scene=ratio, rounds=border_rounds
            )
        out[:] = _split(extended, transfer, noise, ratio, denoiser)[: size[0], : size[1]]
    return channels_last(restored)


def _split(
    image: FloatArray,
    transfer: NDArray[np.complex128],
    noise: float,
    ratio: float,
    denoise: Denoiser,
) -> FloatArray:
    """Restore one periodic channel."""
    power = np.abs(transfer) ** 2
    data = np.conj(transfer) * fft.rfft2(image)
    last = float(np.sqrt(noise))
    # the first step knows no z yet: the scene's spectrum stands in
    estimate = data / np.maximum(power + ratio * power_law(image.shape), _SMALLEST_POWER)
    first, *later = np.geomspace(max(_FIRST_SIGMA, last), last, _STEPS)
    latent = denoise(fft.irfft2(estimate, image.shape), float(first))
    for sigma in later:
        weight = _PRIOR * noise / sigma**2
        estimate = (data + weight * fft.rfft2(latent)) / np.maximum(
            power + weight, _SMALLEST_POWER
        )
        latent = denoise(fft.irfft2(estimate, image.shape), float(sigma))
    return latent
