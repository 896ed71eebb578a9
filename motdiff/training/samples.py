"""Training samples: a simulated photo, its quick classical kernels, and the motion registered to
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.network.condition import PHOTO_PX
from motdiff.network.physics_maps import quick_kernels
from motdiff.psf_frame import MAP_PITCH, PSF_PX
from motdiff.training.motion_bank import MotionBank
from motdiff.training.photos import crops
from motdiff.training.simulation import Photography, photographed

_KERNEL_BATCH = 8  # on a CPU larger ones fall out of the cache
_REACH_MAP_PX = 32
_ALIKE = 0.6  # below, the kernel is wrong and gives no position of the path


@dataclass(frozen=True)
class Samples:
    """A batch of samples.

    Attributes
    ----------
    photos : (B, 3, 256, 256) float32, 0..1, light as decoded
    kernels : (B, K, 64, 64) float32
        Quick classical kernels; K = 0 when physics is not asked for.
    x0 : (B, 1, 256, 256) float32, 0 or 1
        HR maps of the true motions.
    dwell : (B, 1, 256, 256) float32
        Relative time per path pixel.
    """

    photos: Tensor
    kernels: Tensor
    x0: Tensor
    dwell: Tensor

    def __len__(self) -> int:
        return len(self.photos)


def simulate(
    bank: MotionBank,
    scenes: Sequence[Tensor],
    index: Tensor,
    *,
    photography: Photography,
    physics: bool,
    seed: int,
) -> Samples:
    """Take one photo per motion of the bank, each of a scene drawn at random.

    Parameters
    ----------
    bank : MotionBank
    scenes : sequence of (3, H, W) uint8
        Sharp photos on the bank's device.
    index : (B,) int64
        Motions to use, on the bank's device.
    photography : Photography
    physics : bool
        Whether to run the quick classical searches and to register the motions to their kernels.
    seed : int
        Everything random follows from it.
    """
    device = index.device
    on_cpu = torch.Generator().manual_seed(seed)
    on_device = torch.Generator(device).manual_seed(seed)
    psfs, x0, dwell = bank.targets(index)
    size = PHOTO_PX + photography.margin
    sharp = crops(scenes, count=len(index), size=size, generator=on_cpu)
    photos, sigma = photographed(sharp, psfs, photography=photography, generator=on_device)
    kernels = photos.new_zeros(len(index), 0, PSF_PX, PSF_PX)
    if physics:
        grey = photos.mean(dim=1, keepdim=True)
        step = _KERNEL_BATCH if device.type == "cpu" else len(index)
        parts = [
            quick_kernels(grey[i : i + step], sigma=float(sigma[i : i + step].median()))
            for i in range(0, len(index), step)
        ]
        kernels = torch.cat(parts)
        move = registration(kernels, dwell)
        x0 = shifted(x0, move)
        dwell = shifted(dwell, move)
    return Samples(photos, kernels, x0, dwell)


def registration(kernels: Tensor, dwell: Tensor) -> Tensor:
    """Shift of the motion that lays it on the most alike of its kernels.

    A photo does not determine the position of the path, so a classical kernel is a pixel or two
    off the truth, which pixel-wise losses would penalise.

    Parameters
    ----------
    kernels : (B, K, 64, 64) float
    dwell : (B, 1, 256, 256) float
        HR maps weighted by time.

    Returns
    -------
    (B, 2) int64, HR-map pixels down and right; 0 where every kernel is lost
    """
    if kernels.shape[1] == 0:
        return torch.zeros(len(dwell), 2, dtype=torch.int64, device=dwell.device)
    fine = functional.interpolate(kernels, scale_factor=MAP_PITCH, mode="nearest")
    fine = functional.avg_pool2d(fine, 5, 1, 2)
    truth = functional.avg_pool2d(functional.avg_pool2d(dwell, 3, 1, 1), 5, 1, 2)
    spectrum = torch.fft.rfft2(fine) * torch.fft.rfft2(truth).conj()
    reach = _REACH_MAP_PX
    lags = torch.fft.irfft2(spectrum, s=fine.shape[-2:]).roll((reach, reach), (-2, -1))
    lags = lags[..., : 2 * reach + 1, : 2 * reach + 1]
    norms = fine.square().sum(dim=(-2, -1)).sqrt() * truth.square().sum(dim=(-2, -1)).sqrt()
    alike, where = (lags / norms[..., None, None].clamp(min=1e-12)).flatten(1).max(dim=1)
    side = 2 * reach + 1
    where = where % (side * side)
    move = torch.stack([where // side, where % side], dim=1) - reach
    return torch.where(alike[:, None] >= _ALIKE, move, torch.zeros_like(move))


def shifted(maps: Tensor, move: Tensor) -> Tensor:
    """Move each map (B, C, H, W) by whole pixels (B, 2), down and right; pixels that leave the
    frame are lost.
    """
    batch, channels, height, width = maps.shape
    row = torch.arange(height, device=maps.device)[None, :] - move[:, :1]
    column = torch.arange(width, device=maps.device)[None, :] - move[:, 1:]
    inside = ((row >= 0) & (row < height))[:, None, :, None] & ((column >= 0) & (column < width))[
        :, None, None, :
    ]
    rows = row.clamp(0, height - 1)[:, None, :, None].expand(batch, channels, height, width)
    columns = column.clamp(0, width - 1)[:, None, None, :].expand(batch, channels, height, width)
    moved: Tensor = maps.gather(2, rows).gather(3, columns) * inside
    return moved
