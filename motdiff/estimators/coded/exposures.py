"""Photos of one motion through known codes, each with its kernel, weight and gain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median_low

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy import fft, ndimage, signal

from motdiff.crops import best_windows, pick_crops
from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.coded.scene_term import SceneSpectra, scene_side_px, scene_spectra
from motdiff.estimators.kernel_score import rank_kernels
from motdiff.estimators.pmp.estimator import STARTS, PmpEstimator, searched_kernels
from motdiff.photo_noise import LEAST_SIGMA, noise_sigma
from motdiff.photo_values import LEAST_PX, numbered_photo, textured_luminance
from motdiff.progress import Progress
from motdiff.psf_frame import PSF_PX, in_frame
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

BLIND_WEIGHT = 300.0
"""Weight of a kernel found blind: its squared error is about a tenth of it."""
_SAME_SCENE = 0.8  # correlation of two photos beyond their blur
# the same of photos shifted until they fit best: of 159 pairs of other scenes, 128 to 256 px, none
# had as much, of one scene nearly all
_SAME_SCENE_SHIFTED = 0.9
_BLUR_PX = 12.0  # sigma: beyond it, blurs of the usual length hardly show
_TRUSTED = 0.5  # confidence in a kernel
_LEAST_TRUST = 0.15  # confidence: no kernel is left out altogether
_FARTHEST = 4  # photos of one scene are shifted by less than such a part of their size
_LEAST_INSIDE_PX = 64  # of a photo without its borders
_FAINTEST = 1e-4  # of the largest noise power expected: below it, rounding is compared


@dataclass(frozen=True)
class Exposures:
    """Photos of one motion, that with the most light first.

    Attributes
    ----------
    codes : tuple of I str
    kernels : tuple of I (S, S) float
        Estimated in each photo alone.
    weights : (I,) float
        Inverse of the relative squared error expected of each kernel, times the values that it is
        spread over.
    gains : (I,) float
        Brightness of each photo against the first, beyond what the codes explain.
    photos : tuple of I (H, W) float, or empty
        Photos of one scene, aligned to within a few px; empty where the scenes differ.
    shrunk : int
        Factor by which the photos were made smaller: a path of theirs is that much shorter.
    confidences : tuple of I float
        Of the kernels.
    at_rest : MotionEstimate or None
        Estimate of a sharp photo where all photos are sharp, or those with the shutter open
        throughout.
    """

    codes: tuple[str, ...]
    kernels: tuple[FloatArray, ...]
    weights: FloatArray
    gains: FloatArray
    photos: tuple[FloatArray, ...] = ()
    shrunk: int = 1
    confidences: tuple[float, ...] = ()
    at_rest: MotionEstimate | None = None

    def spectra(self) -> list[SceneSpectra]:
        """Spectra on three grids, coarse to fine; none without one scene large enough."""
        if len(self.photos) < 2:
            return []
        indices = zip(*(np.nonzero(kernel) for kernel in self.kernels), strict=True)
        extent_px = max(np.ptp(np.concatenate(axis)) for axis in indices)
        margin_px = int(np.ceil(0.5 * extent_px)) + 10
        side = scene_side_px(self.photos[0].shape)
        if side - 2 * margin_px < _LEAST_INSIDE_PX:
            return []
        row, column = pick_crops(self.photos[0], size=side, count=1)[0]  # of the most texture
        crops = [photo[row : row + side, column : column + side] for photo in self.photos]
        return scene_spectra(crops, grids=[side // n for n in (6, 3, 2)], margin_px=margin_px)


def exposures_of(
    photos: Sequence[ArrayLike],
    codes: Sequence[str],
    *,
    kernels: Estimator | None = None,
    progress: Progress | None = None,
    cost: float = 1.0,
) -> Exposures:
    """Estimate the photos' kernels, together where they show one scene, else each on its own.

    Parameters
    ----------
    photos : sequence of I (H, W) or (H, W, 3) array_like, linear light 0..1
    codes : sequence of I str
    kernels : Estimator, optional
        Estimator of the kernel of each photo on its own; when omitted PMP, and the photos of one
        scene together.
    progress : Progress, optional
        Its plan holds ``cost`` for this work already.

    Raises
    ------
    ValueError
        If the numbers of photos and codes differ, the sizes differ, or a photo cannot be searched.
    """
    check_codes(codes, photos=len(photos))
    progress = progress or Progress()
    greys = []
    for i, photo in enumerate(photos, 1):
        with numbered_photo(i, count=len(photos)):
            greys.append(textured_luminance(photo, least_px=LEAST_PX))
    for i, grey in enumerate(greys[1:], 2):
        if grey.shape != greys[0].shape:
            (h, w), (h0, w0) = grey.shape, greys[0].shape
            raise ValueError(
                f"photo {i}: has {w} x {h} px, the first one {w0} x {h0}; give photos of one size"
            )
    is_one_scene = len(greys) > 1 and _are_one_scene(greys, _SAME_SCENE)
    if len(greys) > 1 and not is_one_scene:  # they may be shifted by more than a few px
        aligned = _aligned(greys)
        is_one_scene = min(aligned[0].shape) >= LEAST_PX and _are_one_scene(
            aligned, _SAME_SCENE_SHIFTED
        )
        greys = aligned if is_one_scene else greys
    is_joint = is_one_scene and kernels is None
    # beside the joint search these tell the blur's extent, and whether the camera was at rest
    open_photos = [i for i, code in enumerate(codes) if "0" not in code]
    searched = open_photos if is_joint and open_photos else list(range(len(codes)))
    joint_cost = 0.5 * cost if is_joint else 0.0
    estimates = _kernels_of([greys[i] for i in searched], kernels, progress, cost - joint_cost)
    # one motion: a kernel much larger than the others is wrong
    shrunk = median_low(map(_shrunk, estimates))
    decisive = [estimates[searched.index(i)] for i in open_photos] or estimates
    is_at_rest = all(estimate.details.get("motion_blur") is False for estimate in decisive)
    if shrunk > 1:  # the blur outgrew the search
        size = (greys[0].shape[1] // shrunk, greys[0].shape[0] // shrunk)
        greys = [
            np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.float64)
            for grey in greys
        ]
        if not is_joint:
            progress.expect_more(cost)
            estimates = _kernels_of(greys, kernels, progress, cost)
    light = [code.count("1") for code in codes]
    order = sorted(range(len(light)), key=lambda i: -light[i])
    greys = [greys[i] for i in order]
    if is_joint:
        psfs, confidences = kernels_of_one_scene(greys, progress=progress, cost=joint_cost)
    else:
        psfs = tuple(estimates[i].psf for i in order)
        confidences = tuple(estimates[i].confidence for i in order)
    level = np.array([grey.mean() / light[i] for grey, i in zip(greys, order, strict=True)])
    return Exposures(
        codes=tuple(codes[i] for i in order),
        kernels=psfs,
        weights=BLIND_WEIGHT * np.clip(np.array(confidences), _LEAST_TRUST, 1) ** 2,
        gains=level / level[0],
        photos=tuple(greys) if is_one_scene else (),
        shrunk=shrunk,
        confidences=confidences,
        at_rest=decisive[0] if is_at_rest else None,
    )


def _kernels_of(
    greys: Sequence[FloatArray], kernels: Estimator | None, progress: Progress, cost: float
) -> list[MotionEstimate]:
    def estimator(on_progress: Callable[[float], None]) -> Estimator:
        return kernels or PmpEstimator(crops=1, progress=on_progress)

    return [estimator(progress.piece(cost / len(greys))).estimate(grey) for grey in greys]


def _shrunk(estimate: MotionEstimate) -> int:
    """Factor by which a photo was made smaller for its kernel."""
    scale = estimate.details.get("scale", 1.0)
    if isinstance(scale, float) and estimate.confidence >= _TRUSTED:
        return round(1 / scale)
    return 1


def _are_one_scene(photos: Sequence[FloatArray], least_correlation: float) -> bool:
    """Whether all photos show the scene of the first, by details coarser than their blur."""
    coarse = [_coarse(photo).ravel() for photo in photos]
    return all(np.corrcoef(coarse[0], values)[0, 1] > least_correlation for values in coarse[1:])


def _aligned(photos: Sequence[FloatArray]) -> list[FloatArray]:
    """Part of each photo (h, w) that all show, where their coarse details lie on each other."""
    coarse = [_coarse(photo).astype(np.float32) for photo in photos]
    size = np.array(coarse[0].shape)
    margin = size // _FARTHEST
    shifts = [margin * 0]
    for image in coarse[1:]:  # the middle of each is found in the first
        rows, columns = (slice(m, n - m) for m, n in zip(margin, size, strict=True))
        match = cv2.matchTemplate(coarse[0], image[rows, columns], cv2.TM_CCOEFF_NORMED)
        shifts.append(margin - np.unravel_index(match.argmax(), match.shape))
    starts = np.array(shifts) - np.min(shifts, axis=0)
    height, width = size - starts.max(axis=0)
    return [
        photo[row : row + height, column : column + width]
        for photo, (row, column) in zip(photos, starts, strict=True)
    ]


def _coarse(photo: FloatArray) -> FloatArray:
    blurred = ndimage.gaussian_filter(photo, _BLUR_PX)
    return np.asarray(blurred - ndimage.gaussian_filter(photo, 4 * _BLUR_PX))


def kernels_of_one_scene(
    photos: Sequence[FloatArray], *, progress: Progress | None = None, cost: float = 1.0
) -> tuple[tuple[FloatArray, ...], tuple[float, ...]]:
    """Search the kernels of photos of one scene, aligned to a few px, in the photos together.

    What one kernel extinguishes another lets through, so the latent photo and with it each kernel
    is known better than from a photo alone. Of several starts the one whose kernels agree best
    with the photos is chosen: ``k_1 * y_i = k_i * y_1``, whatever the scene.

    Parameters
    ----------
    photos : sequence of I >= 2 (H, W) float
    progress : Progress, optional
        Its plan holds ``cost`` for this work already.

    Returns
    -------
    I kernels (64, 64), sum 1, whose shifts against each other are the photos', and the
    probability that each is good

    References
    ----------
    Xu, Liu, Tong and Kailath, "A least-squares approach to blind channel identification", IEEE
    TSP 43(12), 1995 (the cross relation).
    """
    progress = progress or Progress()
    window = best_windows(photos[0], count=1)[0]
    level = photos[0].mean()
    crops = np.stack([photo[window] * (level / photo.mean()) for photo in photos])
    sigmas = np.maximum([noise_sigma(crop) for crop in crops], LEAST_SIGMA)
    piece = cost / len(STARTS)
    searches = side_by_side(
        [
            partial(
                searched_kernels,
                crops[:, None],
                start,
                sigma=float(np.median(sigmas)),
                one_scene=True,
                on_progress=progress.piece(piece),
            )
            for start in STARTS
        ]
    )
    kernels = min(searches, key=lambda candidates: _cross_misfit(crops, candidates, sigmas))
    confidences = [
        float(rank_kernels(crop[None], [kernel]).probabilities[0])
        for crop, kernel in zip(crops, kernels, strict=True)
    ]
    return tuple(in_frame(kernel, PSF_PX) for kernel in kernels), tuple(confidences)


def _cross_misfit(crops: FloatArray, kernels: FloatArray, sigmas: FloatArray) -> float:
    """Mean power of ``k_1 * y_i - k_i * y_1`` over that of the noise in it; about 1 to 2 if right.

    Within the frame, so that no border counts, and through a window.
    """
    ratios = []
    for crop, kernel, sigma in zip(crops[1:], kernels[1:], sigmas[1:], strict=True):
        difference = signal.fftconvolve(crop, kernels[0], "valid")
        difference -= signal.fftconvolve(crops[0], kernel, "valid")
        shape = difference.shape
        window = np.hanning(shape[0] + 2)[1:-1, None] * np.hanning(shape[1] + 2)[1:-1]
        power = np.abs(fft.fft2(difference * window)) ** 2 / np.square(window).sum()
        noise = sum(
            deviation**2 * np.abs(fft.fft2(through, shape)) ** 2
            for deviation, through in ((sigma, kernels[0]), (sigmas[0], kernel))
        )
        ratios.append(np.mean(power / (noise + _FAINTEST * noise.max())))
    return float(np.mean(ratios))
