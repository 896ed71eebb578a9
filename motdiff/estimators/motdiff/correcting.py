"""Correction of kernels on crops of a photo, and what corrected ones decide.

Where the corrected kernels of two searches are alike, nothing more is searched. Searches that
differ on the photo often agree on the photo at half its size: the blur is half as long there,
varies half as much from place to place, and noise is averaged. The kernel that they agree on,
enlarged, is corrected on the photo itself. Where they differ there, too, the photo alone chooses
among corrected kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from motdiff.estimators.base import FoundKernels
from motdiff.estimators.kernel_score import Judge, distinct, kernel_score, probability_good
from motdiff.estimators.pmp.estimator import STARTS, PmpEstimator
from motdiff.metrics import SAME_KERNEL_MNC, mnc_matrix, mnc_subpixel
from motdiff.network.correction import CorrectionNetwork, corrected, correction_maps
from motdiff.network.sampling import DOUBT
from motdiff.photo_noise import shared_sigma
from motdiff.progress import Progress
from motdiff.psf_frame import ODD_PX, PSF_PX, in_frame, without_faint_light
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

_PASSES = 2  # the maps of a corrected kernel hold more evidence than those of a searched one
_PAIR = 2  # searches that are compared
# two corrected kernels are the photo's from this MNC and score on, and the probability of one to
# be good grows with the MNC: docs/decisions/network.md
_AGREED_MNC = 0.85
_AGREED_SCORE = 0.4
_AGREED = (15.0, -10.5)
_LEAST_INSIDE = 0.98  # share of an enlarged kernel's light within the frame


def corrected_choice(
    network: CorrectionNetwork,
    crops: FloatArray,
    candidates: FoundKernels,
    *,
    count: int,
    skip: int = 0,
) -> FoundKernels:
    """Correct the best kernel and the likeliest different ones; choose by the photo alone.

    Their probabilities, none above that of the best before, are handed out in the order of their
    scores. Kernels that are the same as one of these before the correction are superseded: their
    probability is 0.

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

    Returns
    -------
    FoundKernels with the same kernels in the same places, some of them corrected, in frames of 63
    px.
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


def corrected_kernel(
    network: CorrectionNetwork,
    crops: FloatArray,
    kernel: FloatArray,
    rivals: Sequence[FloatArray],
    *,
    sigma: float,
) -> FloatArray:
    """Correct a kernel twice by what crops of its photo tell of it.

    Parameters
    ----------
    network : CorrectionNetwork
        In eval mode, on the CPU.
    crops : (C, H, W) float, grey, linear light
    kernel : (k, k) float, sum 1
    rivals : sequence of one or two (k', k') float, sum 1
        Kernels that the photo might have instead; their frames may differ.
    sigma : float
        Standard deviation of the noise.

    Returns
    -------
    (63, 63) float: non-negative, sum 1.
    """
    light = torch.from_numpy(crops.astype(np.float32))
    framed = torch.from_numpy(np.stack([_framed(k) for k in (kernel, *rivals)]))
    estimate = framed[:1]
    framed_rivals = framed[[1, -1]][None]  # a single one counts twice
    with torch.inference_mode():
        for _ in range(_PASSES):
            estimate = corrected(
                network, correction_maps(light[None], estimate, framed_rivals, sigma=sigma)
            )
    odd = in_frame(estimate[0].double().numpy(), ODD_PX)
    return np.asarray(odd / odd.sum(), dtype=np.float64)


def _framed(kernel: FloatArray) -> NDArray[np.float32]:
    cut = in_frame(kernel)
    return np.asarray(cut / max(float(cut.sum()), 1e-12), dtype=np.float32)


# -- agreement of two searches --------------------------------------------------------------------


def agreed_kernels(
    network: CorrectionNetwork, crops: FloatArray, pair: Sequence[FloatArray], judge: Judge
) -> FoundKernels | None:
    """Correct the kernels of two searches; None where they or the photo disagree.

    Parameters
    ----------
    network : CorrectionNetwork
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
