"""Sampling of PSFs by the network from a photo's crops, in eight symmetries of the square."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from motdiff.blind_search.grids import SYMMETRIES, inverse_symmetry, mirrored
from motdiff.network.condition import PHOTO_PX
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.diffusion import cosine_schedule
from motdiff.network.physics_maps import QUICK_STARTS, display_photo, physics_maps, quick_kernels
from motdiff.network.sampling import sample_paths
from motdiff.threads import side_by_side
from motdiff.types import FloatArray


def draw_psfs(
    network: MotDiffNetwork,
    crops: FloatArray,
    classical: FloatArray,
    *,
    count: int,
    steps: int,
    generator: torch.Generator,
    method: str = "ddim",
) -> FloatArray:
    """Draw ``count`` PSFs (count, 64, 64), sum 1, of the blur that the crops share.

    Parameters
    ----------
    network : MotDiffNetwork
        In eval mode, on the CPU.
    crops : (C, H, W) float, grey, linear light
    classical : (Q, 64, 64) float
        Classical kernels for the physics maps; unused by a network without them.
    count : int
        Number of draws, spread over the eight symmetries of the square: a network's errors differ
        between them.
    steps : int
        Steps of each draw.
    method : str
        See :func:`motdiff.network.diffusion.samples`.
    """
    light = torch.from_numpy(crops.astype(np.float32))[None]
    physics: Tensor | None = None
    if network.physics is not None:
        physics = physics_maps(light, torch.from_numpy(classical.astype(np.float32))[None])
    photo = None if network.photo is None else _photo(light)
    schedule = cosine_schedule()

    def drawn(symmetry: int, seed: int) -> Tensor:
        """PSFs (n, 64, 64) drawn from the photo turned or mirrored one way, turned back."""
        condition = network.condition(
            None if photo is None else mirrored(photo, symmetry, pitch=0),
            None if physics is None else mirrored(physics, symmetry, pitch=1),
        )
        paths = sample_paths(
            network,
            condition,
            count=len(range(symmetry, count, SYMMETRIES)),
            schedule=schedule,
            steps=steps,
            generator=torch.Generator().manual_seed(seed),
            method=method,
        )
        return mirrored(paths.psfs(), inverse_symmetry(symmetry), pitch=1)[0]

    # a generator for each symmetry: the draws do not depend on the order of the threads
    seeds = torch.randint(2**62, (min(SYMMETRIES, count),), generator=generator).tolist()
    psfs = side_by_side([partial(drawn, s, seed) for s, seed in enumerate(seeds)])
    draws = torch.stack([psfs[i % SYMMETRIES][i // SYMMETRIES] for i in range(count)])
    return np.asarray(draws.double().numpy(), dtype=np.float64)


def quick_search(crops: FloatArray, *, sigma: float) -> FloatArray:
    """Kernels (Q, 64, 64), sum 1, of quick searches on crops (C, H, W) with noise ``sigma``."""
    light = torch.from_numpy(crops.astype(np.float32))[None]
    jobs = [partial(quick_kernels, light, sigma=sigma, starts=(start,)) for start in QUICK_STARTS]
    return np.asarray(torch.cat(side_by_side(jobs), dim=1)[0].double().numpy(), dtype=np.float64)


def _photo(crops: Tensor) -> Tensor:
    """Display values (1, 3, 256, 256) of the best crop's middle, mirrored outwards if smaller."""
    best = crops[:, :1]  # crops come best first
    missing = [max(0, PHOTO_PX - n) for n in best.shape[-2:]]
    while any(missing):  # a reflection adds at most n - 1 pixels, so small crops need several
        pads = [min(m, n - 1) for m, n in zip(missing, best.shape[-2:], strict=True)]
        best = functional.pad(best, (0, pads[1], 0, pads[0]), mode="reflect")
        missing = [max(0, PHOTO_PX - n) for n in best.shape[-2:]]
    row, column = ((n - PHOTO_PX) // 2 for n in best.shape[-2:])
    return display_photo(best[..., row : row + PHOTO_PX, column : column + PHOTO_PX])
