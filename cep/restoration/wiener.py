"""Wiener filter: the least mean square error for a 1/f^2 scene under the camera's noise."""

from __future__ import annotations

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
    r"""Restore with ``conj(H) / (|H|^2 + N f^2 / A)``, noise variance N and scene spectrum A /
    f^2.

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
        Whether light came in from outside the frame, or the photo is one period of a periodic
        scene.
    border_rounds : int
        Rounds of reblurring outside a real border.

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
    if camera is not None and noise_variance is not None:
        raise ValueError("noise_variance: give either a camera or the variance, not both")
    if noise_variance is not None and not noise_variance >= 0:
        raise ValueError(f"noise_variance: must be 0 or more, got {noise_variance}")
    if scene_strength is not None and not (np.isfinite(scene_strength) and scene_strength > 0):
        raise ValueError(f"scene_strength: must be above 0, got {scene_strength}")
    channels = channels_first(photo)
    kernel = trimmed_psf(psf)
    size = (channels.shape[1], channels.shape[2])
    shape = working_shape(size, kernel.shape[0], border)
    transfer = otf_on_grid(kernel, shape)
    restored = np.empty_like(channels)
    for channel, out in zip(channels, restored, strict=True):
        noise = (
            float(camera.noise_variance(channel).mean()) if camera is not None else noise_variance
        )
        ratio = _noise_to_scene(channel, kernel, noise, scene_strength)
        extended = channel
        if border == "real":
            # an infinite ratio would leave no scene to reblur
            reblur_ratio = min(ratio, 1e6)
            extended = reblurred_extension(
                channel, kernel, shape, noise_to_scene=reblur_ratio, rounds=border_rounds
            )
        gain = _wiener_gain(transfer, ratio, power_law(shape))
        out[:] = fft.irfft2(fft.rfft2(extended) * gain, shape)[: size[0], : size[1]]
    return channels_last(restored)


def _noise_to_scene(
    channel: FloatArray, kernel: FloatArray, noise: float | None, scene: float | None
) -> float:
    if noise == 0.0:
        return 0.0
    if noise is not None and (scene is not None or not np.isfinite(noise)):
        return noise / (scene or 1.0)
    found = fit_spectrum(channel, kernel, noise_variance=noise)
    return found.noise / (scene or found.scene)


def _wiener_gain(
    transfer: NDArray[np.complex128], ratio: float, law: FloatArray
) -> NDArray[np.complex128]:
    """Wiener filter on the grid; zero frequency is divided by H alone, so that the mean light is
    exact.
    """
    penalty = np.multiply(ratio, law, out=np.zeros_like(law), where=law > 0)
    divisor = np.abs(transfer) ** 2 + penalty
    blind = divisor <= np.finfo(float).tiny
    return np.asarray(
        np.conj(transfer) * np.where(blind, 0.0, 1 / np.where(blind, 1.0, divisor)),
        dtype=np.complex128,
    )
