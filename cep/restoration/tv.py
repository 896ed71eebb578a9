"""TV restoration: anisotropic total variation, by half-quadratic splitting."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from cep.restoration.borders import Border, reblurred_extension, working_shape
from cep.restoration.spectral import (
    channels_first,
    channels_last,
    gradient_power,
    otf_on_grid,
    trimmed_psf,
)
from motdiff.types import FloatArray

_SMALLEST_BETA = 1e-3


def tv(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    weight: float = 1e-3,
    border: Border = "real",
    border_rounds: int = 10,
) -> FloatArray:
    """Minimise ``|K x - y|^2 + weight (|Dx x|_1 + |Dy x|_1)`` per channel.

    The gradients are split off as W with the penalty ``gamma |D x - W|^2``, gamma = 1 / (2 beta);
    beta falls from 1 / weight to 1e-3 by halves (20 iterations at the default weight). Photo and
    PSF are first divided by the PSF's sum, so ``weight`` means the same for dark coded photos.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light
    psf : (S, S) array_like
        Light-true PSF, zero displacement at index ``size // 2``.
    weight : float
        Strength of the prior, of the order of the noise: 1e-4 (clean) to 1e-2.
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

    References
    ----------
    Wang, Yang, Yin, Zhang, "A new alternating minimization algorithm for total variation image
    reconstruction", SIAM J. Imaging Sci. 2008; schedule of Wen, Ying, Liu, Liu, Truong, "A simple
    local minimal intensity prior and an improved algorithm for blind image deblurring", IEEE TCSVT
    2021.
    """
    if not (np.isfinite(weight) and weight > 0):
        raise ValueError(f"weight: must be above 0, got {weight}")
    channels = channels_first(photo)
    kernel = trimmed_psf(psf)
    channels = channels / kernel.sum()
    kernel = kernel / kernel.sum()
    size = (channels.shape[1], channels.shape[2])
    shape = working_shape(size, kernel.shape[0], border)
    transfer = otf_on_grid(kernel, shape)
    gradients = gradient_power(shape)
    power = np.abs(transfer) ** 2
    restored = np.empty_like(channels)
    for channel, out in zip(channels, restored, strict=True):
        start = reblurred_extension(
            channel, kernel, shape, noise_to_scene=weight, rounds=border_rounds
        )
        data = np.conj(transfer) * fft.rfft2(start)
        image = start
        beta = 1 / weight
        while beta > _SMALLEST_BETA:
            gamma = 1 / (2 * beta)
            across, down = shrink_gradients(image, beta * weight)
            image = fft.irfft2(
                (data + gamma * fft.rfft2(divergence(across, down))) / (power + gamma * gradients),
                shape,
            )
            beta /= 2
        out[:] = image[: size[0], : size[1]]
    return channels_last(restored)


def shrink_gradients(image: FloatArray, threshold: float) -> tuple[FloatArray, FloatArray]:
    """Periodic forward differences of (..., H, W), across and down, drawn towards 0 by
    ``threshold``.
    """
    across = np.roll(image, -1, axis=-1) - image
    down = np.roll(image, -1, axis=-2) - image
    for difference in (across, down):
        difference -= np.clip(difference, -threshold, threshold)
    return across, down


def divergence(across: FloatArray, down: FloatArray) -> FloatArray:
    """Adjoint of the periodic forward differences: (..., H, W)."""
    return np.asarray(
        np.roll(across, 1, axis=-1) - across + np.roll(down, 1, axis=-2) - down, dtype=np.float64
    )
