"""PSNR of denoised photos outside the training set."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from torch import Tensor

from motdiff.crops import luminance
from motdiff.metrics import psnr
from motdiff.simulate import to_linear
from motdiff.types import FloatArray


def denoising_gains(
    photos: Sequence[Tensor],
    denoise: Callable[[FloatArray, float], FloatArray],
    *,
    sigmas: Sequence[float] = (0.003, 0.01, 0.03, 0.1),
    seed: int = 0,
) -> tuple[tuple[float, float, float], ...]:
    """Noise level, mean PSNR before and mean PSNR after, dB, of photos' luminance in linear light.

    Parameters
    ----------
    photos : sequence of (3, H, W) uint8 tensors, display values
    denoise : callable
        Of :func:`cep.restoration.denoiser.weights.load_denoiser`.
    sigmas : sequence of float
    seed : int
    """
    scenes = [luminance(to_linear(photo.numpy().transpose(1, 2, 0) / 255)) for photo in photos]
    rows = []
    for sigma in sigmas:
        rng = np.random.default_rng(seed)
        noisy = [scene + sigma * rng.standard_normal(scene.shape) for scene in scenes]
        before = np.mean([psnr(image, scene) for image, scene in zip(noisy, scenes, strict=True)])
        after = np.mean(
            [
                psnr(denoise(image, sigma), scene)
                for image, scene in zip(noisy, scenes, strict=True)
            ]
        )
        rows.append((sigma, float(before), float(after)))
    return tuple(rows)
