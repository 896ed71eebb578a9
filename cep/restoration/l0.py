"""L0-gradient restoration, and TV restoration less the ringing that L0 does not share."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from cep.restoration.blur import Blur, Border, channels_last, gradient_power, normalised
from cep.restoration.tv import check_weight, divergence, forward_differences, tv
from motdiff.types import FloatArray

_LARGEST_BETA = 1e5  # of Xu et al.


def l0(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    weight: float = 2e-3,
    border: Border = "real",
    border_rounds: int = 10,
) -> FloatArray:
    """Minimise ``|A x - y|^2 + weight (pixels with a gradient)``; channels share their edges.

    Gradients are split off with a penalty beta that doubles from ``2 weight`` to 1e5; a pixel's
    gradient is kept where its square, summed over channels, is at least ``weight / beta``. The
    result is piecewise flat.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light
    psf : (S, S) array_like
        Light-true PSF, zero displacement at index ``size // 2``.
    weight : float
        Typically 1e-4..2e-3.
    border, border_rounds
        As :class:`cep.restoration.blur.Blur` and its method ``extend``.

    Returns
    -------
    float ndarray like ``photo``
        At the scale of the full open exposure; a guess within the PSF's reach of a real border.

    References
    ----------
    Xu, Zheng, Jia, "Unnatural L0 sparse representation for natural image deblurring", CVPR 2013.
    """
    check_weight(weight)
    channels, kernel, _ = normalised(photo, psf)
    blur = Blur(kernel, channels.shape[1:], border)
    gradients = gradient_power(blur.grid_shape)
    image = np.stack(
        [blur.extend(channel, noise_to_scene=weight, rounds=border_rounds) for channel in channels]
    )
    data = blur.correlated(blur.spectrum(image))
    beta = 2 * weight
    while beta < _LARGEST_BETA:
        across, down = forward_differences(image)
        flat = (across**2 + down**2).sum(axis=0) < weight / beta
        across[:, flat] = 0
        down[:, flat] = 0
        edges = blur.spectrum(divergence(across, down))
        image = blur.image((data + beta * edges) / (blur.power + beta * gradients))
        beta *= 2
    return channels_last(np.ascontiguousarray(blur.crop(image)))


def tv_less_ringing(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    weight: float = 1e-3,
    weight_l0: float = 2e-4,
    weight_ring: float = 1.0,
    border: Border = "real",
    border_rounds: int = 10,
) -> FloatArray:
    """TV restoration minus its ringing: the smooth part of its difference from the L0 restoration.

    Parameters
    ----------
    photo, psf, weight, border, border_rounds
        As :func:`cep.restoration.tv.tv`.
    weight_l0 : float
        Strength of the L0 prior.
    weight_ring : float
        Share of the ringing taken out, 0..1.

    Returns
    -------
    float ndarray like ``photo``

    References
    ----------
    Pan, Hu, Su, Yang, "Deblurring text images via L0-regularized intensity and gradient prior",
    CVPR 2014, section 5.
    """
    if not 0 <= weight_ring <= 1:
        raise ValueError(f"weight_ring: must lie within 0..1, got {weight_ring}")
    smooth = tv(photo, psf, weight=weight, border=border, border_rounds=border_rounds)
    difference = smooth - l0(
        photo, psf, weight=weight_l0, border=border, border_rounds=border_rounds
    )
    # smooth but for edges: texture that only TV restores stays in the result
    ringing = cv2.bilateralFilter(
        difference.astype(np.float32), d=19, sigmaColor=0.1, sigmaSpace=3.0
    )
    return np.asarray(smooth - weight_ring * ringing, dtype=np.float64)
