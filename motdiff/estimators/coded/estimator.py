"""Estimator for photos of one motion, each taken through a known code."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from motdiff.crops import LEAST_PX, textured_luminance
from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.coded.search import UNEXPLAINED, Exposures, FoundPath, find_paths
from motdiff.progress import Progress
from motdiff.psf_frame import PSF_PX
from motdiff.threads import one_thread_a_call
from motdiff.trajectory import Trajectory

__all__ = ["CodedEstimator"]

FloatArray = NDArray[np.float64]

_FULL = 0.95  # photos are brightened for the kernel search up to this
_SAME_SCENE = 0.8  # correlation of what two photos show beyond their blur
_BLUR_PX = 12.0
_KERNEL_SHARE, _FIT_SHARE = 0.45, 0.55  # of the time
_BLIND_WEIGHT, _LEAST_TRUST = 300.0, 0.15  # a blind kernel's error: about a tenth of its square
# by number of photos, on simulated walks, and the ratio of true to computed error: docs/decisions/motion-estimation.md
_SHARE_RIGHT, _ERROR_RATIO = (0.05, 0.6, 0.67, 0.93), 2.8
_MISFIT_POWER = 4.0
_ALMOST_EQUAL = 1e-3
_MOST_PATHS = 3


class CodedEstimator:
    """Find the motion that explains photos taken through known codes, with its order and direction in time.

    The kernel of each photo is searched on its own. Paths decoded from them, orders of the traced path and random
    walks are fitted to the kernels, crossed with each other, and fitted to the photos themselves where these show one
    scene: what one photo shows through the PSF of another must be what the other shows through its own.

    ``confidence`` is the probability that the order is right: the share of simulated motions of which it was, with as
    many photos through codes as ``cep calibration-set`` designs them. ``details`` hold it as ``order_confidence``, the
    expected error ``path_uncertainty_px`` (rms over time) and ``deviation_px`` at evenly spaced times. ``weights`` are
    relative among the paths found.

    Parameters
    ----------
    codes : sequence of str
        Bits of each photo's code, in the order of the photos; "1" throughout for an open shutter.
    kernels : Estimator, optional
        What finds the kernel of each photo; :class:`motdiff.estimators.pmp.PmpEstimator` when omitted.
    seed : int
        Of the random starts.
    progress : callable, optional
        Called with the finished share 0..1.

    Raises
    ------
    ValueError
        As :func:`check_codes`.
    """

    method = "coded"

    def __init__(
        self,
        codes: Sequence[str],
        *,
        kernels: Estimator | None = None,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        check_codes(codes)
        self._codes, self._kernels, self._seed, self._tell = tuple(codes), kernels, seed, progress

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Estimate the motion from one coded photo, (H, W) or (H, W, 3) float, linear light 0..1."""
        return self.estimate_from([photo])

    def estimate_from(self, photos: Sequence[ArrayLike]) -> MotionEstimate:
        """Estimate the motion from as many photos as there are codes.

        Parameters
        ----------
        photos : sequence of I (H, W) or (H, W, 3) array_like, linear light 0..1
            Of one size where they show one scene; shifts of a few px and other brightness are found.

        Returns
        -------
        MotionEstimate with ``direction`` known; other explanations follow with their weights.

        Raises
        ------
        ValueError
            If the numbers of photos and codes differ, the sizes differ, or a photo cannot be searched.
        """
        check_codes(self._codes, photos=len(photos))
        with one_thread_a_call():
            progress = Progress(self._tell)
            progress.expect(1.0)
            greys = [_grey(photo, f"photo {i}" if len(photos) > 1 else "photo") for i, photo in enumerate(photos, 1)]
            for i, grey in enumerate(greys[1:], 2):
                if grey.shape != greys[0].shape:
                    (h, w), (h0, w0) = grey.shape, greys[0].shape
                    raise ValueError(f"photo {i}: has {w} x {h} px, the first one {w0} x {h0}; give photos of one size")
            found = self._kernels_of(greys, progress)
            factor = max(_factor(one) for one in found)
            if factor > 1:  # the blur outgrew the search in one of them
                greys = [
                    np.asarray(
                        cv2.resize(grey, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA), np.float64
                    )
                    for grey in greys
                ]
                found = self._kernels_of(greys, progress)
            exposures = self._exposures(greys, found)
            rng = np.random.default_rng(self._seed)
            paths = find_paths(exposures, rng=rng, progress=progress, cost=_FIT_SHARE)
            estimate = _described(paths, exposures, found, factor)
            progress.finish()
            return estimate

    def _kernels_of(self, greys: Sequence[FloatArray], progress: Progress) -> list[MotionEstimate]:
        estimates = []
        for grey, code in zip(greys, self._codes, strict=True):
            bright = grey * max(1.0, min(len(code) / code.count("1"), _FULL / max(float(grey.max()), 1e-6)))
            estimates.append(self._estimator(progress.piece(_KERNEL_SHARE / len(greys))).estimate(bright))
        return estimates

    def _estimator(self, tell: Callable[[float], None]) -> Estimator:
        from motdiff.estimators.pmp import PmpEstimator

        return self._kernels or PmpEstimator(crops=1, progress=tell)

    def _exposures(self, greys: Sequence[FloatArray], found: Sequence[MotionEstimate]) -> Exposures:
        light = [code.count("1") for code in self._codes]
        order = sorted(range(len(light)), key=lambda i: -light[i])
        trust = np.array([found[i].confidence for i in order])
        level = np.array([greys[i].mean() / light[i] for i in order])
        return Exposures(
            codes=tuple(self._codes[i] for i in order),
            kernels=tuple(found[i].psf for i in order),
            weights=_BLIND_WEIGHT * np.clip(trust, _LEAST_TRUST, 1) ** 2,
            gains=level / level[0],
            photos=tuple(greys[i] for i in order) if _are_one_scene(greys) else (),
        )


def _grey(photo: ArrayLike, name: str) -> FloatArray:
    try:
        return textured_luminance(photo, least_px=LEAST_PX)
    except ValueError as error:
        raise ValueError(f"{name}: {str(error).removeprefix('photo: ')}") from None


def _factor(estimate: MotionEstimate) -> int:
    """How much smaller a photo was made before its kernel was found."""
    scale = estimate.details.get("scale", 1.0)
    return round(1 / scale) if isinstance(scale, float) and estimate.confidence >= 0.5 else 1


def _are_one_scene(photos: Sequence[FloatArray]) -> bool:
    """Whether all photos show the scene of the first, as far as their blur lets one see."""
    seen = [ndimage.gaussian_filter(photo, _BLUR_PX) - ndimage.gaussian_filter(photo, 4 * _BLUR_PX) for photo in photos]
    return all(np.corrcoef(seen[0].ravel(), other.ravel())[0, 1] > _SAME_SCENE for other in seen[1:])


def _described(
    paths: Sequence[FoundPath], exposures: Exposures, found: Sequence[MotionEstimate], factor: int
) -> MotionEstimate:
    best = paths[0]
    together = bool(np.isfinite(best.misfit))
    probability = _order_probability(best, len(found) if together else max(1, len(found) - 1))
    others = paths[1:_MOST_PATHS]
    shares = np.array([1 / max(other.cost / best.cost - 1, _ALMOST_EQUAL) for other in others])
    weights: tuple[float, ...] = (1.0,)
    if others:
        rest = np.minimum((1 - probability) * shares / shares.sum(), probability)  # the best one stays the likeliest
        weights = (probability, *rest.tolist())
        weights = tuple(weight / sum(weights) for weight in weights)
    trajectories = tuple(Trajectory.from_samples(factor * path.path, direction="known") for path in (best, *others))
    deviation_px = _ERROR_RATIO * factor * best.deviation_px
    error_px = float(np.sqrt((deviation_px**2).mean()))
    warnings = []
    if probability < 0.5:
        warnings.append(
            f"the order in time is uncertain (confidence {probability:.2f}): take more photos of this motion through "
            "other codes, as cep calibration-set designs them"
        )
    if best.misfit > UNEXPLAINED:
        warnings.append(
            f"the path leaves {best.misfit:.1f} times the noise unexplained: was the motion the same in each photo, "
            "and are the codes given in the order of the photos?"
        )
    if len(found) > 1 and not together:
        why = "are too small beside their blur" if exposures.photos else "show different scenes"
        warnings.append(f"the photos {why}: the path is fitted to their kernels alone, and less exact")
    return MotionEstimate(
        method="coded",
        trajectories=trajectories,
        weights=weights,
        psf=trajectories[0].psf(trajectories[0].frame_size(PSF_PX)),
        confidence=probability,
        warnings=tuple(warnings),
        details={
            "order_confidence": probability,
            "path_uncertainty_px": error_px,
            "deviation_px": deviation_px.tolist(),
            "misfit": best.misfit if np.isfinite(best.misfit) else None,
            "kernel_confidences": [one.confidence for one in found],
            "scale": 1 / factor,
        },
    )


def _order_probability(best: FoundPath, photos: int) -> float:
    """Probability that a path is the true one to within 1 px: as often as with so many photos of one scene.

    It falls with what the path leaves unexplained.
    """
    share = _SHARE_RIGHT[min(photos, len(_SHARE_RIGHT)) - 1]
    return share if np.isnan(best.misfit) else share * min(1.0, best.misfit**-_MISFIT_POWER)
