"""Samples: kernels searched in simulated photos and corrected twice, and the paths of the motions.

Photos are searched in batches, on a GPU some forty in a second.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lab.trainings.correction.samples import kernel_maps, noise_of, searched
from lab.trainings.paths.network import POINTS
from motdiff.blind_search.grids import mirrored
from motdiff.network.correction import CorrectionNetwork, corrected
from motdiff.psf_frame import PSF_PX
from motdiff.training.motion_bank import MotionMix, drawn_motions
from motdiff.training.prepared import Source, load_shards, write_shards
from motdiff.trajectory import Trajectory

SHARD_PHOTOS = 128
LEAST_ALIKE = 0.35
"""Photos whose mean kernel is less like the true one are lost: they do not tell where it lies."""
_PASSES = 2  # of the correction
_BATCH = 64  # photos of similar noise, whose maps have one setting
_LEAST_SQUARES = 4  # of the correction's maps, the one with the middle ridge
_NAME = "paths"
_TIMES = np.linspace(0, 1, POINTS)
_FRAME = (2 * PSF_PX, 2 * PSF_PX)


@dataclass(frozen=True)
class PathSamples:
    """Photos by their kernels, and the paths of their motions.

    Attributes
    ----------
    maps : (N, 4, 64, 64) int8
        127 times the roots of three kernels over their peaks, the one most like the others first
        and the others laid on it, and the signed root of a least-squares kernel.
    points : (N, 64, 2) float32
        Displacements at even times, px, laid on the kernels.
    psfs : (N, 64, 64) float16
        The true PSFs, where they lie by themselves.
    alike : (N,) float32
        Correlation of the kernels' mean with the true PSF, over whole pixels.
    """

    maps: Tensor
    points: Tensor
    psfs: Tensor
    alike: Tensor

    def __len__(self) -> int:
        return len(self.points)


def clean_points(mix: MotionMix, *, count: int, seed: int) -> Tensor:
    """Points (count, 64, 2) of motions without photos, which cost a millisecond each."""
    return _points(drawn_motions(mix, seed=seed, indices=range(count)))


def _points(motions: Sequence[Trajectory]) -> Tensor:
    return torch.from_numpy(np.array([motion.at(_TIMES) for motion in motions], np.float32))


def prepare(
    folder: Path | str,
    source: Source,
    *,
    network: CorrectionNetwork,
    shards: range,
    device: str = "cpu",
    on_shard: Callable[[int], None] = lambda _shard: None,
) -> None:
    """Write the missing ones of the ``shards`` (128 photos each); each depends on its number and
    the source's seed only.

    Parameters
    ----------
    folder : path, made when missing
    source : Source
    network : CorrectionNetwork
        In eval mode.
    shards : range
    device : str
        Where photos are searched.
    on_shard : callable, optional
        Called with the number of every finished shard.
    """

    def arrays(shard: int) -> dict[str, NDArray[Any]]:
        motions = source.motions_of(shard, SHARD_PHOTOS)
        samples = source.photos_of(shard, motions)
        kernels, least_squares = photo_kernels(samples.photos.mean(dim=1).to(device), network)
        psfs = torch.from_numpy(np.stack([motion.psf(PSF_PX) for motion in motions])).float()
        described = described_paths(kernels.cpu(), least_squares.cpu(), _points(motions), psfs)
        return {name: value.numpy() for name, value in vars(described).items()}

    write_shards(folder, shards, name=_NAME, make=arrays, on_shard=on_shard)


@torch.no_grad()
def photo_kernels(photos: Tensor, network: CorrectionNetwork) -> tuple[Tensor, Tensor]:
    """Kernels (B, 3, 64, 64), corrected twice, and a least-squares kernel (B, 64, 64) of each
    photo (B, H, W).
    """
    kernels = searched(photos).float()
    least_squares = torch.empty_like(kernels[:, 0])
    noise = noise_of(photos)
    network = network.to(photos.device)
    for batch in np.array_split(np.argsort(noise), -(-len(photos) // _BATCH)):
        light, sigma = photos[batch][:, None], float(np.median(noise[batch]))
        for _ in range(_PASSES):
            maps = kernel_maps(light, kernels[batch], sigma)
            kernels[batch] = corrected(network, maps.flatten(0, 1)).view_as(kernels[batch])
        least_squares[batch] = kernel_maps(light, kernels[batch], sigma)[:, 0, _LEAST_SQUARES]
    return kernels, least_squares


def described_paths(
    kernels: Tensor, least_squares: Tensor, points: Tensor, psfs: Tensor
) -> PathSamples:
    """Lay kernels on each other, their middle on the frame's, and the paths on them.

    Parameters
    ----------
    kernels : (N, 3, 64, 64) float
    least_squares : (N, 64, 64) float
        Lies as the first kernel does.
    points : (N, 64, 2) float, px
    psfs : (N, 64, 64) float
        Of the paths.
    """
    likeness = torch.stack([peaks(kernels, kernels[:, [i]])[0] for i in range(3)], dim=1)
    order = likeness.sum(dim=1).argsort(dim=1, descending=True)
    photo = torch.arange(len(kernels))
    leader = kernels[photo, order[:, 0]]
    signed = torch.cat([kernels, least_squares[:, None]], dim=1)
    lag = peaks(leader[:, None], kernels)[1].round().int()
    lag = torch.cat([lag, lag[:, :1]], dim=1)  # the least-squares kernel lies as the first
    signed = torch.cat([signed[photo[:, None], order], signed[:, 3:]], dim=1)
    lag = torch.cat([lag[photo[:, None], order], lag[:, 3:]], dim=1)
    laid = torch.empty_like(signed)
    place = torch.arange(PSF_PX) - PSF_PX // 2
    for i in range(len(signed)):
        rolled = [
            signed[i, j].roll(tuple(lag[i, j].tolist()), (0, 1)) for j in range(signed.shape[1])
        ]
        mean = torch.stack(rolled[:3]).mean(dim=0)
        middle = torch.stack([mean.sum(dim=1) @ place.float(), mean.sum(dim=0) @ place.float()])
        shift = (-middle / mean.sum().clamp(min=1e-9)).round().int().tolist()
        laid[i] = torch.stack(rolled).roll(tuple(shift), (1, 2))
    alike, down_right = peaks(laid[:, :3].mean(dim=1)[:, None], psfs[:, None])
    roots = laid / laid.abs().amax(dim=(-2, -1), keepdim=True).clamp(min=1e-9)
    return PathSamples(
        (127 * roots.sign() * roots.abs().sqrt()).round().char(),
        points + down_right[:, 0].flip(-1)[:, None],
        psfs.half(),
        alike[:, 0],
    )


def peaks(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Best correlation (B, K) over whole-pixel shifts of maps (B, K, 64, 64), and the shift
    (B, K, 2), down and right, that lays the second on the first, by parabolas to parts of a pixel.
    """
    spectrum = torch.fft.rfft2(first, s=_FRAME) * torch.fft.rfft2(second, s=_FRAME).conj()
    products = torch.fft.irfft2(spectrum, s=_FRAME)
    best, index = products.flatten(-2).max(dim=-1)
    row, column = index // _FRAME[1], index % _FRAME[1]

    def beside(down: int, right: int) -> Tensor:
        place = (row + down) % _FRAME[0] * _FRAME[1] + (column + right) % _FRAME[1]
        value: Tensor = products.flatten(-2).gather(-1, place[..., None])[..., 0]
        return value

    def offset(before: Tensor, after: Tensor) -> Tensor:
        subpixel: Tensor = 0.5 * (before - after) / (before - 2 * best + after).clamp(max=-1e-12)
        return subpixel

    pixels = (torch.stack([row, column], dim=-1) + PSF_PX) % _FRAME[0] - PSF_PX
    offsets = [offset(beside(-1, 0), beside(1, 0)), offset(beside(0, -1), beside(0, 1))]
    norms = first.flatten(-2).norm(dim=-1) * second.flatten(-2).norm(dim=-1)
    return best / norms.clamp(min=1e-9), pixels + torch.stack(offsets, dim=-1).clamp(-0.5, 0.5)


def read_samples(folder: Path | str) -> PathSamples:
    """Read every shard of a folder.

    Raises
    ------
    ValueError
        If it has none, or one is damaged.
    """

    def samples_of(stored: Mapping[str, NDArray[Any]]) -> PathSamples:
        names = ("maps", "points", "psfs", "alike")
        return PathSamples(*(torch.from_numpy(stored[name]) for name in names))

    missing = "paths_*.npz; write them with: python -m lab.trainings.paths prepare"
    shards = load_shards(folder, name=_NAME, load=samples_of, missing=missing)
    return PathSamples(
        *(torch.cat(parts) for parts in zip(*(vars(s).values() for s in shards), strict=True))
    )


def turned(maps: Tensor, points: Tensor, symmetry: int) -> tuple[Tensor, Tensor]:
    """Turn or mirror maps (B, C, 64, 64) and points (B, 64, 2) by a symmetry of the square, see
    :func:`motdiff.blind_search.grids.mirrored`.
    """
    signs = points.new_tensor([1 - (symmetry & 2), 1 - 2 * (symmetry & 1)])
    points = points * signs
    if symmetry & 4:
        points = points.flip(-1)
    return mirrored(maps, symmetry, pitch=1), points


def forward_in_time(points: Tensor) -> Tensor:
    """Run paths (B, 64, 2) backwards whose trend points left: a kernel does not tell which."""
    time = torch.linspace(-1, 1, POINTS, device=points.device)
    trend = (points * time[:, None]).sum(dim=1)
    backwards = trend[:, 0] + 0.37 * trend[:, 1] < 0  # no symmetry of the square turns this line
    return torch.where(backwards[:, None, None], points.flip(1), points)
