"""Figures of the denoiser's draws beside the truth."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from lab.trainings.paths.network import PathDenoiser, draw, rendered
from lab.trainings.paths.samples import PathSamples, peaks
from motdiff.psf_frame import PSF_PX

_QUARTERS = (0.0, 0.25, 0.5, 0.75)


@dataclass(frozen=True)
class Figures:
    """Figures of draws: means over photos, and medians of errors.

    Attributes
    ----------
    draw, best : float
        MNC over quarters of a pixel, of one draw and of the best of all.
    error_px, best_error_px : float
        Rms distance at equal times in the better direction, of one draw and of the best.
    alike : float
        MNC of two draws, over whole pixels.
    kernels : float
        MNC of the kernels' mean, over whole pixels.
    """

    draw: float
    best: float
    error_px: float
    best_error_px: float
    alike: float
    kernels: float


@torch.no_grad()
def figures(
    network: PathDenoiser,
    samples: PathSamples,
    *,
    draws: int,
    generator: torch.Generator,
    steps: int = 16,
    batch: int = 128,
) -> Figures:
    """Compare draws with the truth, on samples that no training has seen, lost ones included."""
    rows = []
    for first in range(0, len(samples), batch):
        batch_slice = slice(first, first + batch)
        maps = samples.maps[batch_slice].float() / 127
        paths = draw(network, maps, count=draws, steps=steps, generator=generator)
        truth, points = (
            samples.psfs[batch_slice].float()[:, None],
            samples.points[batch_slice][:, None],
        )
        mnc = torch.stack(
            [
                peaks(rendered_draws(paths + paths.new_tensor([right, down])), truth)[0]
                for right in _QUARTERS
                for down in _QUARTERS
            ]
        ).amax(dim=0)
        centred = paths - paths.mean(dim=2, keepdim=True)
        errors = torch.stack(
            [
                (centred - (ordered - ordered.mean(dim=2, keepdim=True)))
                .square()
                .sum(-1)
                .mean(-1)
                .sqrt()
                for ordered in (points, points.flip(2))
            ]
        ).amin(dim=0)
        pair = rendered_draws(paths[:, [0, -1]])
        kernels = maps[:, :3].square()
        kernels = (kernels / kernels.sum(dim=(2, 3), keepdim=True)).mean(dim=1, keepdim=True)
        columns = (
            mnc[:, 0],
            mnc.amax(dim=1),
            errors[:, 0],
            errors.amin(dim=1),
            peaks(pair[:, :1], pair[:, 1:])[0][:, 0],
            peaks(kernels, truth)[0][:, 0],
        )
        rows.append(torch.stack(columns, dim=1))
    table = torch.cat(rows)
    mean, median = table.mean(dim=0).tolist(), table.median(dim=0).values.tolist()
    return Figures(mean[0], mean[1], median[2], median[3], mean[4], mean[5])


def rendered_draws(paths: Tensor) -> Tensor:
    """PSFs (B, K, 64, 64) of paths (B, K, 64, 2)."""
    return rendered(paths.flatten(0, 1)).view(*paths.shape[:2], PSF_PX, PSF_PX)
