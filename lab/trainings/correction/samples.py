"""Training samples: kernels that a search finds in simulated photos, what the photos tell of them,
and the truth.

Photos are searched in batches, on a GPU some sixty in a second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from motdiff.blind_search.coarse_to_fine import PmpSettings, Start, estimate_kernels
from motdiff.blind_search.grids import shifted
from motdiff.estimators.pmp.estimator import STARTS
from motdiff.network.correction import CorrectionNetwork, corrected, correction_maps
from motdiff.network.sampling import psfs_of_maps
from motdiff.photo_noise import noise_sigma
from motdiff.psf_frame import margins
from motdiff.training.prepared import (
    Source,
    joined,
    light_of,
    load_shards,
    sample_arrays,
    samples_of,
    write_shards,
)
from motdiff.training.samples import Samples, registration

SHARD_PHOTOS = 128
SEARCHES: tuple[Start, ...] = STARTS[:3]
"""Searches of each photo, those that ``cep calibrate`` begins with."""
LEAST_ALIKE = 0.4
"""A kernel less like the true one is lost: it says nothing about where the path lies."""
_NAME = "searched"
_SHIFT_PX = 2
_CPU_BATCH = 8  # larger ones fall out of the cache


@dataclass(frozen=True)
class Kernels:
    """Kernels of photos, lost ones left out.

    Attributes
    ----------
    maps : (N, 11, 64, 64) float16
        From :func:`motdiff.network.correction.correction_maps`; the first is the kernel.
    truth : (N, 64, 64) float16
        True PSFs, laid on the kernels to a quarter of a pixel.
    """

    maps: Tensor
    truth: Tensor

    def __len__(self) -> int:
        return len(self.maps)


def alike(kernels: Tensor, truth: Tensor) -> Tensor:
    """MNC (B,) of kernels (B, 64, 64) with the true ones over shifts of up to 2 px;
    differentiable.
    """
    padded = functional.pad(kernels, (_SHIFT_PX,) * 4)
    side = kernels.shape[-1]
    lags = range(2 * _SHIFT_PX + 1)
    products = torch.stack(
        [
            (padded[:, row : row + side, column : column + side] * truth).sum(dim=(1, 2))
            for row in lags
            for column in lags
        ]
    )
    norms = (kernels.square().sum(dim=(1, 2)) * truth.square().sum(dim=(1, 2))).sqrt()
    return products.amax(dim=0) / norms.clamp(min=1e-9)


def searched(photos: Tensor, *, searches: tuple[Start, ...] = SEARCHES) -> Tensor:
    """Kernels (B, K, 64, 64), sum 1, of photos (B, H, W), by a full search from each start.

    Photos are searched in batches of similar noise, for which a search has one setting.
    """
    noise = noise_of(photos)
    order = torch.from_numpy(np.argsort(noise)).to(photos.device)
    size = {"cpu": _CPU_BATCH}.get(photos.device.type, len(photos))
    rows = []
    for batch in torch.split(order, size):
        settings = PmpSettings(float(np.median(noise[batch.cpu().numpy()])))
        kernels = [
            estimate_kernels(photos[batch][:, None], start, settings=settings)
            for start in searches
        ]
        framed = [functional.pad(kernel, 2 * margins(kernel.shape[-1])) for kernel in kernels]
        rows.append(torch.stack(framed, dim=1))
    return torch.cat(rows)[order.argsort()]


def prepare(
    folder: Path | str,
    source: Source,
    *,
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
    shards : range
    device : str
        Where photos are searched.
    on_shard : callable, optional
        Called with the number of every finished shard.
    """

    def searched_arrays(shard: int) -> dict[str, NDArray[np.generic]]:
        samples = source.photos_of(shard, source.motions_of(shard, SHARD_PHOTOS))
        with torch.no_grad():
            kernels = searched(samples.photos.mean(dim=1).to(device), searches=SEARCHES)
        return sample_arrays(replace(samples, kernels=kernels.cpu()))

    write_shards(folder, shards, name=_NAME, make=searched_arrays, on_shard=on_shard)


def read_samples(folder: Path | str) -> Samples:
    """Read every shard of a folder into memory, as :func:`motdiff.training.prepared.read_shards`.

    Raises
    ------
    ValueError
        If it has none, or one is damaged.
    """
    missing = "searched_*.npz; write them with: python -m lab.trainings.correction prepare"
    return joined(load_shards(folder, name=_NAME, load=samples_of, missing=missing))


def described(
    samples: Samples, *, network: CorrectionNetwork | None = None, device: str = "cpu"
) -> Kernels:
    """Describe the searched kernels by their photos, and lay the true ones on them.

    The two others of each are the next ones in the order of the searches. With a ``network``, on
    the device, the kernels are those that it has corrected: samples of a second pass.

    Raises
    ------
    ValueError
        If every kernel is lost.
    """
    light = light_of(samples.photos)
    noise = noise_of(light[:, 0])
    parts = []
    # photos of similar noise together: the maps of a batch have one setting
    for batch in np.array_split(np.argsort(noise), -(-len(samples) // SHARD_PHOTOS)):
        photos, kernels, dwell = (
            tensor[batch].float().to(device) for tensor in (light, samples.kernels, samples.dwell)
        )
        sigma = float(np.median(noise[batch]))
        parts.append(_described(photos, kernels, dwell, sigma=sigma, network=network))
    maps, truth = (torch.cat(tensors) for tensors in zip(*parts, strict=True))
    if not len(maps):
        raise ValueError("samples: every kernel is lost; prepare more shards")
    return Kernels(maps, truth)


@torch.no_grad()
def _described(
    photos: Tensor,
    kernels: Tensor,
    dwell: Tensor,
    *,
    sigma: float,
    network: CorrectionNetwork | None,
) -> tuple[Tensor, Tensor]:
    maps = kernel_maps(photos, kernels, sigma)
    if network is not None:
        kernels = corrected(network, maps.flatten(0, 1)).view_as(kernels)
        maps = kernel_maps(photos, kernels, sigma)
    truth = torch.stack(
        [
            psfs_of_maps(shifted(dwell, registration(kernel[:, None], dwell))[:, 0])
            for kernel in kernels.unbind(dim=1)
        ],
        dim=1,
    )
    is_alike = alike(kernels.flatten(0, 1), truth.flatten(0, 1)) >= LEAST_ALIKE
    return maps.flatten(0, 1)[is_alike].half(), truth.flatten(0, 1)[is_alike].half()


def noise_of(photos: Tensor) -> NDArray[np.float64]:
    """Estimate the standard deviation (B,) of the noise of photos (B, H, W)."""
    return np.array([noise_sigma(photo.double().cpu().numpy()) for photo in photos])


def kernel_maps(photos: Tensor, kernels: Tensor, sigma: float) -> Tensor:
    """Stack the maps (B, K, 11, 64, 64) of the kernels (B, K, 64, 64) of photos (B, 1, H, W)."""
    return torch.stack(
        [
            correction_maps(photos, kernels[:, i], kernels.roll(-i, 1)[:, [1, -1]], sigma=sigma)
            for i in range(kernels.shape[1])
        ],
        dim=1,
    )
