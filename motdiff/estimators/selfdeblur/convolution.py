"""Blur with real borders, and how alike two photos are: what the fit compares, in torch."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.estimators.pmp.grids import fast_size

__all__ = ["SSIM_WINDOW_PX", "blurred_valid", "structural_similarity"]

SSIM_WINDOW_PX = 11
_SSIM_SIGMA_PX = 1.5
_C1, _C2 = 0.01**2, 0.03**2


def blurred_valid(sharp: Tensor, kernel: Tensor) -> Tensor:
    """Blur ``sharp`` (..., H, W) with ``kernel`` (R, C): true convolution, only where the whole light is known.

    Returns
    -------
    (..., H - R + 1, W - C + 1) tensor, as :func:`motdiff.simulate.blur_valid`.
    """
    rows, columns = sharp.shape[-2:]
    size = (fast_size(rows), fast_size(columns))  # wrap-around stays within what is cut away
    product = torch.fft.rfft2(sharp, s=size) * torch.fft.rfft2(kernel, s=size)
    full: Tensor = torch.fft.irfft2(product, s=size)
    return full[..., kernel.shape[0] - 1 : rows, kernel.shape[1] - 1 : columns]


def structural_similarity(a: Tensor, b: Tensor) -> Tensor:
    """Mean SSIM of two photos (H, W), 0..1, under a Gaussian window of 11 px, where the window is whole.

    References
    ----------
    Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment", IEEE TIP 2004.
    """
    at = torch.arange(SSIM_WINDOW_PX, device=a.device, dtype=a.dtype) - SSIM_WINDOW_PX // 2
    window = torch.exp(-at.square() / (2 * _SSIM_SIGMA_PX**2))
    window = window / window.sum()
    maps = torch.stack([a, b, a * a, b * b, a * b])[:, None]
    maps = functional.conv2d(functional.conv2d(maps, window.view(1, 1, 1, -1)), window.view(1, 1, -1, 1))
    mean_a, mean_b, square_a, square_b, product = maps[:, 0]
    variance = (square_a - mean_a.square()) + (square_b - mean_b.square())
    covariance = product - mean_a * mean_b
    likeness = (2 * mean_a * mean_b + _C1) * (2 * covariance + _C2)
    similarity: Tensor = likeness / ((mean_a.square() + mean_b.square() + _C1) * (variance + _C2))
    return similarity.mean()
