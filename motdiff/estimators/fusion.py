"""Fusion of several photos of one motion: their joint kernel, and each photo's agreement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from motdiff.estimators.base import FoundKernels
from motdiff.estimators.kernel_score import Judge, kernel_score
from motdiff.metrics import mnc_matrix, mnc_subpixel
from motdiff.types import FloatArray

GOOD_MNC = 0.7
"""From this MNC on, the kernel of a single photo counts as that of the motion they share."""
_OTHER_MOTION = 0.3  # by which a photo's own kernel explains it better than another motion's does
_LEAST_SHARE = 0.5  # of the largest side, that a photo must have to be searched with the others
_DOUBTED = 0.5  # most confidence where photos contradict each other and no majority decides


@dataclass(frozen=True)
class Fusion:
    """The kernel that several photos share.

    Attributes
    ----------
    joint : FoundKernels
        The joint search, its best kernel chosen among that of the search and those of the photos;
        with warnings about photos that contradict it.
    crops : (C, H, W) float
        Those of ``photos``.
    photos, left_out : tuple of int
        Indices of the photos that share it, and of those that do not.
    repeatability : tuple of float
        MNC of each photo's own kernel with the shared one, of those left out as well.
    """

    joint: FoundKernels
    crops: FloatArray
    photos: tuple[int, ...]
    left_out: tuple[int, ...]
    repeatability: tuple[float, ...]


def cut_alike(crops: Sequence[FloatArray]) -> list[FloatArray]:
    """Cut the crops (C, h, w) of several photos to one size, about their middles.

    Raises
    ------
    ValueError
        Beginning with ``photo 2:``, if a side of it is shorter than half of another photo's.
    """
    shape = tuple(min(sides) for sides in zip(*(crop.shape[1:] for crop in crops), strict=True))
    largest = max(min(crop.shape[1:]) for crop in crops)
    for i, crop in enumerate(crops, 1):
        if min(crop.shape[1:]) < _LEAST_SHARE * largest:
            raise ValueError(
                f"photo {i}: is too small to be searched with the others: needs "
                f"{int(np.ceil(_LEAST_SHARE * largest))} px on a side, got {min(crop.shape[1:])}"
            )
    cut = []
    for crop in crops:
        row, column = ((n - m) // 2 for n, m in zip(crop.shape[1:], shape, strict=True))
        cut.append(crop[:, row : row + shape[0], column : column + shape[1]])
    return cut


def fuse(
    crops: Sequence[FloatArray],
    singles: Sequence[FoundKernels],
    *,
    search: Callable[[FloatArray], FoundKernels],
    refine: Callable[[FloatArray, FloatArray], FloatArray],
) -> Fusion:
    """Find the kernel that explains several photos, each with a latent image of its own.

    Every crop has its own latent image, so that neither the scene nor a shift of the kernel needs
    to be common. The candidates are the kernel of the joint search, that of each photo alone, and
    this one refined on all photos. The score of
    :func:`motdiff.estimators.kernel_score.kernel_score`, its mean over the photos, chooses;
    agreement is the mean MNC with the photos' own kernels.

    A photo whose own kernel is unlike the shared one, and explains it clearly better, shows
    another motion. The clearest one is left out and the search repeated, as long as more than half
    of the photos are left.

    Parameters
    ----------
    crops : sequence of N (C, H, W) float
        Of each photo, of one size.
    singles : sequence of N FoundKernels
        What a search found in each photo alone.
    search : callable
        From crops (C, H, W) to what is found in them together.
    refine : callable
        From crops (C, H, W) and a kernel to the kernel fitted to them once more.
    """
    kernels = [single.best_kernel for single in singles]
    # prepared once: each photo judges the kernels of all
    judges = [Judge(photo_crops) for photo_crops in crops]

    def fused(photos: Sequence[int]) -> tuple[Fusion, dict[int, float]]:
        """Fuse some photos; the gain of its own kernel for each that shows another motion."""
        joint_crops = np.concatenate([crops[i] for i in photos])
        joint = _chosen(
            search(joint_crops),
            [singles[i] for i in photos],
            [judges[i] for i in photos],
            refine=partial(refine, joint_crops),
        )
        shared = joint.best_kernel
        alike = tuple(mnc_subpixel(kernel, shared) for kernel in kernels)
        left_out = tuple(i for i in range(len(crops)) if i not in photos)
        gains = {i: _gain(judges[i], kernels[i], shared) for i in photos if alike[i] < GOOD_MNC}
        dissenting = {i: gain for i, gain in gains.items() if gain > _OTHER_MOTION}
        return Fusion(joint, joint_crops, tuple(photos), left_out, alike), dissenting

    of_all, suspects = fused(range(len(crops)))
    result = of_all
    dissenting = suspects
    # one at a time: without the clearest, the shared kernel may come to suit the others
    while dissenting and 2 * (len(result.photos) - 1) > len(crops):
        clearest = max(dissenting, key=dissenting.__getitem__)
        result, dissenting = fused([i for i in result.photos if i != clearest])
    if dissenting:  # no majority agrees
        listed = " and ".join(f"{i + 1} (MNC {of_all.repeatability[i]:.2f})" for i in suspects)
        warnings = [
            f"photo{'s' * (len(suspects) > 1)} {listed} may show another motion, but no majority"
            " agrees: kept"
        ]
        result = of_all
        probabilities = np.minimum(of_all.joint.probabilities, _DOUBTED)
    else:
        warnings = [
            f"photo {i + 1} shows another motion (MNC {result.repeatability[i]:.2f} with the"
            " others): left out"
            for i in result.left_out
        ]
        probabilities = result.joint.probabilities
    joint = replace(
        result.joint, probabilities=probabilities, warnings=(*result.joint.warnings, *warnings)
    )
    return replace(result, joint=joint)


def _chosen(
    joint: FoundKernels,
    singles: Sequence[FoundKernels],
    judges: Sequence[Judge],
    *,
    refine: Callable[[FloatArray], FloatArray],
) -> FoundKernels:
    """Put a photo's kernel, or its refinement, for the joint search's best if it scores higher."""
    single_kernels = [single.best_kernel for single in singles]
    refined = [refine(kernel) for kernel in single_kernels]
    candidates = [joint.best_kernel, *single_kernels, *refined]
    # the mean over photos: each counts alike, however many crops it has
    evidence = np.mean([judge.evidence(candidates) for judge in judges], axis=0)
    agreement = mnc_matrix(candidates)[:, 1 : 1 + len(singles)].mean(axis=1)
    best = int(np.argmax(kernel_score(evidence, agreement)))
    if best == 0:
        return replace(joint, details={**joint.details, "fused_by": "joint search"})
    kernels = list(joint.kernels)
    probabilities = joint.probabilities.copy()
    kernels[joint.best] = candidates[best]
    origins = list(joint.origins)
    if origins:
        origins[joint.best] = "kernel of one photo"
    source = singles[(best - 1) % len(singles)]  # after the joint one: singles, then refined
    probabilities[joint.best] = max(joint.confidence, source.confidence)
    chosen = "kernel of one photo"
    if best > len(singles):
        chosen += ", refined on all"
    details = {**joint.details, "fused_by": chosen}
    return replace(
        joint,
        kernels=tuple(kernels),
        probabilities=probabilities,
        details=details,
        origins=tuple(origins),
        corrected=(),
    )


def _gain(judge: Judge, kernel: FloatArray, shared: FloatArray) -> float:
    """How much better a photo's own kernel explains it than the shared one."""
    own_score, shared_score = kernel_score(judge.evidence([kernel, shared]))
    return float(own_score - shared_score)
