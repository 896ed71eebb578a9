"""Training samples: a simulated photo, its classical kernels, the motion registered to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.blind_search.grids import shifted
from motdiff.network.condition import PHOTO_PX
from motdiff.network.physics_maps import quick_kernels
from motdiff.psf_frame import MAP_PITCH, PSF_PX
from motdiff.training.motion_bank import MotionBank
from motdiff.training.photos import crops
from motdiff.training.simulation import Photography, photographed

_KERNEL_BATCH = 8  # on a CPU larger ones fall out of the cache
_MAX_SHIFT = 32  # HR-map pixels, 8 px of the photo
_MIN_CORRELATION = 0.6  # below, the kernel is wrong and gives no position of the path


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
    """Take one photo per motion ``index`` (B,) of the bank, each of a scene drawn at random.

    The scenes, sharp photos (3, H, W) uint8, and the index are on the bank's device. ``physics``
    adds the quick classical searches and registers the motions to their kernels. Everything random
    follows from the seed.
    """
    device = index.device
    on_cpu = torch.Generator().manual_seed(seed)
    on_device = torch.Generator(device).manual_seed(seed)
    psfs, x0, dwell = bank.targets(index)
    side_px = PHOTO_PX + photography.margin
    sharp = crops(scenes, count=len(index), size=side_px, generator=on_cpu)
    photos, sigma = photographed(sharp, psfs, photography=photography, generator=on_device)
    kernels = photos.new_zeros(len(index), 0, PSF_PX, PSF_PX)
    if physics:
        grey = photos.mean(dim=1, keepdim=True)
        size = {"cpu": _KERNEL_BATCH}.get(device.type, len(index))
        batches = zip(torch.split(grey, size), torch.split(sigma, size), strict=True)
        kernels = torch.cat([quick_kernels(g, sigma=float(s.median())) for g, s in batches])
        shift = registration(kernels, dwell)
        x0 = shifted(x0, shift)
        dwell = shifted(dwell, shift)
    return Samples(photos, kernels, x0, dwell)


def registration(kernels: Tensor, dwell: Tensor) -> Tensor:
    """Shift of the motion onto the kernel that correlates best with it.

    A photo does not determine the position of the path, so a classical kernel is a pixel or two
    off the truth, which pixel-wise losses would penalise.

    Of kernels (B, K, 64, 64) and HR maps weighted by time, (B, 1, 256, 256), it is (B, 2) int64,
    HR-map pixels down and right; 0 where every kernel is wrong.
    """
    fine = functional.interpolate(kernels, scale_factor=MAP_PITCH, mode="nearest")
    # both smoothed alike, so that a thin path and a blocky kernel overlap
    fine = functional.avg_pool2d(fine, 5, 1, 2)
    truth = functional.avg_pool2d(functional.avg_pool2d(dwell, 3, 1, 1), 5, 1, 2)
    spectrum = torch.fft.rfft2(fine) * torch.fft.rfft2(truth).conj()
    lags = torch.fft.irfft2(spectrum, s=fine.shape[-2:]).roll((_MAX_SHIFT, _MAX_SHIFT), (-2, -1))
    side = 2 * _MAX_SHIFT + 1
    lags = lags[..., :side, :side]
    norms = fine.square().sum(dim=(-2, -1)).sqrt() * truth.square().sum(dim=(-2, -1)).sqrt()
    peak, at = (lags / norms[..., None, None].clamp(min=1e-12)).flatten(1).max(dim=1)
    at = at % (side * side)  # the kernel's own number does not matter
    shift = torch.stack([at // side, at % side], dim=1) - _MAX_SHIFT
    return torch.where(peak[:, None] >= _MIN_CORRELATION, shift, torch.zeros_like(shift))
