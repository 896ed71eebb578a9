"""Correction of kernels on crops of a photo, and the choice among corrected ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from motdiff.estimators.base import FoundKernels
from motdiff.estimators.kernel_score import Judge, distinct, kernel_score
from motdiff.metrics import SAME_KERNEL_MNC, mnc_matrix
from motdiff.network.correction import CorrectionNetwork, corrected, correction_maps
from motdiff.psf_frame import ODD_PX, in_frame
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

_PASSES = 2  # the maps of a corrected kernel hold more evidence than those of a searched one


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
                network, correction_maps(light, estimate, framed_rivals, sigma=sigma)
            )
    odd = in_frame(estimate[0].double().numpy(), ODD_PX)
    return np.asarray(odd / odd.sum(), dtype=np.float64)


def _framed(kernel: FloatArray) -> NDArray[np.float32]:
    cut = in_frame(kernel)
    return np.asarray(cut / max(float(cut.sum()), 1e-12), dtype=np.float32)
