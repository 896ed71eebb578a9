"""TV restoration: anisotropic total variation, by half-quadratic splitting."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cep.restoration.blur import Blur, Border, channels_last, gradient_power, normalised
from motdiff.types import FloatArray

_SMALLEST_BETA = 1e-3  # where the schedule of Wen et al. ends


def tv(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    weight: float = 1e-3,
    border: Border = "real",
    border_rounds: int = 10,
) -> FloatArray:
    """Minimise ``|A x - y|^2 + weight (|Dx x|_1 + |Dy x|_1)`` per channel.

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
    border, border_rounds
        As :class:`cep.restoration.blur.Blur` and its method ``extend``.

    Returns
    -------
    float ndarray like ``photo``
        At the scale of the full open exposure; a guess within the PSF's reach of a real border.

    References
    ----------
    Wang, Yang, Yin, Zhang, "A new alternating minimization algorithm for total variation image
    reconstruction", SIAM J. Imaging Sci. 2008; schedule of Wen, Ying, Liu, Liu, Truong, "A simple
    local minimal intensity prior and an improved algorithm for blind image deblurring", IEEE TCSVT
    2021.
    """
    check_weight(weight)
    channels, kernel, _ = normalised(photo, psf)
    blur = Blur(kernel, channels.shape[1:], border)
    gradients = gradient_power(blur.grid_shape)
    restored = np.empty_like(channels)
    for channel, out in zip(channels, restored, strict=True):
        image = blur.extend(channel, noise_to_scene=weight, rounds=border_rounds)
        data = blur.correlated(blur.spectrum(image))
        beta = 1 / weight
        while beta > _SMALLEST_BETA:
            gamma = 1 / (2 * beta)
            across, down = shrink_gradients(image, beta * weight)
            # x of the penalised problem: (A^T A + gamma D^T D) x = A^T y + gamma D^T W
            edges = blur.spectrum(divergence(across, down))
            image = blur.image((data + gamma * edges) / (blur.power + gamma * gradients))
            beta /= 2
        out[:] = blur.crop(image)
    return channels_last(restored)


def check_weight(weight: float) -> None:
    """Refuse a prior without a positive weight: the splitting divides by it."""
    if not (np.isfinite(weight) and weight > 0):
        raise ValueError(f"weight: must be above 0, got {weight}")


def forward_differences(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Periodic forward differences of (..., H, W), across and down."""
    return np.roll(image, -1, axis=-1) - image, np.roll(image, -1, axis=-2) - image


def shrink_gradients(image: FloatArray, threshold: float) -> tuple[FloatArray, FloatArray]:
    """Forward differences, shrunk towards 0 by soft thresholding: the W of :func:`tv`."""
    across, down = forward_differences(image)
    for difference in (across, down):
        difference -= np.clip(difference, -threshold, threshold)
    return across, down


def divergence(across: FloatArray, down: FloatArray) -> FloatArray:
    """Adjoint of the periodic forward differences: (..., H, W)."""
    return np.asarray(
        np.roll(across, 1, axis=-1) - across + np.roll(down, 1, axis=-2) - down, dtype=np.float64
    )


def gradient_sparsity(image: FloatArray) -> float:
    """L1 over L2 norm of the gradients, per root of their number; 0 of a flat image.

    Sharp edges lower it and ringing raises it.

    References
    ----------
    Krishnan, Tay, Fergus, "Blind deconvolution using a normalized sparsity measure", CVPR 2011.
    """
    gradients = np.concatenate([np.diff(image, axis=axis).ravel() for axis in (0, 1)])
    rms = float(np.sqrt(np.mean(gradients**2)))
    if rms == 0:
        return 0.0
    return float(np.mean(np.abs(gradients))) / rms
