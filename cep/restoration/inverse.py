"""Inverse filter with a floor under the MTF."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from cep.restoration.borders import Border, reblurred_extension, working_shape
from cep.restoration.spectral import channels_first, channels_last, otf_on_grid, trimmed_psf
from motdiff.types import FloatArray


def inverse_filter(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    floor: float = 0.05,
    border: Border = "real",
    border_rounds: int = 10,
) -> FloatArray:
    """Divide the photo's spectrum by the OTF, whose modulus is raised to a floor where it falls
    below.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light
    psf : (S, S) array_like
        Light-true PSF, zero displacement at index ``size // 2``.
    floor : float
        Least |H| divided by, as a fraction of the DC value (the PSF's sum). 0 divides by
        everything but exact zeros.
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
        If an argument is malformed.
    """
    if not 0 <= floor < 1:
        raise ValueError(f"floor: must lie within 0..1, got {floor}")
    channels = channels_first(photo)
    kernel = trimmed_psf(psf)
    size = (channels.shape[1], channels.shape[2])
    shape = working_shape(size, kernel.shape[0], border)
    transfer = otf_on_grid(kernel, shape)
    modulus = np.abs(transfer)
    least = floor * kernel.sum()
    divisor = modulus * np.maximum(modulus, least)
    blind = divisor <= np.finfo(float).tiny
    gain = np.where(blind, 0.0, np.conj(transfer) / np.where(blind, 1.0, divisor))
    restored = np.empty_like(channels)
    for channel, out in zip(channels, restored, strict=True):
        extended = reblurred_extension(
            channel, kernel, shape, noise_to_scene=least**2, rounds=border_rounds
        )
        out[:] = fft.irfft2(fft.rfft2(extended) * gain, shape)[: size[0], : size[1]]
    return channels_last(restored)
