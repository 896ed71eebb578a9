"""Training samples: kernels that a search finds in simulated photos, what the photos tell of them,
and the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from motdiff.estimators.kernel_score import noise_sigma
from motdiff.estimators.pmp.estimator import PmpEstimator
from motdiff.estimators.pmp.grids import shifted
from motdiff.network.correction import CorrectionNetwork, corrected, correction_maps
from motdiff.network.sampling import psfs_of_maps
from motdiff.psf_frame import in_frame
from motdiff.threads import one_thread_a_call
from motdiff.training.motion_bank import MotionMix
from motdiff.training.prepared import simulated_shard
from motdiff.training.samples import Samples, registration
from motdiff.training.shards import load_shards, write_shards
from motdiff.training.simulation import Photography

SHARD_PHOTOS = 16
_NAME = "kernels"
LEAST_ALIKE = 0.4
"""A kernel less like the true one is lost: it says nothing about where the path lies."""
_SHIFT_PX = 2


@dataclass(frozen=True)
class Kernels:
    """Kernels found in photos.

    Attributes
    ----------
    maps : (N, 11, 64, 64) float16
        From :func:`motdiff.network.correction.correction_maps`; the first is the kernel itself.
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
    products = functional.conv2d(padded[None], truth[:, None], groups=len(truth))[0]
    norms = (kernels.square().sum(dim=(1, 2)) * truth.square().sum(dim=(1, 2))).sqrt()
    return products.flatten(1).amax(dim=1) / norms.clamp(min=1e-9)


def searched(samples: Samples, *, network: CorrectionNetwork | None = None) -> Kernels:
    """Search the kernels of simulated photos as ``cep calibrate`` does, and lay the true ones on
    them.

    Lost ones are left out. The two others of each are the next ones in the order of the search's
    starts. With a ``network`` the kernels are those that it has corrected: samples of a second
    pass.
    """
    maps = []
    truth = []
    with torch.no_grad(), one_thread_a_call():
        for photo, dwell in zip(samples.photos.mean(dim=1), samples.dwell, strict=True):
            grey = photo.double().numpy()
            searched_kernels = [in_frame(kernel) for kernel in PmpEstimator().kernels(grey[None])]
            kernels = torch.from_numpy(np.stack(searched_kernels)).float()
            neighbours = torch.stack([kernels.roll(-i, 0)[[1, -1]] for i in range(len(kernels))])
            path = dwell.expand(len(kernels), -1, -1, -1)
            laid = psfs_of_maps(shifted(path, registration(kernels[:, None], path))[:, 0])
            is_alike = alike(kernels, laid) >= LEAST_ALIKE
            sigma = noise_sigma(grey)
            correction = correction_maps(photo[None], kernels, neighbours, sigma=sigma)
            if network is not None:
                correction = correction_maps(
                    photo[None], corrected(network, correction), neighbours, sigma=sigma
                )
            maps.append(correction[is_alike].half())
            truth.append(laid[is_alike].half())
    return Kernels(torch.cat(maps), torch.cat(truth))


def prepare(
    folder: Path | str,
    *,
    scenes: Sequence[Tensor],
    mix: MotionMix,
    photography: Photography,
    shards: range,
    seed: int,
    network: CorrectionNetwork | None = None,
    on_shard: Callable[[int], None] = lambda _shard: None,
) -> None:
    """Write the missing ones of the ``shards`` (16 photos each); each depends on its number and
    the seed only.

    Parameters
    ----------
    folder : path, made when missing
    scenes, mix, photography
        As for :func:`motdiff.training.samples.simulate`.
    shards : range
    seed : int
    network : CorrectionNetwork, optional
        As for :func:`searched`.
    on_shard : callable, optional
        Called with the number of every finished shard.
    """

    def made(shard: int) -> dict[str, NDArray[np.generic]]:
        samples = simulated_shard(
            shard,
            SHARD_PHOTOS,
            scenes=scenes,
            mix=mix,
            photography=photography,
            physics=False,
            seed=seed,
        )
        kernels = searched(samples, network=network)
        return {"maps": kernels.maps.numpy(), "truth": kernels.truth.numpy()}

    write_shards(folder, shards, name=_NAME, make=made, on_shard=on_shard)


def read_kernels(*folders: Path | str) -> Kernels:
    """Read every shard of some folders into memory, 0.1 MB a kernel.

    Raises
    ------
    ValueError
        If a folder has none, or one is damaged.
    """
    missing = "kernels_*.npz; write them with: python -m lab.trainings.correction prepare"
    parts = [load_shards(folder, name=_NAME, load=_kernels, missing=missing) for folder in folders]
    maps, truth = (
        torch.cat([getattr(samples, name) for samples in chain(*parts)])
        for name in ("maps", "truth")
    )
    if not len(maps):
        raise ValueError(
            f"{', '.join(map(str, folders))}: every kernel was lost; prepare more shards"
        )
    return Kernels(maps, truth)


def _kernels(stored: Mapping[str, NDArray[Any]]) -> Kernels:
    return Kernels(torch.from_numpy(stored["maps"]), torch.from_numpy(stored["truth"]))
