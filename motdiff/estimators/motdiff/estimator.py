"""MoTDiff estimator: drawn PSFs, kernel scores, refinement and a calibrated confidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from motdiff.blind_search.coarse_to_fine import refined
from motdiff.estimators.base import FoundKernels
from motdiff.estimators.blind_estimator import BlindEstimator
from motdiff.estimators.kernel_score import Judge, candidate_probabilities, distinct
from motdiff.estimators.motdiff import MotDiff
from motdiff.estimators.motdiff.correcting import (
    agreed_kernels,
    corrected_choice,
    framed,
    in_odd_frames,
    kernels_agreed_at_half,
)
from motdiff.estimators.motdiff.drawing import draw_psfs
from motdiff.estimators.pmp.estimator import STARTS, PmpEstimator, planned
from motdiff.estimators.simple_motion import simple_motion
from motdiff.metrics import mnc_matrix, mnc_subpixel
from motdiff.network.physics_maps import QUICK_STARTS, quick_kernels
from motdiff.photo_noise import noise_sigma, shared_sigma
from motdiff.progress import Progress
from motdiff.psf_frame import ODD_PX
from motdiff.threads import side_by_side
from motdiff.types import FloatArray
from motdiff.weights import load_correction, load_network

_REFINED = 3
_STEPS = 1  # of denoising, for each draw
# processor time of the stages, in starts of the classical search
_DRAW_COST = 0.4
_JUDGE_COST = 0.2
_REFINE_COST = 0.45
_SINGLE_COST = 0.35
_CORRECT_COST = 0.6
_HALVED_COST = 2.0  # its searches count as any
_TRACE_COST = 0.25
# of the search's starts, those that stand for the shortened ones the network was trained with; the
# first two agreeing, the larger one stands for the one not run as well
_CONDITIONS_OF_ALL = (2, 0, 1)
_CONDITIONS_OF_TWO = (1, 0, 1)


class MotDiffEstimator(BlindEstimator):
    """Blind estimator with the conditional diffusion model MoTDiff.

    Two classical searches give kernels, which a network corrects by what the photo tells of them
    (:mod:`motdiff.network.correction`). Where these agree, with each other and with the photo, the
    better one is chosen; or else the kernel that two searches of the photo at half its size agree
    on (:mod:`motdiff.estimators.motdiff.correcting`). Where they differ there as well, the photo
    leaves several motions: two more searches follow, and the diffusion network, conditioned on
    three of the kernels, samples motions. All are scored on the photo
    (:mod:`motdiff.estimators.kernel_score`), the most likely ones are refined at full resolution,
    the best and up to two of the likeliest different ones corrected, and the same score of the
    photo alone chooses: a classical kernel or a drawn one. A simple motion that is as likely takes
    its place (:mod:`motdiff.estimators.simple_motion`).

    Parameters
    ----------
    weights : path, optional
        A file from ``python -m motdiff export``; the shipped one when omitted.
    samples : int
        Motions drawn, each in one denoising step: the network's mean guess from the photo turned
        or mirrored its way. Draws are alike (MNC 0.98), and those beyond the eighth add next to
        nothing (0.99).
    seed : int
        Of the draws.
    crops, progress
        As of :class:`motdiff.estimators.blind_estimator.BlindEstimator`.

    References
    ----------
    Choi et al., "MoTDiff: High-resolution motion trajectory estimation from a single blurred image
    using diffusion models", arXiv 2510.26173. Physics maps, judgement, refinement and correction
    are ours.
    """

    method = MotDiff.name
    largest_px = ODD_PX
    smallest_px = MotDiff.smallest_px
    plain_mnc = 0.95  # less like, the photo has refused it

    def __init__(
        self,
        *,
        weights: Path | str | None = None,
        samples: int = 8,
        seed: int = 0,
        crops: int = 3,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        super().__init__(crops=crops, progress=progress)
        if samples < 1:
            raise ValueError(f"samples: must be at least 1, got {samples}")
        self._network = load_network() if weights is None else load_network(weights)
        self._samples = samples
        self._correction = load_correction()
        self._seed = seed

    def search(
        self, crops: FloatArray, progress: Progress, halved: Callable[[], FloatArray] | None = None
    ) -> FoundKernels:
        """Sample, score and refine kernels of the crops (C, H, W)."""
        at_the_end = _CORRECT_COST + _TRACE_COST + (_SINGLE_COST if len(crops) > 1 else 0.0)
        progress.expect(
            planned(len(STARTS)) + _DRAW_COST + _JUDGE_COST + _REFINE_COST + at_the_end
        )
        judge = Judge(crops, sigma=shared_sigma(crops))
        settled: FoundKernels | None = None

        def agreed(pair: Sequence[FloatArray]) -> bool:
            nonlocal settled
            settled = agreed_kernels(self._correction, crops, pair, judge)
            if settled is None and halved is not None:
                progress.expect_more(_HALVED_COST)
                settled = kernels_agreed_at_half(
                    self._correction,
                    crops,
                    pair,
                    halved(),
                    judge=judge,
                    progress=progress,
                )
            return settled is not None

        searched = PmpEstimator().kernels(crops, progress=progress, agreed=agreed)
        if settled is not None:
            progress.expect(at_the_end)
            return settled
        classical = framed(searched)
        conditions = _CONDITIONS_OF_ALL if len(classical) > 2 else _CONDITIONS_OF_TWO
        draws = draw_psfs(
            self._network,
            crops,
            classical[list(conditions)],
            count=self._samples,
            steps=_STEPS,
            generator=torch.Generator().manual_seed(self._seed),
        )
        progress.spend(_DRAW_COST)
        kernels = in_odd_frames(
            np.concatenate([draws, classical, draws.mean(axis=0, keepdims=True)])
        )
        mean = len(kernels) - 1
        groups = {"samples": len(draws), "classical": len(classical)}
        evidence = judge.evidence(kernels)
        likeness = mnc_matrix(kernels)
        believed = candidate_probabilities(evidence, likeness, **groups)
        progress.spend(_JUDGE_COST)
        likeliest = groups["samples"] + int(np.argmax(believed[groups["samples"] : mean]))
        chosen = distinct(likeness, [likeliest, mean], np.argsort(-believed), count=_REFINED)
        sharpened = side_by_side(
            [partial(refined, crops, kernels[i], judge.sigma) for i in chosen]
        )
        kernels += sharpened
        evidence = np.vstack([evidence, judge.evidence(sharpened)])
        believed = candidate_probabilities(evidence, mnc_matrix(kernels), **groups)
        # only among the refined: each is better than the kernel it comes from
        best = mean + 1 + int(np.argmax(believed[mean + 1 :]))
        progress.spend(_REFINE_COST)
        origins = ["sample"] * len(draws) + ["classical"] * len(classical) + ["mean of samples"]
        origins += [origins[i] for i in chosen]
        details: dict[str, object] = {
            **groups,
            "steps": _STEPS,
            "sample_agreement": _agreement(draws),
        }
        return FoundKernels(tuple(kernels), believed, best, details, origins=tuple(origins))

    def single(
        self,
        crops: FloatArray,
        candidates: FoundKernels,  # noqa: ARG002, the base class's
        progress: Progress,
    ) -> list[FloatArray]:
        """Run one quick search on each crop alone."""
        cost = _SINGLE_COST / len(crops)
        return side_by_side(
            [partial(_searched_alone, crop) for crop in crops],
            tell=lambda _finished: progress.spend(cost),
        )

    def corrected(
        self, crops: FloatArray, candidates: FoundKernels, progress: Progress
    ) -> FoundKernels:
        """Correct the likeliest kernels, choose anew, and take a simple motion as likely."""
        if candidates.corrected:
            better = replace(candidates, kernels=candidates.corrected)
        else:
            # the first kernels are the draws themselves: they take no part
            better = corrected_choice(
                self._correction, crops, candidates, count=_REFINED, skip=self._samples
            )
        motion = simple_motion(crops, better.best_kernel, sigma=shared_sigma(crops))
        if motion is not None:
            kernels = list(better.kernels)
            kernels[better.best] = motion.psf
            better = replace(
                better, kernels=tuple(kernels), path=motion.path, path_error_px=motion.error_px
            )
        progress.spend(_CORRECT_COST)
        return better


def _searched_alone(crop: FloatArray) -> FloatArray:
    light = torch.from_numpy(crop.astype(np.float32))[None, None]
    kernel = quick_kernels(
        light, sigma=noise_sigma(crop), starts=QUICK_STARTS[:1], fine_weights=()
    )
    return np.asarray(kernel[0, 0].double().numpy(), dtype=np.float64)


def _agreement(psfs: FloatArray) -> float:
    """Mean MNC of the samples with their mean: 1 where all are alike."""
    mean = psfs.mean(axis=0)
    return float(np.mean([mnc_subpixel(psf, mean) for psf in psfs]))
