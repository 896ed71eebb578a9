"""PMP estimator for photos of any size: several starts, kernel scores, calibrated confidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from motdiff.blind_search.coarse_to_fine import PmpSettings, Start, estimate_kernels
from motdiff.estimators.base import FoundKernels
from motdiff.estimators.blind_estimator import BlindEstimator
from motdiff.estimators.kernel_score import rank_kernels
from motdiff.estimators.pmp import Pmp
from motdiff.metrics import mnc_subpixel
from motdiff.photo_noise import shared_sigma
from motdiff.progress import Progress
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

STARTS = (
    Start(39, sparsity=1.0, gradient_weight=1.5e-2),
    Start(53, sparsity=0.5),
    Start(29),
    Start(35, quarter_turns=3, sparsity=1.0, gradient_weight=4e-3),
)
"""Two, and two more where these disagree; of 18 tried."""

_AGREED_MNC = 0.93  # of two searches, unrefined: docs/decisions/motion-estimation.md
_DISAGREE = 0.4  # share of photos with more starts than two
# processor time of the other stages, in starts
_RANK_COST = 0.05
_REFINE_COST = 0.15
_SINGLE_COST = 1.4
_PATH_COST = 0.25


def alike(pair: Sequence[FloatArray]) -> bool:
    """Whether the unrefined kernels of two searches are alike."""
    return mnc_subpixel(*pair) >= _AGREED_MNC


class PmpEstimator(BlindEstimator):
    """Blind estimator with the patch-wise minimal pixels prior.

    The starts run on the same crops, which share one kernel: the first two, and the others only
    where these found different ones; the ranking of :mod:`motdiff.estimators.kernel_score`
    chooses. ``confidence`` is the probability that the chosen kernel has a sub-pixel MNC of 0.7 or
    more, fitted on simulated photos.

    Parameters
    ----------
    crops, seed, progress
        As of :class:`motdiff.estimators.blind_estimator.BlindEstimator`.

    References
    ----------
    Wen et al., IEEE TCSVT 2021 (the prior).
    """

    method = Pmp.name
    smallest_px = Pmp.smallest_px

    def __init__(
        self,
        *,
        starts: tuple[Start, ...] = STARTS,
        crops: int = 3,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        super().__init__(crops=crops, seed=seed, progress=progress)
        if not starts:
            raise ValueError("starts: need at least one")
        self._starts = starts
        self.largest_px = max(start.size for start in starts)

    def search(
        self,
        crops: FloatArray,
        progress: Progress,
        halved: Callable[[], FloatArray] | None = None,  # noqa: ARG002, the base class's
    ) -> FoundKernels:
        """Run the starts on the crops (C, H, W) and refine the best once more."""
        single = _SINGLE_COST if len(crops) > 1 else 0.0
        progress.expect(
            planned(len(self._starts)) + _RANK_COST + _REFINE_COST + single + _PATH_COST
        )
        kernels = self.kernels(crops, progress=progress)
        ranking = rank_kernels(crops, kernels)
        progress.spend(_RANK_COST)
        kernels[ranking.best] = self.refine(crops, kernels[ranking.best])
        progress.spend(_REFINE_COST)
        details: dict[str, object] = {"starts": len(kernels), "agreement": ranking.agreement}
        return FoundKernels(tuple(kernels), ranking.probabilities, ranking.best, details)

    def kernels(self, crops: FloatArray, *, progress: Progress) -> list[FloatArray]:
        """Search kernels (size, size), sum 1, of crops (C, H, W) from each start.

        From the first two alone where their kernels are alike. A start costs 1 of the
        ``progress``, :func:`planned` in all.
        """
        jobs = [
            partial(self._run, crops, start, on_progress=progress.piece(1.0))
            for start in self._starts
        ]
        kernels = side_by_side(jobs[:2])
        if len(jobs) > 2:
            enough = alike(kernels)
            progress.expect_more((2 if enough else len(jobs)) - planned(len(jobs)))
            if not enough:
                kernels += side_by_side(jobs[2:])
        return kernels

    def single(
        self, crops: FloatArray, candidates: FoundKernels, progress: Progress
    ) -> list[FloatArray]:
        """Run the winning start on each crop alone."""
        start = self._starts[candidates.best]
        cost = _SINGLE_COST / len(crops)
        return side_by_side(
            [
                partial(self._run, crop[None], start, on_progress=progress.piece(cost))
                for crop in crops
            ]
        )

    def _run(
        self, crops: FloatArray, start: Start, *, on_progress: Callable[[float], None]
    ) -> FloatArray:
        kernel: FloatArray = searched_kernels(
            crops[None], start, sigma=shared_sigma(crops), on_progress=on_progress
        )[0]
        return kernel


def searched_kernels(
    photos: FloatArray,
    start: Start,
    *,
    sigma: float,
    one_scene: bool = False,
    on_progress: Callable[[float], None],
) -> FloatArray:
    """Search the kernels (B, k, k) of photos (B, C, H, W) from a start, turned as it says.

    Parameters
    ----------
    sigma, one_scene, on_progress
        As of :func:`motdiff.blind_search.coarse_to_fine.estimate_kernels`, in its settings or
        beside them.
    """
    rotated = np.rot90(photos, start.quarter_turns, axes=(2, 3)).astype(np.float32)
    # odd, and smaller than the photo
    size = min(start.size, (min(photos.shape[2:]) // 2) * 2 - 1)
    kernels = estimate_kernels(
        torch.from_numpy(np.ascontiguousarray(rotated)),
        replace(start, size=size),
        settings=PmpSettings(sigma),
        one_scene=one_scene,
        on_progress=on_progress,
    )
    kernel = np.rot90(kernels.numpy(), -start.quarter_turns, axes=(1, 2))
    return np.ascontiguousarray(kernel, dtype=np.float64)


def planned(starts: int) -> float:
    """Mean number of starts run: those after the first two only where these disagree."""
    return min(starts, 2) + _DISAGREE * max(starts - 2, 0)
