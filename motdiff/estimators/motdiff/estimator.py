"""MoTDiff estimator: searched kernels corrected, the photo's choice among them, and drawn paths.

Searches that differ on the photo often agree on the photo at half its size: the blur is half as
long there, varies half as much from place to place, and noise is averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import torch
from scipy import special

from motdiff.estimators.base import LOST, FoundKernels
from motdiff.estimators.blind_estimator import BlindEstimator
from motdiff.estimators.kernel_score import Judge, distinct, kernel_score
from motdiff.estimators.motdiff import MotDiff
from motdiff.estimators.pmp.estimator import STARTS, PmpEstimator
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
from motdiff.weights import load_correction

# processor time of the stages, in starts of the classical search
_CORRECT_PAIR_COST = 0.6
_HALVED_COST = 2.8
_SINGLE_COST = 0.35
_CORRECT_COST = 0.3
_PATH_COST = 0.6
_PAIR = 2  # searches that are compared
_CORRECTED = 3  # kernels of several photos together
# Two corrected kernels are the photo's from this MNC and score on; docs/decisions/network.md
_AGREED_MNC = 0.85
_AGREED_SCORE = 0.4
# Log odds that a kernel is good: weights of its score and of the largest MNC of two, and offset.
_LOG_ODDS_AGREED = (6.06, 17.4, -17.8)
_LOG_ODDS_DOUBTED = (5.75, 7.19, -7.45)
_LEAST_INSIDE = 0.98  # share of an enlarged kernel's light within the frame


class MotDiffEstimator(BlindEstimator):
    """Blind estimator whose path is drawn by a diffusion model of motions.

    Two classical searches give kernels, which a network corrects by what the photo tells of them
    (:mod:`motdiff.network.correction`). Where these differ, or the photo contradicts them, two
    searches of the photo at half its size give a third. The photo chooses among them
    (:mod:`motdiff.estimators.kernel_score`). A simple motion that is as likely takes the kernel's
    place (:mod:`motdiff.estimators.simple_motion`), or a quadratic path that has it; or else paths
    are drawn for it (:mod:`motdiff.network.path_drawing`), and their likeliest order is taken.

    Parameters
    ----------
    crops, seed, progress
        As of :class:`motdiff.estimators.blind_estimator.BlindEstimator`.

    References
    ----------
    Choi et al., "MoTDiff: High-resolution motion trajectory estimation from a single blurred image
    using diffusion models", arXiv 2510.26173. There a diffusion model draws a map of the path;
    ours draws its points in time. Correction and judgement are ours.
    """

    method = MotDiff.name
    largest_px = ODD_PX
    smallest_px = MotDiff.smallest_px
    plain_mnc = 0.95  # less like, the photo has refused it

    def __init__(
        self,
        *,
        crops: int = 3,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        super().__init__(crops=crops, seed=seed, progress=progress)
        self._correction = load_correction()

    def search(
        self, crops: FloatArray, progress: Progress, halved: Callable[[], FloatArray] | None = None
    ) -> FoundKernels:
        """Search kernels of the crops (C, H, W), correct them, and let the photo choose."""
        at_the_end = _CORRECT_COST + _PATH_COST + (_SINGLE_COST if len(crops) > 1 else 0.0)
        progress.expect(_PAIR + _CORRECT_PAIR_COST + at_the_end)
        pair = PmpEstimator(starts=STARTS[:_PAIR]).kernels(crops, progress=progress)
        judge = Judge(crops, sigma=shared_sigma(crops))
        better = corrected_pair(self._correction, crops, pair, sigma=judge.sigma)
        scores = kernel_score(judge.evidence(better))
        progress.spend(_CORRECT_PAIR_COST)
        agreement = mnc_subpixel(*better)
        probabilities = probability_good(scores, agreement, _LOG_ODDS_AGREED)
        kernels = list(pair)
        origins = ["search"] * _PAIR
        agreed = agreement >= _AGREED_MNC and scores.max() >= _AGREED_SCORE
        if not agreed or probabilities.max() < LOST:
            likelier = better[int(np.argmax(scores))]
            third = None
            if halved is not None:
                third = self._third(crops, halved(), likelier, progress, sigma=judge.sigma)
            if third is not None:
                enlarged, third_corrected = third
                agreement = max(agreement, *(mnc_subpixel(third_corrected, k) for k in better))
                kernels.append(enlarged)
                better.append(third_corrected)
                origins.append("search at half the size")
                scores = kernel_score(judge.evidence(better))
            probabilities = probability_good(scores, agreement, _LOG_ODDS_DOUBTED)
        return FoundKernels(
            kernels=tuple(in_odd_frames(kernels)),
            probabilities=probabilities,
            best=int(np.argmax(scores)),
            details={"agreement": agreement},
            origins=tuple(origins),
            corrected=tuple(better),
        )

    def _third(
        self,
        crops: FloatArray,
        halved: FloatArray,
        rival: FloatArray,
        progress: Progress,
        *,
        sigma: float,
    ) -> tuple[FloatArray, FloatArray] | None:
        """Search crops of the photo at half its size twice: the better kernel, enlarged, and
        corrected beside the rival. None where it outgrows the frame.
        """
        progress.expect_more(_HALVED_COST)
        pair = PmpEstimator(starts=STARTS[:_PAIR]).kernels(halved, progress=progress)
        judge = Judge(halved, sigma=shared_sigma(halved))
        better = corrected_pair(self._correction, halved, pair, sigma=judge.sigma)
        small = better[int(np.argmax(kernel_score(judge.evidence(better))))]
        progress.spend(_HALVED_COST - _PAIR)
        enlarged = enlarged_kernel(small)
        if enlarged is None:
            return None
        third = corrected_kernel(self._correction, crops, enlarged, [rival], sigma=sigma)
        # where the photo at half its size contradicts the correction, it is not corrected
        agrees = mnc_subpixel(_halved(third), small) >= _AGREED_MNC
        return enlarged, third if agrees else enlarged

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
        """Take the corrected kernels, or correct those that several photos share; a simple motion
        as likely takes the best one's place.
        """
        if candidates.corrected:
            better = replace(candidates, kernels=candidates.corrected)
        else:
            better = corrected_choice(self._correction, crops, candidates, count=_CORRECTED)
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


def probability_good(
    scores: FloatArray, agreement: float, log_odds: tuple[float, float, float]
) -> FloatArray:
    """Probability (K,) of corrected kernels to have a sub-pixel MNC of 0.7 or more.

    Parameters
    ----------
    scores : (K,) float
    agreement : float
        Largest MNC of two of the kernels.
    log_odds : tuple of float
        Weights of both, and offset.
    """
    by_score, by_agreement, offset = log_odds
    return np.asarray(
        special.expit(by_score * scores + by_agreement * agreement + offset), dtype=np.float64
    )


def corrected_choice(
    network: CorrectionNetwork,
    crops: FloatArray,
    candidates: FoundKernels,
    *,
    count: int,
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
    """
    judge = Judge(crops)
    kernels = list(candidates.kernels)
    probabilities = candidates.probabilities.copy()
    likely = [int(i) for i in np.argsort(-probabilities)]
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


def corrected_pair(
    network: CorrectionNetwork, crops: FloatArray, pair: Sequence[FloatArray], *, sigma: float
) -> list[FloatArray]:
    """Correct the kernels of two searches in the crops (C, H, W), each beside the other."""
    return side_by_side(
        [
            partial(corrected_kernel, network, crops, kernel, [rival], sigma=sigma)
            for kernel, rival in (pair, pair[::-1])
        ]
    )


def enlarged_kernel(kernel: FloatArray) -> FloatArray | None:
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


def in_odd_frames(kernels: Sequence[FloatArray]) -> list[FloatArray]:
    """Kernels in frames of 63 px, exactly 0 off the path, sum 1."""
    bright = [without_faint_light(in_frame(kernel, ODD_PX), below=DOUBT) for kernel in kernels]
    return [kernel / kernel.sum() for kernel in bright]
