"""Losses of DCE between a restored and a sharp photo: Charbonnier, edges, and the Fourier
transform.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

_EPSILON = 1e-3
_EDGE_WEIGHT = 0.05
_SPECTRAL_WEIGHT = 0.01
_BINOMIAL = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)


def restoration_loss(restored: Tensor, sharp: Tensor) -> Tensor:
    """Charbonnier + 0.05 edges + 0.01 Fourier transform, (), of (B, 1, H, W) linear light.

    References
    ----------
    Zhang et al., "Deep coded exposure", Photonics Research 11(10), 1678, 2023: the weights.
    """
    return (
        charbonnier(restored, sharp)
        + _EDGE_WEIGHT * edge_loss(restored, sharp)
        + _SPECTRAL_WEIGHT * spectral_loss(restored, sharp)
    )


def charbonnier(restored: Tensor, sharp: Tensor) -> Tensor:
    """Mean of ``sqrt(d^2 + 1e-6)`` over the differences d: their mean modulus, smooth at 0."""
    return torch.sqrt((restored - sharp) ** 2 + _EPSILON**2).mean()


def edge_loss(restored: Tensor, sharp: Tensor) -> Tensor:
    """:func:`charbonnier` of the finest level of a Laplacian pyramid: photos minus their 5 x 5
    binomial blur.
    """
    return charbonnier(_fine(restored), _fine(sharp))


def spectral_loss(restored: Tensor, sharp: Tensor) -> Tensor:
    """Mean modulus of the difference's discrete Fourier transform, not normalised: it grows with
    the photo's side.
    """
    spectrum: Tensor = torch.fft.fft2(restored - sharp)
    return spectrum.abs().mean()


def _fine(image: Tensor) -> Tensor:
    line = torch.tensor(_BINOMIAL, dtype=image.dtype)
    channels = image.shape[1]
    padded = functional.pad(image, (2, 2, 2, 2), mode="replicate")
    smooth = functional.conv2d(
        padded, line.view(1, 1, 1, 5).repeat(channels, 1, 1, 1), groups=channels
    )
    return image - functional.conv2d(
        smooth, line.view(1, 1, 5, 1).repeat(channels, 1, 1, 1), groups=channels
    )
