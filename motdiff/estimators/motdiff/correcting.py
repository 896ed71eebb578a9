"""Correction of kernels on crops of a photo: arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from motdiff.network.correction import CorrectionNetwork, corrected, correction_maps
from motdiff.psf_frame import in_frame

__all__ = ["corrected_kernel"]

FloatArray = NDArray[np.float64]

_PASSES = 2  # what the photo tells of a corrected kernel is more


def corrected_kernel(
    network: CorrectionNetwork,
    crops: FloatArray,
    kernel: FloatArray,
    others: Sequence[FloatArray],
    *,
    sigma: float,
) -> FloatArray:
    """Correct a kernel twice by what crops of its photo tell of it.

    Parameters
    ----------
    network : CorrectionNetwork
        In eval mode, on the CPU.
    crops : (C, H, W) float, grey, linear light
    kernel : (k, k) float, sum 1
    others : sequence of one or two (k', k') float, sum 1
        Kernels that the photo might have instead; their frames may differ.
    sigma : float
        Standard deviation of the noise.

    Returns
    -------
    (64, 64) float: non-negative, sum 1.
    """
    light = torch.from_numpy(crops.astype(np.float32))
    framed = torch.from_numpy(np.stack([_framed(each) for each in (kernel, *others)]))
    found, instead = framed[:1], framed[[1, -1]][None]
    with torch.inference_mode():
        for _ in range(_PASSES):
            found = corrected(network, correction_maps(light, found, instead, sigma=sigma))
    return np.asarray(found[0].double().numpy(), dtype=np.float64)


def _framed(kernel: FloatArray) -> NDArray[np.float32]:
    cut = in_frame(kernel)
    return np.asarray(cut / max(float(cut.sum()), 1e-12), dtype=np.float32)
