"""Plug-and-play restoration: half-quadratic splitting with a trained denoiser for its prior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.camera import Camera
from cep.restoration.blur import SMALLEST_POWER, Blur, Border, channels_last, normalised, power_law
from cep.restoration.noise import Spectrum, check_noise, fit_spectrum
from motdiff.psf_frame import in_frame
from motdiff.types import FloatArray

Denoiser = Callable[[FloatArray, FloatArray], FloatArray]
STEPS = 6
FIRST_SIGMA = 0.1  # first level of the denoiser, of full scale: docs/decisions/restoration.md
MOST_RATIO = 60  # of the first level to the last: larger steps leave a texture on even tones
PRIOR = 0.4  # weight of the prior; at the paper's 0.23 noise comes through more often
# Conjugate-gradient steps towards what lies outside the border, and the squared error, over the
# noise, at which they end: docs/decisions/restoration.md
_MOST_ROUNDS = 20
_TOLERANCE = 3e-4
_SMALLEST_VARIANCE = 1e-6  # keeps the levels apart from 0 on noise-free photos


def pnp(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    camera: Camera | None = None,
    noise_variance: float | None = None,
    denoiser: Denoiser | None = None,
    border: Border = "real",
    border_rounds: int = 10,
    progress: Callable[[float], None] = lambda _share: None,
) -> FloatArray:
    """Minimise ``|A x - y|^2 / 2N + 0.4 R(z)`` with x = z: noise N, the prior R a denoiser's.

    Six times, x minimises ``|A x - y|^2 + a |x - z|^2`` with ``a = 0.4 N / s^2``, and z is x
    denoised at the level s, which falls log-evenly from 0.1 (60 times the noise, where that is
    less) to the photo's noise. Noise below 0.001 is taken for that, the least that the network was
    trained on. Between the steps light below 0 is cut from z. The first x is the Wiener filter's.
    The scene outside a real border is unknown, and restored as well. Photo and PSF are first
    divided by the PSF's sum. Images are single precision.

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
        Takes images (C, H, W) and the standard deviations (C,) of their white noise; the trained
        one of :mod:`cep.restoration.denoiser` when omitted.
    border, border_rounds
        As :class:`cep.restoration.blur.Blur` and its method ``extend``.
    progress : callable, optional
        Called with the finished share, 0..1.

    Returns
    -------
    float ndarray like ``photo``
        At the scale of the full open exposure; a guess within the PSF's reach of a real border.

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
    check_noise(camera, noise_variance)
    if noise_variance == np.inf:  # the Wiener filter takes it for a photo without signal
        raise ValueError(f"noise_variance: must be 0 or more, got {noise_variance}")
    channels, kernel, duty = normalised(photo, psf)
    spectra = [
        _spectrum(channel, kernel, duty, camera=camera, noise_variance=noise_variance)
        for channel in channels
    ]
    return channels_last(
        _alternated(
            channels,
            Blur(kernel, channels.shape[1:], border, dtype=np.float32),
            noise=np.array([spectrum.noise for spectrum in spectra]),
            scene=np.array([spectrum.scene for spectrum in spectra]),
            denoiser=denoiser,
            border_rounds=border_rounds,
            progress=progress,
        )
    )


def pnp_together(
    photos: Sequence[ArrayLike],
    psfs: Sequence[ArrayLike],
    *,
    cameras: Sequence[Camera | None] | None = None,
    progress: Callable[[float], None] = lambda _share: None,
) -> FloatArray:
    """Restore one scene from several photos of it, each with its PSF: as :func:`pnp`, with the
    sum of ``|A_k x - y_k|^2 / 2 N_k`` for the data.

    What one photo's OTF loses another's may keep.

    Parameters
    ----------
    photos : sequence of K (H, W) or (H, W, 3) array_like, linear light
    psfs : sequence of K (S, S) array_like
        Light-true; a shift of a photo, and its brightness beyond that of its code, are the PSF's.
    cameras : sequence of K Camera or None, optional
        Of each photo: gives the variance of its noise, which is estimated where it is None.
    progress : callable, optional
        As for :func:`pnp`.

    Returns
    -------
    float ndarray like the first photo

    Raises
    ------
    ValueError
        If an argument is malformed, or their numbers or the photos' shapes differ.

    References
    ----------
    Agrawal, Xu and Raskar, "Invertible motion blur in video", SIGGRAPH 2009: several exposures
    whose joint transform has no null.
    """
    if len(photos) != len(psfs) or len({np.shape(photo) for photo in photos}) != 1:
        raise ValueError("photos: must be of one shape, with a PSF for each")
    normalised_photos = [normalised(*pair) for pair in zip(photos, psfs, strict=True)]
    spectra = [
        [_spectrum(channel, kernel, duty, camera=camera) for channel in channels]
        for (channels, kernel, duty), camera in zip(
            normalised_photos, cameras or [None] * len(photos), strict=True
        )
    ]
    N = np.array([[spectrum.noise for spectrum in of_photo] for of_photo in spectra])
    A = np.array([[spectrum.scene for spectrum in of_photo] for of_photo in spectra])
    # divided by their noise, all photos have the same: that of their weighted mean
    weights = np.sqrt((1 / N).sum(axis=1) / (1 / N).sum())
    frame = max(len(kernel) for _, kernel, _ in normalised_photos)
    channels = np.stack(
        [w * light for w, (light, _, _) in zip(weights, normalised_photos, strict=True)], axis=1
    )
    kernels = np.stack(
        [
            w * in_frame(psf, frame)
            for w, (_, psf, _) in zip(weights, normalised_photos, strict=True)
        ]
    )
    return channels_last(
        _alternated(
            channels,
            Blur(kernels, channels.shape[2:], dtype=np.float32),
            noise=1 / (1 / N).sum(axis=0),
            scene=weights**2 @ A,
            progress=progress,
        )
    )


def _spectrum(
    channel: FloatArray,
    kernel: FloatArray,
    duty: float,
    *,
    camera: Camera | None,
    noise_variance: float | None = None,
) -> Spectrum:
    """Spectra of scene and noise of a channel that was divided by its duty."""
    variance = noise_variance
    if camera is not None:
        variance = float(camera.noise_variance(duty * channel).mean())
    if variance is not None:
        variance /= duty**2
    spectrum = fit_spectrum(
        channel, Blur(kernel, channel.shape, "periodic"), noise_variance=variance
    )
    return replace(spectrum, noise=max(spectrum.noise, _SMALLEST_VARIANCE))


def _alternated(
    channels: FloatArray,
    blur: Blur,
    *,
    noise: FloatArray,
    scene: FloatArray,
    denoiser: Denoiser | None = None,
    border_rounds: int = 10,
    progress: Callable[[float], None],
) -> FloatArray:
    """Scene (C, H, W) of channels (C, H, W) or (C, K, H, W) with noise N and spectrum A, (C,)."""
    if denoiser is None:
        from cep.restoration.denoiser.network import load_denoiser

        denoiser = load_denoiser()
    ratio = noise / scene
    X = np.empty((len(channels), *blur.power.shape), np.complex64)
    for i, channel in enumerate(channels):
        extended = blur.extend(channel, noise_to_scene=ratio[i], rounds=border_rounds)
        # the first step has no z yet: the Wiener filter stands in
        power = blur.power + ratio[i] * power_law(blur.grid_shape)
        X[i] = blur.correlated(blur.spectrum(extended)) / np.maximum(power, SMALLEST_POWER)
    channels = channels.astype(blur.dtype)
    noise_sigma = np.sqrt(noise)
    first_sigma = np.maximum(np.minimum(FIRST_SIGMA, MOST_RATIO * noise_sigma), noise_sigma)
    first, *later = np.geomspace(first_sigma, noise_sigma, STEPS)
    z = denoiser(blur.image(X), first)
    for step, sigma in enumerate(later, 1):
        progress(step / STEPS)
        a = PRIOR * noise / sigma**2
        # light is not negative; what comes last is left as it is, as its dips tell of a wrong PSF
        x = np.maximum(z, 0)
        for i, channel in enumerate(channels):
            x[i] = blur.nearest(
                channel,
                x[i],
                float(a[i]),
                rounds=_MOST_ROUNDS,
                tolerance=float(_TOLERANCE * noise[i]),
            )
        z = denoiser(x, sigma)
    return blur.crop(z)
