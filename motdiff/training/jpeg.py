"""JPEG's loss, on any device: 8 x 8 cosine blocks, quantised with the standard's tables; no colour subsampling."""

from __future__ import annotations

import math

import torch
from torch import Tensor

__all__ = ["jpeg_loss"]

# ITU-T T.81 (JPEG), Annex K, table K.1: luminance
_TABLE = (
    (16, 11, 10, 16, 24, 40, 51, 61),
    (12, 12, 14, 19, 26, 58, 60, 55),
    (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62),
    (18, 22, 37, 56, 68, 109, 103, 77),
    (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101),
    (72, 92, 95, 98, 112, 100, 103, 99),
)


def jpeg_loss(photos: Tensor, quality: Tensor) -> Tensor:
    """Compress and decompress every channel with the luminance table.

    Parameters
    ----------
    photos : (B, C, H, W) float, display values 0..1; H and W multiples of 8
    quality : (B,) float, 1..100
        The quality of the Independent JPEG Group's library.

    Returns
    -------
    (B, C, H, W) float, 0..1, not rounded to 8 bits

    Raises
    ------
    ValueError
        If a side is no multiple of 8.
    """
    batch, channels, height, width = photos.shape
    if height % 8 or width % 8:
        raise ValueError(f"photos: sides must be multiples of 8, got {width} x {height}")
    cosine = _cosine_matrix(photos)
    table = torch.tensor(_TABLE, dtype=photos.dtype, device=photos.device)
    clamped = quality.clamp(1, 100)
    scale = torch.where(clamped < 50, 50 / clamped, 2 - clamped / 50)[:, None, None]
    steps = (table * scale + 0.5).floor().clamp(1, 255)[:, None, None, None]  # (B, 1, 1, 1, 8, 8)
    blocks = (255 * photos - 128).view(batch, channels, height // 8, 8, width // 8, 8).transpose(3, 4)
    spectrum = cosine @ blocks @ cosine.T
    restored = cosine.T @ ((spectrum / steps).round() * steps) @ cosine
    image = (restored.transpose(3, 4).reshape(batch, channels, height, width) + 128) / 255
    return image.clamp(0, 1)


def _cosine_matrix(like: Tensor) -> Tensor:
    """Orthonormal DCT-II, (8, 8)."""
    k = torch.arange(8, dtype=like.dtype, device=like.device)
    matrix = torch.cos(math.pi / 8 * k[:, None] * (k[None, :] + 0.5)) / 2
    matrix[0] /= math.sqrt(2)
    return matrix
