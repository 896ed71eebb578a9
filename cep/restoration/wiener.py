"""Wiener filter: the least mean square error for a 1/f^2 scene under the camera's noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.camera import Camera
from cep.restoration.blur import (
    Blur,
    Border,
    channels_first,
    channels_last,
    power_law,
    trimmed_psf,
)
from cep.restoration.noise import check_noise, fit_spectrum
from motdiff.types import ComplexArray, FloatArray


def wiener(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    camera: Camera | None = None,
    noise_variance: float | None = None,
    scene_strength: float | None = None,
    border: Border = "real",
    border_rounds: int = 10,
) -> FloatArray:
    """Restore with ``conj(H) / (|H|^2 + N f^2 / A)``: noise N and scene spectrum A / f^2.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light
    psf : (S, S) array_like
        Light-true PSF, zero displacement at index ``size // 2``.
    camera : Camera, optional
        Gives N: the mean of its noise variance over the photo. Without it, and without
        ``noise_variance``, N is estimated from the photo's spectrum.
    noise_variance : float, optional
        N itself, in full-scale units squared per pixel; 0 makes it the inverse filter.
    scene_strength : float, optional
        A at full exposure, f in cy/px. Estimated from the photo's spectrum when omitted.
    border : {"real", "periodic"}
        Whether light came in from outside the frame, or the photo is one period of a scene.
    border_rounds : int
        Rounds of reblurring outside a real border, see :meth:`cep.restoration.blur.Blur.extend`.

    Returns
    -------
    float ndarray like ``photo``
        At the scale of the full open exposure; the mean light is exact. Within the PSF's reach of
        a real border the result leans on a guess of the scene outside.

    Raises
    ------
    ValueError
        If an argument is malformed, or both ``camera`` and ``noise_variance`` are given.

    References
    ----------
    Field, "Relations between the statistics of natural images", JOSA A 1987: the 1/f^2 spectrum.
    """
    check_noise(camera, noise_variance)
    if scene_strength is not None and not (np.isfinite(scene_strength) and scene_strength > 0):
        raise ValueError(f"scene_strength: must be above 0, got {scene_strength}")
    channels = channels_first(photo)
    blur = Blur(trimmed_psf(psf), channels.shape[1:], border)
    restored = np.empty_like(channels)
    for channel, out in zip(channels, restored, strict=True):
        N = noise_variance
        if camera is not None:
            N = float(camera.noise_variance(channel).mean())
        ratio = _noise_to_scene(channel, blur.psf, N, scene_strength)
        # an infinite ratio would leave no scene to reblur
        extended = blur.extend(channel, noise_to_scene=min(ratio, 1e6), rounds=border_rounds)
        out[:] = blur.crop(blur.image(blur.spectrum(extended) * _wiener_gain(blur, ratio)))
    return channels_last(restored)


def _noise_to_scene(
    channel: FloatArray, psf: FloatArray, N: float | None, A: float | None
) -> float:
    if N == 0.0:
        return 0.0
    if N is not None and (A is not None or not np.isfinite(N)):
        return N / (A or 1.0)
    # Hann windowed, the periodogram needs no real border
    spectrum = fit_spectrum(channel, Blur(psf, channel.shape, "periodic"), noise_variance=N)
    return spectrum.noise / (A or spectrum.scene)


def _wiener_gain(blur: Blur, ratio: float) -> ComplexArray:
    f2 = power_law(blur.grid_shape)
    # nothing is added at f = 0, also where the ratio is infinite: the mean light stays exact
    penalty = np.multiply(ratio, f2, out=np.zeros_like(f2), where=f2 > 0)
    divisor = blur.power + penalty
    # frequencies without signal are left out
    alive = divisor > np.finfo(float).tiny
    inverse = np.divide(1.0, divisor, out=np.zeros_like(divisor), where=alive)
    return np.asarray(np.conj(blur.H) * inverse, dtype=np.complex128)
