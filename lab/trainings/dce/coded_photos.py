"""Coded photos as tensors, with a gradient by every chip."""

from __future__ import annotations

import torch
from torch import Tensor


def coded_photos(scenes: Tensor, chip_psfs: Tensor, chips: Tensor) -> Tensor:
    """Take light-true photos with real borders: the mean over all chips' frames, the closed ones
    dark.

    A frame is the scene shifted along the path, averaged over the time of its chip, so that
    blurring with the chip's PSF is the same as adding up shifted scenes.

    Parameters
    ----------
    scenes : (B, 1, H + S - 1, W + S - 1) float, linear light
    chip_psfs : (B, n, S, S) float
        Each chip's share of the PSF (:func:`cep.optics.exposure.chip_psfs`); those of a sample sum
        to 1.
    chips : (n,) float, 0..1
        How far each chip is open.

    Returns
    -------
    (B, 1, H, W) tensor
        Noise-free; a still scene is as bright as the open share of the chips.
    """
    psfs = torch.einsum("n,bnyx->byx", chips, chip_psfs)[:, None]
    rows, columns = psfs.shape[2:]
    size = scenes.shape[2:]
    # circular wrap-around stays within the rows and columns that are cut away
    blurred: Tensor = torch.fft.irfft2(
        torch.fft.rfft2(scenes) * torch.fft.rfft2(psfs, s=size), s=size
    )
    return blurred[..., rows - 1 :, columns - 1 :]
