"""Plug-and-play restoration: half-quadratic splitting with a trained denoiser for its prior."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.camera import Camera
from cep.restoration.blur import SMALLEST_POWER, Blur, Border, channels_last, normalised, power_law
from cep.restoration.noise import check_noise, fit_spectrum
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
    blur = Blur(kernel, channels.shape[1:], border, dtype=np.float32)
    if denoiser is None:
        from cep.restoration.denoiser.weights import load_denoiser

        denoiser = load_denoiser()
    frame = Blur(kernel, channels.shape[1:], "periodic")
    N = np.empty(len(channels))
    extended = np.empty((len(channels), *blur.grid_shape), blur.dtype)
    ratio = np.empty(len(channels))
    for i, channel in enumerate(channels):
        variance = noise_variance
        if camera is not None:
            variance = float(camera.noise_variance(duty * channel).mean())
        if variance is not None:
            variance /= duty**2  # the channel was divided by the duty
        spectrum = fit_spectrum(channel, frame, noise_variance=variance)
        N[i] = max(spectrum.noise, _SMALLEST_VARIANCE)
        ratio[i] = N[i] / spectrum.scene
        extended[i] = blur.extend(channel, noise_to_scene=ratio[i], rounds=border_rounds)
    channels = channels.astype(blur.dtype)
    # the first step has no z yet: the Wiener filter stands in
    power = np.abs(blur.H) ** 2 + ratio[:, None, None] * power_law(blur.grid_shape)
    X = np.conj(blur.H) * blur.spectrum(extended) / np.maximum(power, SMALLEST_POWER)
    noise_sigma = np.sqrt(N)
    first_sigma = np.maximum(np.minimum(FIRST_SIGMA, MOST_RATIO * noise_sigma), noise_sigma)
    first, *later = np.geomspace(first_sigma, noise_sigma, STEPS)
    z = denoiser(blur.image(X), first)
    for step, sigma in enumerate(later, 1):
        progress(step / STEPS)
        a = PRIOR * N / sigma**2
        # light is not negative; what comes last is left as it is, as its dips tell of a wrong PSF
        x = np.maximum(z, 0)
        for i, channel in enumerate(channels):
            x[i] = blur.nearest(
                channel,
                x[i],
                float(a[i]),
                rounds=_MOST_ROUNDS,
                tolerance=float(_TOLERANCE * N[i]),
            )
        z = denoiser(x, sigma)
    return channels_last(blur.crop(z))
