"""Agreement of two searches: where their corrected kernels are alike, nothing more is searched.

Searches that differ on the photo often agree on the photo at half its size: the blur is half as
long there, varies half as much from place to place, and noise is averaged. The kernel that they
agree on, enlarged, is corrected on the photo itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np

from motdiff.estimators.base import FoundKernels
from motdiff.estimators.kernel_score import Judge, kernel_score, probability_good
from motdiff.estimators.motdiff.correcting import corrected_kernel
from motdiff.estimators.pmp.estimator import STARTS, PmpEstimator
from motdiff.metrics import mnc_subpixel
from motdiff.network.correction import CorrectionNetwork
from motdiff.network.sampling import DOUBT
from motdiff.photo_noise import shared_sigma
from motdiff.progress import Progress
from motdiff.psf_frame import ODD_PX, PSF_PX, in_frame, without_faint_light
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

_PAIR = 2  # searches that are compared
# two corrected kernels are the photo's from this MNC and score on, and the probability of one to
# be good grows with the MNC: docs/decisions/network.md
_AGREED_MNC = 0.85
_AGREED_SCORE = 0.4
_AGREED = (15.0, -10.5)
_LEAST_INSIDE = 0.98  # share of an enlarged kernel's light within the frame


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
