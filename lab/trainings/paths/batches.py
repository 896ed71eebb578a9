"""Batches of a training: searched photos, and clean motions whose kernels have faults drawn on."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from lab.trainings.paths.network import rendered
from lab.trainings.paths.samples import LEAST_ALIKE, PathSamples, forward_in_time, turned
from motdiff.blind_search.grids import SYMMETRIES
from motdiff.psf_frame import PSF_PX

_ABSENT_MAPS = 0.15  # share of the second to fourth maps that are left out
_SWAPPED = 0.3  # share of photos whose kernels change places


class Batches:
    """Maps and points of searched photos and of clean motions, turned and mirrored.

    Parameters
    ----------
    samples : PathSamples
        On the device.
    motions : (M, 64, 2) float
        Points of the clean motions, on the device.
    generator : torch.Generator
    """

    def __init__(
        self, samples: PathSamples, motions: Tensor, *, generator: torch.Generator
    ) -> None:
        self._index = torch.nonzero(samples.alike > LEAST_ALIKE)[:, 0]
        if not len(self._index):
            raise ValueError("samples: every photo is lost; prepare more shards")
        self._samples = samples
        self._motions = motions
        self._generator = generator

    def batch(self, count: int, clean: float) -> tuple[Tensor, Tensor]:
        """Draw maps (count, 4, 64, 64) and points (count, 64, 2), a share of them clean."""
        faulty = round(clean * count) if len(self._motions) else 0
        index = self._index[self._whole(len(self._index), count - faulty)]
        maps = self._samples.maps[index].float() / 127
        points = self._samples.points[index]
        if faulty:
            motions = self._motions[self._whole(len(self._motions), faulty)]
            maps = torch.cat([maps, self._with_faults(rendered(motions))])
            points = torch.cat([points, motions])
        order = torch.randperm(count, generator=self._generator, device=maps.device)
        maps, points = self._disturbed(maps[order]), points[order]
        groups = [
            turned(some_maps, some_points, symmetry)
            for symmetry, (some_maps, some_points) in enumerate(
                zip(maps.tensor_split(SYMMETRIES), points.tensor_split(SYMMETRIES), strict=True)
            )
        ]
        maps, points = (torch.cat(parts) for parts in zip(*groups, strict=True))
        return maps, forward_in_time(points)

    def _whole(self, limit: int, count: int) -> Tensor:
        device = self._generator.device
        return torch.randint(limit, (count,), generator=self._generator, device=device)

    def _uniform(self, *shape: int) -> Tensor:
        return torch.rand(shape, generator=self._generator, device=self._generator.device)

    def _smooth(self, count: int, side: int) -> Tensor:
        """Draw normal noise (count, 1, 64, 64), as smooth as a grid of so many pixels a side."""
        shape = (count, 1, side, side)
        noise = torch.randn(shape, generator=self._generator, device=self._generator.device)
        return functional.interpolate(noise, size=(PSF_PX, PSF_PX), mode="bicubic")

    def _with_faults(self, psfs: Tensor) -> Tensor:
        """Make maps of kernels with a search's faults: uneven, blurred, cut, with specks."""
        count = len(psfs)
        peak = psfs.amax(dim=(1, 2)).clamp(min=1e-9)
        psfs = psfs[:, None] / peak[:, None, None, None]
        maps = []
        for _ in range(3):
            uneven = 1 + 0.5 * self._uniform(count, 1, 1, 1) * self._smooth(count, 16)
            kernel = psfs * uneven.clamp(min=0)
            softness = 0.6 * self._uniform(count, 1, 1, 1)
            kernel = torch.lerp(kernel, functional.avg_pool2d(kernel, 3, 1, 1), softness)
            specks = self._smooth(count, 32).clamp(min=0)
            kernel = kernel + 0.1 * self._uniform(count, 1, 1, 1).square() * specks
            kernel = kernel / kernel.amax(dim=(2, 3), keepdim=True).clamp(min=1e-9)
            faint = 0.02 + 0.15 * self._uniform(count, 1, 1, 1)
            maps.append(torch.where(kernel > faint, kernel, 0).clamp(min=0).sqrt())
        least_squares = psfs + 0.15 * self._uniform(count, 1, 1, 1) * self._smooth(count, 32)
        rough = 0.1 * self._uniform(count, 1, 1, 1) * self._smooth(count, PSF_PX)
        least_squares = least_squares + rough
        largest = least_squares.abs().amax(dim=(2, 3), keepdim=True).clamp(min=1e-9)
        maps.append(least_squares.sign() * (least_squares.abs() / largest).sqrt())
        return torch.cat(maps, dim=1)

    def _disturbed(self, maps: Tensor) -> Tensor:
        """Change places of kernels, leave some maps out, and add noise: 9,000 photos are few."""
        count = len(maps)
        swapped = self._uniform(count, 1, 1, 1) < _SWAPPED
        maps = torch.where(swapped, maps[:, [1, 2, 0, 3]], maps)
        absent = self._uniform(count, maps.shape[1], 1, 1) < _ABSENT_MAPS
        absent[:, 0] = False
        noise = torch.randn(maps.shape, generator=self._generator, device=maps.device)
        return maps.masked_fill(absent, 0) + 0.03 * self._uniform(count, 1, 1, 1) * noise
