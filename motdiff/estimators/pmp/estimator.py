"""Blind estimation of the motion in a photo of any size: several starts, one choice, an honest confidence."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from motdiff.crops import blur_differs_warning, luminance, pick_crops
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.pmp.blind import PmpSettings, estimate_kernels, refine_kernel
from motdiff.estimators.pmp.kernel import without_specks
from motdiff.estimators.pmp.score import Ranking, noise_sigma, rank_kernels
from motdiff.metrics import mnc_subpixel
from motdiff.tracing import trace_psf_to_trajectory
from motdiff.trajectory import Trajectory

__all__ = ["STARTS", "PmpEstimator", "Start"]

FloatArray = NDArray[np.float64]

_CROP_PX = 256
_SMALLEST_PX = 48
_FRAME_PX = 64
_LARGEST_EXTENT = 0.8  # of the largest start: beyond, the photo is halved and tried again
_LEVELS = 3
_REFINEMENTS = 4
_FAINT = 0.05
_SAME_MNC = 0.8
_MOST_MOTIONS = 3
_LOST = 0.5
_CLEARLY = 0.05  # a halved photo is less noisy, so its confidence comes out higher by itself


@dataclass(frozen=True)
class Start:
    """One run of the blind search.

    Attributes
    ----------
    size : int
        Odd side of the kernel frame, px.
    quarter_turns : int
        The photo is turned by so many right angles, and the kernel turned back: another path to the optimum.
    sparsity : float
        Weight of the kernel's sum: low where a strong one would shrink a long path to a dot.
    gradient_weight : float
        Weight of the gradient count: high keeps only the strongest edges.
    """

    size: int
    quarter_turns: int = 0
    sparsity: float = 3.0
    gradient_weight: float = 8e-3


STARTS = (
    Start(39, sparsity=1.0, gradient_weight=1.5e-2),
    Start(53, sparsity=0.5),
    Start(29, quarter_turns=1, sparsity=1.0),
    Start(29),
    Start(47, quarter_turns=1, sparsity=0.5, gradient_weight=2e-2),
)
"""The five of 13 tried that lose 0.003 MNC to all of them together."""


@dataclass(frozen=True)
class _Level:
    """What one scale of the photo gave."""

    factor: int
    crops: FloatArray
    kernels: tuple[FloatArray, ...]
    ranking: Ranking


class PmpEstimator:
    """Blind estimator with the patch-wise minimal pixels prior.

    Every start runs on the same crops, which share one kernel; the ranking of :mod:`motdiff.estimators.pmp.score`
    chooses. ``confidence`` is the probability that the chosen kernel has a sub-pixel MNC of 0.7 or more, fitted on
    simulated photos. Where the blur outgrows the largest start, or is lost in a large photo, the photo is halved and
    tried again.

    Parameters
    ----------
    starts : sequence of Start
    crops : int
        Most crops used of a photo larger than one crop.
    device : str
        Torch device of the search.
    progress : callable, optional
        Called with the finished share 0..1.

    References
    ----------
    Wen et al., IEEE TCSVT 2021 (the prior); Hu and Yang, ECCV 2012 (crops).
    """

    def __init__(
        self,
        *,
        starts: tuple[Start, ...] = STARTS,
        crops: int = 3,
        device: str = "cpu",
        progress: Callable[[float], None] | None = None,
    ) -> None:
        if not starts:
            raise ValueError("starts: need at least one")
        if crops < 1:
            raise ValueError(f"crops: must be at least 1, got {crops}")
        self._starts, self._crops, self._device = starts, crops, device
        self._progress = progress or (lambda _share: None)

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Estimate the motion from a blurred ``photo``.

        Parameters
        ----------
        photo : (H, W) or (H, W, 3) array_like, linear light 0..1

        Returns
        -------
        MotionEstimate with ``direction`` unknown; distinct kernels of other starts follow as alternatives.

        Raises
        ------
        ValueError
            If the photo is smaller than 48 px, not finite, or constant.
        """
        grey = luminance(photo)
        if min(grey.shape) < _SMALLEST_PX:
            raise ValueError(
                f"photo: needs at least {_SMALLEST_PX} x {_SMALLEST_PX} px, got {grey.shape[1]} x {grey.shape[0]}"
            )
        if np.ptp(grey) == 0:
            raise ValueError("photo: is constant; motion shows only where the scene has texture")
        level = self._level(grey, 1)
        while level.factor < 2 ** (_LEVELS - 1) and self._wants_halving(level, min(grey.shape) // level.factor):
            factor = level.factor * 2
            smaller = cv2.resize(grey, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
            coarser = self._level(np.asarray(smaller, dtype=np.float64), factor)
            if coarser.ranking.confidence < max(_LOST, level.ranking.confidence + _CLEARLY):
                break
            level = coarser
        estimate = _described(level, self._one_blur(level))
        self._progress(1.0)
        return estimate

    def _level(self, grey: FloatArray, factor: int) -> _Level:
        size = min(_CROP_PX, *grey.shape)
        whole = max(grey.shape) <= 1.25 * _CROP_PX
        corners = [(0, 0)] if whole else pick_crops(grey, size=size, count=self._crops)
        crops = np.stack([grey if whole else grey[r : r + size, c : c + size] for r, c in corners])
        kernels = self._run_all([(crops, start) for start in self._starts], self._tell)
        ranking = rank_kernels(crops, kernels)
        kernels[ranking.best] = self._refined(crops, kernels[ranking.best])
        return _Level(factor, crops, tuple(kernels), ranking)

    def _tell(self, finished: int) -> None:
        self._progress(0.8 * finished / len(self._starts))

    def _run_all(
        self, jobs: list[tuple[FloatArray, Start]], tell: Callable[[int], None] = lambda _finished: None
    ) -> list[FloatArray]:
        """Run the searches side by side, one thread each: their arrays are too small to share one."""
        workers = min(len(jobs), os.cpu_count() or 1) if self._device == "cpu" else 1
        threads = torch.get_num_threads()
        kernels = []
        try:
            with ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,)) as pool:
                runs = [pool.submit(self._run, *job) for job in jobs]
                try:
                    for run in runs:
                        kernels.append(run.result())
                        tell(len(kernels))
                except BaseException:  # Ctrl-C: do not start what still waits
                    pool.shutdown(wait=False, cancel_futures=True)
                    raise
        finally:
            torch.set_num_threads(threads)
        return kernels

    def _run(self, crops: FloatArray, start: Start) -> FloatArray:
        turned = np.rot90(crops, start.quarter_turns, axes=(1, 2)).astype(np.float32)
        batch = torch.from_numpy(np.ascontiguousarray(turned))[None].to(self._device)
        settings = PmpSettings.for_noise(_sigma(crops))
        settings = replace(settings, sparsity=start.sparsity, gradient_weight=start.gradient_weight)
        size = min(start.size, (min(crops.shape[1:]) // 2) * 2 - 1)
        with torch.no_grad():
            kernel = estimate_kernels(batch, size=size, settings=settings)[0].cpu().numpy()
        return np.ascontiguousarray(np.rot90(kernel, -start.quarter_turns), dtype=np.float64)

    def _refined(self, crops: FloatArray, kernel: FloatArray) -> FloatArray:
        batch = torch.from_numpy(crops.astype(np.float32))[None].to(self._device)
        refined = torch.from_numpy(kernel.astype(np.float32))[None].to(self._device)
        sigma = _sigma(crops)
        with torch.no_grad():
            for _ in range(_REFINEMENTS):
                refined = refine_kernel(batch, refined, sigma=sigma)
        return np.asarray(refined[0].cpu().numpy(), dtype=np.float64)

    def _wants_halving(self, level: _Level, side_px: int) -> bool:
        """Tell whether the blur outgrew the starts, or is lost in a photo with pixels to spare."""
        y, x = np.nonzero(level.kernels[level.ranking.best])
        outgrown = max(np.ptp(y), np.ptp(x)) + 1 > _LARGEST_EXTENT * max(start.size for start in self._starts)
        lost = level.ranking.confidence < _LOST and side_px >= 2 * _CROP_PX
        return bool((outgrown and side_px >= 4 * _SMALLEST_PX) or lost)

    def _one_blur(self, level: _Level) -> str | None:
        """Warn when single crops disagree about the blur."""
        if len(level.crops) < 2:
            return None
        start = self._starts[level.ranking.best]
        return blur_differs_warning(self._run_all([(crop[None], start) for crop in level.crops]))


def _described(level: _Level, uneven: str | None) -> MotionEstimate:
    ranking, kernels = level.ranking, level.kernels
    chosen = [ranking.best]
    for i in np.argsort(-ranking.probabilities):
        if len(chosen) < _MOST_MOTIONS and all(mnc_subpixel(kernels[i], kernels[j]) < _SAME_MNC for j in chosen):
            chosen.append(int(i))
    trajectories = [trace_psf_to_trajectory(_without_faint_parts(kernels[i])) for i in chosen]
    if level.factor > 1:
        trajectories = [trajectory.scaled(level.factor) for trajectory in trajectories]
    weights = ranking.probabilities[chosen] / ranking.probabilities[chosen].sum()
    psf = _framed(kernels[ranking.best]) if level.factor == 1 else _psf_of(trajectories[0])
    warnings = [] if uneven is None else [uneven]
    if ranking.confidence < _LOST:
        warnings.append(
            f"the blind estimate is probably lost (confidence {ranking.confidence:.2f}): "
            "take a photo with more texture, or use the methods reference or point"
        )
    if level.factor > 1:
        warnings.append(f"the motion was estimated on the photo at 1/{level.factor} of its size, where it shows better")
    return MotionEstimate(
        method="pmp",
        trajectories=tuple(trajectories),
        weights=tuple(float(w) for w in weights),
        psf=psf,
        confidence=ranking.confidence,
        warnings=tuple(warnings),
        details={
            "crops": len(level.crops),
            "scale": 1 / level.factor,
            "starts": len(kernels),
            "agreement": ranking.agreement,
            "trajectory_psf_mnc": mnc_subpixel(psf, _psf_of(trajectories[0])),
        },
    )


def _sigma(crops: FloatArray) -> float:
    return float(np.median([noise_sigma(crop) for crop in crops]))


def _without_faint_parts(kernel: FloatArray) -> FloatArray:
    """Kernel without what is below 5 % of its peak: noise there draws side branches that lengthen the path."""
    kept = np.where(kernel < _FAINT * kernel.max(), 0.0, kernel)
    return np.asarray(without_specks(torch.from_numpy(kept)[None])[0].numpy(), dtype=np.float64)


def _psf_of(trajectory: Trajectory) -> FloatArray:
    return trajectory.psf(max(_FRAME_PX, trajectory.frame_size()))


def _framed(kernel: FloatArray) -> FloatArray:
    """Put an odd kernel into the 64-px frame, zero displacement at index 32."""
    side = max(_FRAME_PX, kernel.shape[0] + 1)
    low = side // 2 - kernel.shape[0] // 2
    psf = np.zeros((side, side))
    psf[low : low + kernel.shape[0], low : low + kernel.shape[1]] = kernel
    return np.asarray(psf / psf.sum(), dtype=np.float64)
