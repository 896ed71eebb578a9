"""Sampling of trajectories from a trained network, and conversion of their maps to PSFs."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.diffusion import Schedule, from_signal, samples, to_signal
from motdiff.psf_frame import MAP_PITCH

DOUBT = 0.02
"""Share of the peak below which a network's output counts as 0; off the path it never quite is."""


@dataclass(frozen=True)
class PathSamples:
    """Trajectories drawn for a batch of photos.

    Attributes
    ----------
    path : (B, K, 256, 256) float32
        Probability of each HR-map pixel to lie on the path; nearly 0 or 1 after enough steps.
    dwell : (B, K, 256, 256) float32
        Relative time per pixel; 1 everywhere for a network without that output.
    """

    path: Tensor
    dwell: Tensor

    def psfs(self) -> Tensor:
        """PSFs (B, K, 64, 64), with the dwell."""
        return psfs_of_maps(self.path * self.dwell)


def sample_paths(
    network: MotDiffNetwork,
    condition: Tensor,
    *,
    count: int,
    schedule: Schedule,
    steps: int,
    generator: torch.Generator,
    method: str = "ddim",
) -> PathSamples:
    """Draw ``count`` trajectories per photo.

    Parameters
    ----------
    network : MotDiffNetwork
        In eval mode. One of PSFs gives their signals as `path`.
    condition : (B, C, h, w) float
        From ``network.condition``: computed once, used at every step.
    count : int
        K.
    schedule, steps, generator, method
        As for :func:`motdiff.network.diffusion.samples`.
    """
    batch, _, height, width = condition.shape
    pitch = network.denoiser.pitch
    repeated = condition.repeat_interleave(count, dim=0)
    speeds = condition.new_ones(batch * count, 1, pitch * height, pitch * width)

    def predict_x0(x_t: Tensor, t: Tensor) -> Tensor:
        nonlocal speeds
        logits = network.denoiser(x_t.to(condition.dtype), t, repeated)
        # of the last step: the dwell belongs to the final map
        if logits.shape[1] > 1:
            speeds = functional.softplus(logits[:, 1:])
        return to_signal(torch.sigmoid(logits[:, :1].float()))

    *_, signal = samples(
        predict_x0,
        speeds.shape,
        schedule=schedule,
        steps=steps,
        generator=generator,
        method=method,
        device=condition.device,
    )
    shape = (batch, count, *speeds.shape[-2:])
    return PathSamples(from_signal(signal).view(shape), speeds.float().view(shape))


def psfs_of_maps(maps: Tensor) -> Tensor:
    """PSFs (..., 64, 64), sum 1, of non-negative HR maps (..., 256, 256); a point of an empty one.

    Each PSF pixel weighs the map by a bilinear hat, as :meth:`motdiff.trajectory.Trajectory.psf`
    does: with a true map of path and dwell the MNC is over 0.99, with 4 x 4 means 0.92 to 0.97.
    """
    index = torch.arange(2 * MAP_PITCH, device=maps.device, dtype=maps.dtype)
    hat = 1 - ((index + 0.5) / MAP_PITCH - 1).abs()
    # the hat is separable: rows and columns one after the other
    across = functional.conv2d(
        maps.reshape(-1, 1, *maps.shape[-2:]),
        hat[None, None, None, :],
        stride=(1, MAP_PITCH),
        padding=(0, MAP_PITCH // 2),
    )
    psfs = functional.conv2d(
        across, hat[None, None, :, None], stride=(MAP_PITCH, 1), padding=(MAP_PITCH // 2, 0)
    )[:, 0]
    point = torch.zeros_like(psfs)
    point[:, psfs.shape[1] // 2, psfs.shape[2] // 2] = 1
    total = psfs.sum(dim=(1, 2), keepdim=True)
    psfs = torch.where(total > 1e-6, psfs / total.clamp(min=1e-6), point)
    return psfs.reshape(*maps.shape[:-2], *psfs.shape[-2:])
