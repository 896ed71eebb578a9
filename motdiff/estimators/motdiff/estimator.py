"""The estimator: draws from the network, the photo's own verdict on them, refinement, and an honest confidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.blind import Found, estimate_blind
from motdiff.estimators.motdiff.drawing import Drawn, draw_psfs, searched_quickly
from motdiff.estimators.motdiff.judgement import features, probabilities
from motdiff.estimators.pmp import PmpEstimator
from motdiff.estimators.pmp.blind import refine_kernel
from motdiff.estimators.pmp.score import Judge, noise_sigma
from motdiff.metrics import mnc_matrix, mnc_subpixel
from motdiff.parallel import side_by_side
from motdiff.weights import load_network

__all__ = ["MotDiffEstimator"]

FloatArray = NDArray[np.float64]

_REFINED = 3
_ROUNDS = 3
_SAME_MNC = 0.9
_UNSURE = 0.5


class MotDiffEstimator:
    """Blind estimator with the conditional diffusion model MoTDiff.

    The network draws several motions; the photo judges them together with the quick classical kernels (see
    :mod:`motdiff.estimators.pmp.score`), and the most likely ones are refined on the photo at full resolution.

    Parameters
    ----------
    weights : path, optional
        A file from ``python -m motdiff export``; the shipped one when omitted.
    samples : int
        Motions drawn.
    steps : int
        Denoising steps of each.
    refine : bool
        Whether the kernels are refined on the photo; off gives what the network says.
    seed : int
        Of the draws.
    crops : int
        Most crops used of a photo larger than one crop.
    fall_back : bool
        Whether the classical search (:class:`motdiff.estimators.pmp.PmpEstimator`) is run where the photo believes none
        of the kernels, and taken where it believes that one more.
    progress : callable, optional
        Called with the finished share 0..1.

    References
    ----------
    Choi et al., "MoTDiff: High-resolution motion trajectory estimation from a single blurred image using diffusion
    models", arXiv 2510.26173. Physics maps, judgement and refinement are ours.
    """

    largest_px = 63

    def __init__(
        self,
        *,
        weights: Path | str | None = None,
        samples: int = 8,
        steps: int = 10,
        refine: bool = True,
        seed: int = 0,
        crops: int = 3,
        fall_back: bool = True,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        for name, value in (("samples", samples), ("steps", steps), ("crops", crops)):
            if value < 1:
                raise ValueError(f"{name}: must be at least 1, got {value}")
        self._network = load_network() if weights is None else load_network(weights)
        self._samples, self._steps, self._refine = samples, steps, refine
        self._seed, self._crops, self._fall_back = seed, crops, fall_back
        self._progress = progress or (lambda _share: None)

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Estimate the motion from a blurred ``photo``, see :func:`motdiff.estimators.blind.estimate_blind`."""
        estimate = estimate_blind(photo, self, method="motdiff", most_crops=self._crops)
        self._progress(1.0)
        return estimate

    def search(self, crops: FloatArray) -> Found:
        """Draw, judge and refine kernels of the crops (C, H, W)."""
        judge = Judge(crops)
        drawn = draw_psfs(
            self._network,
            crops,
            sigma=judge.sigma,
            count=self._samples,
            steps=self._steps,
            generator=torch.Generator().manual_seed(self._seed),
        )
        self._progress(0.5)
        kernels = _candidates(drawn)
        evidence = judge.evidence(kernels)
        groups = {"samples": len(drawn.psfs), "quick": len(drawn.quick)}
        believed = probabilities(features(evidence, kernels, **groups))
        if self._refine:
            chosen = _distinct(kernels, np.argsort(-believed), most=_REFINED)
            refined = side_by_side([partial(_refined, crops, kernels[i], judge.sigma) for i in chosen])
            kernels += refined
            evidence = np.vstack([evidence, judge.evidence(refined)])
            believed = probabilities(features(evidence, kernels, **groups))
        best = int(np.argmax(believed))
        details: dict[str, object] = {
            **groups,
            "steps": self._steps,
            "sample_agreement": _agreement(drawn.psfs),
            "chosen": _origin(best, **groups),
        }
        found = Found(tuple(kernels), believed, best, details)
        return self._fallen_back(crops, found) if self._fall_back and found.confidence < _UNSURE else found

    def _fallen_back(self, crops: FloatArray, found: Found) -> Found:
        """Take the classical search's result where the photo believes it more."""
        self._progress(0.6)
        classical = PmpEstimator().search(crops)
        if classical.confidence <= found.confidence:
            return found
        details = {**found.details, "fell_back_to": "pmp"}
        warning = "the network's motions do not explain the photo well: this one is the classical search's (pmp)"
        return replace(classical, details=details, warnings=(warning,))

    def single(self, crops: FloatArray, found: Found) -> list[FloatArray]:  # noqa: ARG002, the protocol's
        """Run one quick search on each crop alone."""
        singles = []
        for crop in crops:
            light = torch.from_numpy(crop.astype(np.float32))[None, None]
            quick = searched_quickly(light, sigma=noise_sigma(crop))
            singles.append(quick[0, 0].double().numpy())
        return singles


def _candidates(drawn: Drawn) -> list[FloatArray]:
    """Gather the samples, the quick kernels, and the samples' mean, in odd frames of 63 px."""
    together = np.concatenate([drawn.psfs, drawn.quick, drawn.psfs.mean(axis=0, keepdims=True)])
    odd = together[:, 1:, 1:]
    return list(odd / odd.sum(axis=(1, 2), keepdims=True))


def _origin(index: int, *, samples: int, quick: int) -> str:
    """Tell where a candidate comes from, by its place."""
    if index < samples:
        return "sample"
    if index < samples + quick:
        return "quick"
    return "mean" if index == samples + quick else "refined"


def _distinct(kernels: list[FloatArray], order: NDArray[np.intp], *, most: int) -> list[int]:
    """First kernels of ``order`` that are not alike."""
    alike = mnc_matrix(kernels)
    chosen: list[int] = []
    for i in order:
        if all(alike[i, j] < _SAME_MNC for j in chosen):
            chosen.append(int(i))
            if len(chosen) == most:
                break
    return chosen


def _refined(crops: FloatArray, kernel: FloatArray, sigma: float) -> FloatArray:
    light = torch.from_numpy(crops.astype(np.float32))[None]
    refined = torch.from_numpy(kernel.astype(np.float32))[None]
    for _ in range(_ROUNDS):
        refined = refine_kernel(light, refined, sigma=sigma)
    return np.asarray(refined[0].double().numpy(), dtype=np.float64)


def _agreement(psfs: FloatArray) -> float:
    """Mean MNC of the samples with their mean: 1 where the network is sure."""
    mean = psfs.mean(axis=0)
    return float(np.mean([mnc_subpixel(psf, mean) for psf in psfs]))
