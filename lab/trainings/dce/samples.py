"""Training samples: crops of sharp photos with the frames that a random motion makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from cep.optics.exposure import chip_psfs
from motdiff.photo_values import to_linear
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import valid_window
from motdiff.training.motion_bank import MotionMix, draw_motion, mix_trace
from motdiff.training.photos import crops

SIGMA_MAX = 0.02
"""Largest standard deviation of the noise, full scale 1."""


@dataclass(frozen=True)
class Batch:
    """Samples of one update.

    Attributes
    ----------
    scenes : (B, 1, H + 63, W + 63) float, linear light
    sharp : (B, 1, H, W) float
        The part of the scenes that the photos show.
    chip_psfs : (B, n, 64, 64) float
    noise : (B, 1, H, W) float
        To be added to the coded photo, whatever its code.
    """

    scenes: Tensor
    sharp: Tensor
    chip_psfs: Tensor
    noise: Tensor


def motion_mix(gyro: Path | None) -> MotionMix:
    """Motions of the training: half of them random walks as in the MoTDiff paper, at full length
    and shorter.

    Parameters
    ----------
    gyro : path, optional
        A gyroscope recording (:func:`motdiff.files.gyro_tables.read_gyro`); without one there is
        no hand shake among them.
    """
    shake = {} if gyro is None else {"gyro": 0.25, "gyro_trace": str(gyro)}
    return MotionMix(boracchi_foi=0.25, boracchi_foi_short=0.25, straight=0.25, **shake)  # type: ignore[arg-type]


class Samples:
    """Batches of random samples; one depends on the seed and its step alone.

    Parameters
    ----------
    photos : sequence of (3, H, W) uint8 tensors, display values
    mix : MotionMix
    chips : int
        Number of chips n.
    crop_px : int
        Side of the photos.
    seed : int
    """

    def __init__(
        self, photos: Sequence[Tensor], mix: MotionMix, *, chips: int, crop_px: int, seed: int
    ) -> None:
        self._photos = photos
        self._mix = mix
        self._chips = chips
        self._crop_px = crop_px
        self._seed = seed
        self._trace = mix_trace(mix)

    def batch(self, step: int, size: int) -> Batch:
        """Draw the ``size`` samples of an update; each takes one colour channel at random."""
        rng = np.random.default_rng([self._seed, step])
        generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
        side = self._crop_px + PSF_PX - 1
        display = crops(self._photos, count=size, size=side, generator=generator)
        channel = torch.from_numpy(rng.integers(3, size=size))
        scenes = torch.from_numpy(
            to_linear(display[torch.arange(size), channel, None].numpy())
        ).float()
        motions = [draw_motion(self._mix, rng, self._trace) for _ in range(size)]
        psfs = np.stack([chip_psfs(motion, self._chips, PSF_PX) for motion in motions])
        rows, columns = valid_window((side, side), (PSF_PX, PSF_PX))
        sigma = torch.rand(size, 1, 1, 1, generator=generator) * SIGMA_MAX
        noise = sigma * torch.randn(size, 1, self._crop_px, self._crop_px, generator=generator)
        return Batch(scenes, scenes[..., rows, columns], torch.from_numpy(psfs).float(), noise)
