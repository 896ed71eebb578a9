"""Training targets of the baselines: PSFs, and quadratic paths with a PSF loss."""

from __future__ import annotations

import torch
from torch import Tensor

from motdiff.network import MotDiffNetwork, PathNetwork
from motdiff.network.diffusion import Schedule
from motdiff.network.sampling import psf_signals, psfs_of_maps, psfs_of_signals, sample_paths
from motdiff.psf_frame import PSF_PX
from motdiff.training.data import Batch

_POINTS = 64  # dots along a path
_HAT_VARIANCE_PX2 = 1 / 6  # of the bilinear hat through which PSFs see the path
_BLURS_PX = (0.6, 1.8, 5.0)  # the sharpest is nearly MNC; the others pull from farther away


def psf_batch(batch: Batch) -> Batch:
    """Batch whose ``x0`` (B, 1, 64, 64) are signals of PSFs, see :func:`psf_signals`."""
    signals = psf_signals(psfs_of_maps(batch.dwell))
    return Batch(batch.photo, batch.physics, signals, torch.zeros_like(signals))


def path_psfs(coefficients: Tensor, centre_px: Tensor, *, variance_px2: float) -> Tensor:
    """PSFs (B, 64, 64) of quadratic paths as rows of Gaussian dots, differentiable in everything.

    Parameters
    ----------
    coefficients : (B, 2, 2) float, px
        As :class:`motdiff.network.PathNetwork` gives them.
    centre_px : (B, 2) float, px
        Where the path's time-mean lies, x before y, from index 32.
    variance_px2 : float, px^2
        Of a dot along each axis.
    """
    index = torch.arange(_POINTS, device=coefficients.device, dtype=coefficients.dtype)
    tau = (index + 0.5) / _POINTS - 0.5
    shapes = torch.stack([tau, tau.square() - 1 / 12])  # (2, N)
    points = torch.einsum("sn,bsx->bxn", shapes, coefficients) + centre_px[..., None]
    x = torch.arange(PSF_PX, device=tau.device, dtype=tau.dtype) - PSF_PX // 2
    # (B, 2, 64, N): a dot is the product of its two profiles
    dots = torch.exp(-(x[:, None] - points[:, :, None, :]).square() / (2 * variance_px2))
    return dots[:, 1] @ dots[:, 0].transpose(1, 2)


def path_loss(coefficients: Tensor, dwell: Tensor) -> Tensor:
    """One minus the correlation, best over shifts, of the paths' PSFs with the true ones.

    The mean over three blurs. A path and its reverse have the same PSF, hence the same loss.

    Parameters
    ----------
    coefficients : (B, 2, 2) float, px
    dwell : (B, 1, 256, 256) float
        HR maps weighted by time, :class:`motdiff.training.data.Batch`.

    Returns
    -------
    () tensor
    """
    truth = psfs_of_maps(dwell[:, 0])
    x = torch.arange(PSF_PX, device=truth.device, dtype=truth.dtype) - PSF_PX // 2
    centre_px = torch.stack([truth.sum(dim=1) @ x, truth.sum(dim=2) @ x], dim=1)
    losses = []
    for blur_px in _BLURS_PX:
        psfs = path_psfs(coefficients, centre_px, variance_px2=blur_px**2 + _HAT_VARIANCE_PX2)
        blur = torch.exp(-(x[:, None] - x[None, :]).square() / (2 * blur_px**2))
        losses.append(1 - _peak_correlation(psfs, blur @ truth @ blur))
    return torch.stack(losses).mean()


def drawn_psfs(
    network: MotDiffNetwork | PathNetwork,
    batch: Batch,
    *,
    schedule: Schedule,
    steps: int,
    generator: torch.Generator,
) -> Tensor:
    """PSF (B, 64, 64) that a network of any target gives for each photo: one draw, or the path's.

    Parameters
    ----------
    network : MotDiffNetwork or PathNetwork
        In eval mode.
    schedule, steps, generator
        As for :func:`motdiff.network.sampling.sample_paths`; a quadratic path needs none.
    """
    if isinstance(network, PathNetwork):
        paths: Tensor = network(batch.photo, batch.physics)
        psfs = path_psfs(paths, torch.zeros_like(paths[:, 0]), variance_px2=_HAT_VARIANCE_PX2)
        return psfs / psfs.sum(dim=(1, 2), keepdim=True)
    condition = network.condition(batch.photo, batch.physics)
    draws = sample_paths(
        network, condition, count=1, schedule=schedule, steps=steps, generator=generator
    )
    if network.pitch == 1:  # it diffuses PSFs themselves
        return psfs_of_signals(draws.path[:, 0])
    return draws.psfs()[:, 0]


def _peak_correlation(first: Tensor, second: Tensor) -> Tensor:
    """Mean over the batch of the greatest normalised correlation over whole-pixel shifts."""
    frame = (2 * PSF_PX, 2 * PSF_PX)
    spectrum = torch.fft.rfft2(first, s=frame) * torch.fft.rfft2(second, s=frame).conj()
    peaks = torch.fft.irfft2(spectrum, s=frame).flatten(1).amax(dim=1)
    norms = first.flatten(1).norm(dim=1) * second.flatten(1).norm(dim=1)
    correlation: Tensor = (peaks / norms.clamp(min=1e-12)).mean()
    return correlation
