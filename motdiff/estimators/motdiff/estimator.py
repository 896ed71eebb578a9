"""MoTDiff estimator: kernels of searches corrected, and where these differ PSFs drawn and scored.

Searches that differ on the photo often agree on the photo at half its size: the blur is half as
long there, varies half as much from place to place, and noise is averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch

from motdiff.blind_search.coarse_to_fine import refined
from motdiff.estimators.base import FoundKernels
from motdiff.estimators.blind_estimator import BlindEstimator
from motdiff.estimators.kernel_score import (
    Judge,
    candidate_probabilities,
    distinct,
    kernel_score,
    probability_good,
)
from motdiff.estimators.motdiff import MotDiff
from motdiff.estimators.motdiff.drawing import draw_psfs
from motdiff.estimators.pmp.estimator import STARTS, PmpEstimator, planned
from motdiff.estimators.simple_motion import simple_motion
from motdiff.metrics import SAME_KERNEL_MNC, mnc_matrix, mnc_subpixel
from motdiff.network.correction import CorrectionNetwork, corrected_kernel
from motdiff.network.physics_maps import QUICK_STARTS, quick_kernels
from motdiff.network.sampling import DOUBT
from motdiff.photo_noise import noise_sigma, shared_sigma
from motdiff.progress import Progress
from motdiff.psf_frame import ODD_PX, PSF_PX, in_frame, without_faint_light
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
_PAIR = 2  # searches that are compared
# two corrected kernels are the photo's from this MNC and score on, and the probability of one to
# be good grows with the MNC: docs/decisions/network.md
_AGREED_MNC = 0.85
_AGREED_SCORE = 0.4
_AGREED = (15.0, -10.5)
_LEAST_INSIDE = 0.98  # share of an enlarged kernel's light within the frame


class MotDiffEstimator(BlindEstimator):
    """Blind estimator with the conditional diffusion model MoTDiff.

    Two classical searches give kernels, which a network corrects by what the photo tells of them
    (:mod:`motdiff.network.correction`). Where these agree, with each other and with the photo, the
    better one is chosen; or else the kernel that two searches of the photo at half its size agree
    on. Where they differ there as well, the photo leaves several motions: two more searches
    follow, and the diffusion network, conditioned on three of the kernels, samples motions. All
    are scored on the photo (:mod:`motdiff.estimators.kernel_score`), the most likely ones are
    refined at full resolution, the best and up to two of the likeliest different ones corrected,
    and the same score of the photo alone chooses: a classical kernel or a drawn one. A simple
    motion that is as likely takes its place (:mod:`motdiff.estimators.simple_motion`).

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
                    self._correction, crops, pair, halved(), judge=judge, progress=progress
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


def corrected_choice(
    network: CorrectionNetwork,
    crops: FloatArray,
    candidates: FoundKernels,
    *,
    count: int,
    skip: int = 0,
) -> FoundKernels:
    """Correct the best kernel and the likeliest different ones; choose by the photo alone.

    Corrected kernels stay in their places, in frames of 63 px. Their probabilities, none above
    that of the best before, are handed out in the order of their scores. Kernels that are the same
    as one of these before the correction are superseded: their probability is 0.

    Parameters
    ----------
    network : CorrectionNetwork
        In eval mode, on the CPU.
    crops : (C, H, W) float, grey, linear light
    candidates : FoundKernels
        What was found in the crops.
    count : int
        How many to correct.
    skip : int
        So many of the first kernels take no part. At least two others do, the best one among them.
    """
    judge = Judge(crops)
    kernels = list(candidates.kernels)
    probabilities = candidates.probabilities.copy()
    likely = [int(i) for i in np.argsort(-probabilities) if i >= skip]
    alike = mnc_matrix(kernels)
    chosen = distinct(alike, [candidates.best], likely, count=count)

    def better(i: int) -> FloatArray:
        # the network was made for two other kernels beside the one that it corrects
        rivals = [candidates.kernels[j] for j in likely if j != i][:2]
        return corrected_kernel(network, crops, candidates.kernels[i], rivals, sigma=judge.sigma)

    corrected_kernels = side_by_side([partial(better, i) for i in chosen])
    ranked = [chosen[n] for n in np.argsort(-kernel_score(judge.evidence(corrected_kernels)))]
    handed_out = -np.sort(-np.minimum(probabilities[chosen], candidates.confidence))
    probabilities[(alike[:, chosen] >= SAME_KERNEL_MNC).any(axis=1)] = 0.0
    probabilities[ranked] = handed_out
    for i, kernel in zip(chosen, corrected_kernels, strict=True):
        kernels[i] = kernel
    return replace(candidates, kernels=tuple(kernels), probabilities=probabilities, best=ranked[0])


def agreed_kernels(
    network: CorrectionNetwork, crops: FloatArray, pair: Sequence[FloatArray], judge: Judge
) -> FoundKernels | None:
    """Correct the kernels of two searches; None where they or the photo disagree.

    Parameters
    ----------
    crops : (C, H, W) float, grey, linear light
    pair : two (k, k) float
        Kernels of the searches in the crops.
    judge : Judge
        Of the crops.
    """
    corrected = side_by_side(
        [
            partial(corrected_kernel, network, crops, kernel, [rival], sigma=judge.sigma)
            for kernel, rival in (pair, pair[::-1])
        ]
    )
    agreement = mnc_subpixel(*corrected)
    if agreement < _AGREED_MNC:
        return None
    scores = kernel_score(judge.evidence(corrected))
    if scores.max() < _AGREED_SCORE:
        return None
    return FoundKernels(
        kernels=tuple(in_odd_frames(framed(pair))),
        probabilities=probability_good(np.full(_PAIR, agreement), _AGREED),
        best=int(np.argmax(scores)),
        details={"samples": 0, "classical": _PAIR, "agreement": agreement},
        origins=("classical",) * _PAIR,
        corrected=tuple(corrected),
    )


def kernels_agreed_at_half(
    network: CorrectionNetwork,
    crops: FloatArray,
    pair: Sequence[FloatArray],
    halved: FloatArray,
    *,
    judge: Judge,
    progress: Progress,
) -> FoundKernels | None:
    """Correct on the crops the kernel that two searches agree on at half the size.

    Parameters
    ----------
    network, crops, pair, judge
        As of :func:`agreed_kernels`; the pair differs.
    halved : (C', h, w) float
        Crops of the photo at half its size.
    progress : Progress
        Of the two searches.

    Returns
    -------
    FoundKernels or None
        None where the two differ at half the size, too, or their kernel outgrows the frame.
    """
    searched = PmpEstimator(starts=STARTS[:_PAIR]).kernels(halved, progress=progress)
    small_judge = Judge(halved, sigma=shared_sigma(halved))
    small = agreed_kernels(network, halved, searched, small_judge)
    if small is None:
        return None
    enlarged = _enlarged(small.corrected[small.best])
    if enlarged is None:
        return None
    rival = pair[int(np.argmax(kernel_score(judge.evidence(list(pair)))))]
    better = corrected_kernel(network, crops, enlarged, [rival], sigma=judge.sigma)
    if mnc_subpixel(_halved(better), small.corrected[small.best]) < _AGREED_MNC:
        better = enlarged  # the photo at half its size contradicts the correction
    return FoundKernels(
        kernels=(enlarged,),
        probabilities=small.probabilities[:1],
        best=0,
        details={**small.details, "agreement_scale": 0.5},
        origins=("classical",),
        corrected=(better,),
    )


def _enlarged(kernel: FloatArray) -> FloatArray | None:
    """Enlarge a kernel (k, k) twofold to (63, 63), sum 1; None where it does not fit."""
    offset = ODD_PX // 2 - 2.0 * (len(kernel) // 2)  # zero displacement stays in the middle
    enlarging = np.array([[2.0, 0.0, offset], [0.0, 2.0, offset]])
    enlarged = cv2.warpAffine(kernel, enlarging, (ODD_PX, ODD_PX))
    light = float(enlarged.sum())
    if light < _LEAST_INSIDE * 4 * float(kernel.sum()):  # each pixel becomes four
        return None
    return np.asarray(enlarged / light, dtype=np.float64)


def _halved(kernel: FloatArray) -> FloatArray:
    """Bin a kernel (63, 63) to (32, 32), as pixels of a photo at half its size."""
    binned = in_frame(kernel).reshape(PSF_PX // 2, 2, PSF_PX // 2, 2)
    return np.asarray(binned.sum(axis=(1, 3)), dtype=np.float64)


def framed(kernels: Sequence[FloatArray]) -> FloatArray:
    """Kernels in frames of 64 px, (N, 64, 64)."""
    return np.stack([in_frame(kernel) for kernel in kernels])


def in_odd_frames(psfs: FloatArray) -> list[FloatArray]:
    """Cut PSFs (N, 64, 64) to odd frames of 63 px, exactly 0 off the path, sum 1."""
    odd = without_faint_light(in_frame(psfs, ODD_PX), below=DOUBT)
    return list(odd / odd.sum(axis=(1, 2), keepdims=True))
