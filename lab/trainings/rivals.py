"""Training of the baselines over MoTDiff's condition: diffusion of PSFs, and one quadratic path.

    python -m lab.trainings.rivals train lab/trainings/configs/parametric.toml -o run

Options and commands are those of ``python -m motdiff``, which prepares the samples and exports.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import torch
from torch import Tensor

from lab.rivals.parametric import PathNetwork
from lab.rivals.psf_diffusion import psf_signals, psfs_of_signals
from motdiff import __main__ as motdiff_commands
from motdiff.network.config import NetworkConfig
from motdiff.network.sampling import psfs_of_maps
from motdiff.psf_frame import PSF_PX
from motdiff.tracing.quadratic import HAT_VARIANCE_PX2
from motdiff.training.batches import Batch
from motdiff.training.trainer import Trainer, blanked

_POINTS = 64  # dots along a path
_BLURS_PX = (0.6, 1.8, 5.0)  # the sharpest is nearly MNC; the others pull from farther away


class PsfTrainer(Trainer):
    """Run of the diffusion of PSFs."""

    target = "psf"

    def losses(self, batch: Batch, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Loss of the PSFs' signals; no dwell."""
        return super().losses(psf_batch(batch), generator)

    def draw_psfs(self, batch: Batch, *, steps: int, generator: torch.Generator) -> Tensor:
        """PSF (B, 64, 64) of one draw for each photo, by the averaged weights."""
        draws = self.draws(batch, steps=steps, generator=generator)
        return psfs_of_signals(draws.path[:, 0])


class PathTrainer(Trainer):
    """Run of the network that predicts a quadratic path."""

    target = "path"

    def build(self, config: NetworkConfig) -> PathNetwork:
        """Build the network with random weights."""
        return PathNetwork(config)

    def losses(self, batch: Batch, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """:func:`path_loss`; no dwell."""
        physics = blanked(batch.physics, self.config.data.physics_dropout, generator)
        loss = path_loss(self.model(batch.photo, physics).float(), batch.dwell)
        return loss, torch.zeros_like(loss)

    def draw_psfs(self, batch: Batch, *, steps: int, generator: torch.Generator) -> Tensor:
        """PSF (B, 64, 64) of each photo's path, which is no draw."""
        del steps, generator
        paths: Tensor = self.average(batch.photo, batch.physics)
        psfs = path_psfs(paths, torch.zeros_like(paths[:, 0]), variance_px2=HAT_VARIANCE_PX2)
        return psfs / psfs.sum(dim=(1, 2), keepdim=True)


def psf_batch(batch: Batch) -> Batch:
    """Batch whose ``x0`` (B, 1, 64, 64) are signals of PSFs, see :func:`psf_signals`."""
    signals = psf_signals(psfs_of_maps(batch.dwell))
    return Batch(batch.photo, batch.physics, signals, torch.zeros_like(signals))


def path_psfs(coefficients: Tensor, centre_px: Tensor, *, variance_px2: float) -> Tensor:
    """PSFs (B, 64, 64) of quadratic paths as rows of Gaussian dots, differentiable in everything.

    Parameters
    ----------
    coefficients : (B, 2, 2) float, px
        As :class:`~lab.rivals.parametric.PathNetwork` gives them.
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
        HR maps weighted by time, :class:`motdiff.training.batches.Batch`.

    Returns
    -------
    () tensor
    """
    truth = psfs_of_maps(dwell[:, 0])
    x = torch.arange(PSF_PX, device=truth.device, dtype=truth.dtype) - PSF_PX // 2
    centre_px = torch.stack([truth.sum(dim=1) @ x, truth.sum(dim=2) @ x], dim=1)
    losses = []
    for blur_px in _BLURS_PX:
        psfs = path_psfs(coefficients, centre_px, variance_px2=blur_px**2 + HAT_VARIANCE_PX2)
        blur = torch.exp(-(x[:, None] - x[None, :]).square() / (2 * blur_px**2))
        losses.append(1 - _peak_correlation(psfs, blur @ truth @ blur))
    return torch.stack(losses).mean()


def _peak_correlation(first: Tensor, second: Tensor) -> Tensor:
    """Mean over the batch of the greatest normalised correlation over whole-pixel shifts."""
    frame = (2 * PSF_PX, 2 * PSF_PX)
    spectrum = torch.fft.rfft2(first, s=frame) * torch.fft.rfft2(second, s=frame).conj()
    peaks = torch.fft.irfft2(spectrum, s=frame).flatten(1).amax(dim=1)
    norms = first.flatten(1).norm(dim=1) * second.flatten(1).norm(dim=1)
    correlation: Tensor = (peaks / norms.clamp(min=1e-12)).mean()
    return correlation


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command of ``python -m motdiff`` on a baseline; returns its exit code."""
    return motdiff_commands.run(arguments, trainers=(PsfTrainer, PathTrainer))


if __name__ == "__main__":
    sys.exit(run())
