"""Training samples of the denoiser: crops of sharp photos in linear light, with white noise of
random level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from motdiff.training.photos import crops

SIGMAS = (1e-3, 0.3)
"""Least and largest standard deviation of the noise, full scale 1; log-evenly spread between."""

_LUMINANCE = (0.2126, 0.7152, 0.0722)
# share of the samples that are decoded to light; the others are code values, read as light
_DECODED = 0.7
_DISPLAY_GAMMA = 2.2
_LEAST_GAIN = 0.3


@dataclass(frozen=True)
class Batch:
    """Samples of one update: ``clean`` and ``noisy`` (B, 1, H, W), ``sigma`` (B,), all float32."""

    clean: Tensor
    noisy: Tensor
    sigma: Tensor


def draw(photos: Sequence[Tensor], step: int, *, count: int, side_px: int, seed: int) -> Batch:
    """Draw the samples of an update; they depend on the seed and the step alone.

    The noise is white in linear light, where the splitting has it. A sample is a photo's luminance
    or one of its colour channels, at any exposure from 0.3 to 1.

    Parameters
    ----------
    photos : sequence of (3, H, W) uint8 tensors, display values
    step : int
    count : int
    side_px : int
    seed : int

    Raises
    ------
    ValueError
        If a photo is smaller than the crops.
    """
    rng = np.random.default_rng([seed, step])
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    display = crops(photos, count=count, size=side_px, generator=generator)
    by_eye = rng.random((count, 1)) < 0.5
    mix = torch.from_numpy(
        np.where(by_eye, [_LUMINANCE], np.eye(3)[rng.integers(3, size=count)])
    ).float()
    grey = (display * mix[:, :, None, None]).sum(dim=1, keepdim=True)
    power = _column(np.where(rng.random(count) < _DECODED, _DISPLAY_GAMMA, 1.0))
    gain = _column(rng.uniform(_LEAST_GAIN, 1.0, count))
    clean = gain * grey**power
    low, high = (float(np.log(sigma)) for sigma in SIGMAS)
    sigma = _column(np.exp(rng.uniform(low, high, count)))
    noisy = clean + sigma * torch.randn(clean.shape, generator=generator)
    return Batch(clean, noisy, sigma.flatten())


def _column(values: NDArray[np.float64]) -> Tensor:
    return torch.from_numpy(values).float().view(-1, 1, 1, 1)
