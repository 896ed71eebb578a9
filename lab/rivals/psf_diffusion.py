"""PSF baseline: a diffusion model samples the 64 x 64 PSF, and the path is traced from it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from lab.rivals.conditioning import conditioning_maps
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.description import estimate_from_kernel

if TYPE_CHECKING:
    from torch import Tensor


class PsfDiffusionEstimator:
    """Blind estimator in Kernel-Diff's representation: one PSF sampled by conditional diffusion,
    not refined.

    It has the condition network of the shipped MoTDiff and started from its former weights. Its
    output and its training differ: the shipped one saw 12,816 samples drawn from 704 prepared
    ones, MoTDiff 209,600 from 13,376. Kernel-Diff's guidance by a deblurring network at each of
    1000 steps is not part of it.

    Parameters
    ----------
    weights : path, optional
        A file from ``python -m motdiff export`` of a run with target "psf"; the shipped one when
        omitted.
    steps : int
        DDIM steps. One, as MoTDiff takes, gives the network's mean guess, which is nearer to the
        truth than a draw.
    seed : int
        Of the draw.

    References
    ----------
    Sanghvi, Chi, Chan, "Kernel diffusion: an alternate approach to blind deconvolution", ECCV
    2024.
    """

    def __init__(
        self, *, weights: Path | str | None = None, steps: int = 1, seed: int = 0
    ) -> None:
        from lab.weights import PSF_WEIGHTS
        from motdiff.network.diffusion import cosine_schedule
        from motdiff.weights import load_network

        self._schedule = cosine_schedule()
        self._schedule.timesteps(steps)  # refuses a wrong number now, not at every photo
        self._network = load_network(PSF_WEIGHTS if weights is None else weights, target="psf")
        self._steps = steps
        self._seed = seed

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Draw the PSF of ``photo``, (H, W) or (H, W, 3), linear light 0..1; see
        :func:`conditioning_maps`.

        Its centroid lies at the middle of its frame, to whole pixels. The draw is not scored:
        ``confidence`` is 0.
        """
        import torch

        from motdiff.network.sampling import sample_paths

        with torch.no_grad():
            condition = self._network.condition(None, conditioning_maps(photo))
            samples = sample_paths(
                self._network,
                condition,
                count=1,
                schedule=self._schedule,
                steps=self._steps,
                generator=torch.Generator().manual_seed(self._seed),
            )
            psf = psfs_of_signals(samples.path[0, 0].double()).numpy()
        return estimate_from_kernel("psf-diffusion", psf, {"steps": self._steps})


def psf_signals(psfs: Tensor) -> Tensor:
    """Signals 0..1 of PSFs (..., S, S): the root of each over its peak.

    Kernel-Diff diffuses PSFs of sum 1, most of which lie within 0.01 of 0; the root spreads them.
    """
    return (psfs / psfs.amax(dim=(-2, -1), keepdim=True).clamp(min=1e-12)).sqrt()


def psfs_of_signals(signals: Tensor) -> Tensor:
    """PSFs (..., S, S), sum 1, of signals 0..1: inverse of :func:`psf_signals`."""
    psfs = signals.square()
    return psfs / psfs.sum(dim=(-2, -1), keepdim=True).clamp(min=1e-12)
