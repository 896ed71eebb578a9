"""Estimator for photos of one motion, each taken through a known code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.estimators.coded.candidates import (
    EXPLAINED,
    CandidatePath,
    cost_gap,
    explained_share,
    motion_of_paths,
)
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.coded.exposures import Exposures, exposures_of
from motdiff.estimators.coded.search import CLEARLY_DEARER, find_paths
from motdiff.progress import Progress
from motdiff.threads import one_thread_a_call

_KERNEL_SHARE = 0.2  # of the time
_FIT_SHARE = 0.8  # the search of the path
LARGEST_PROBABILITY = 0.97
"""More is never stated of an order in time."""
# how often the path was right, of simulated walks and shakes
# (docs/decisions/motion-estimation.md): of one photo; of more, where two searches ended at it and
# where one did, each by how much dearer the next path is: above the one limit, above the other, or
# below both
_ONE_PHOTO = 0.05
_DEARER = (75.0, CLEARLY_DEARER)
_SHARES_AGREED = (LARGEST_PROBABILITY, 0.85, 0.7)
_SHARES_ALONE = (0.8, 0.4, 0.4)
_ERROR_RATIO = 2.8  # of true to computed error
# photos of one scene that did not fit together had a wrong kernel: 0 of 7 were right
_KERNELS_ALONE = 0.3
_ALMOST_EQUAL = 1e-3  # of two costs: keeps the alternatives' shares finite
_LEAST_EXTENTS = 5.0  # of a path, in units of its expected error


class CodedEstimator:
    """Find the motion, with its order and direction in time, of photos taken through known codes.

    The kernels are searched, in photos of one scene together. Photos of one scene are then
    searched themselves, from paths that share the kernels' light and from random motions: one
    photo blurred by the PSF of another must equal the other blurred by the first's. The best are
    changed and fitted again, in searches of their own until two of them agree, and no other path
    is nearly as cheap, four at most. Where the photos show no one scene, paths decoded from the
    kernels, orders of the traced path and random walks are fitted to the kernels.

    ``confidence`` is the probability that the order is right: the share of simulated motions of
    which it was, with as many searches that agree and a next path so much dearer; less where the
    path leaves more than the noise.
    ``details`` hold it as ``order_confidence``, the expected error ``path_uncertainty_px`` (rms
    over time), ``deviation_px`` at evenly spaced times and ``searches_agreeing``. ``weights`` are
    relative among the candidate paths.

    Parameters
    ----------
    codes : sequence of str
        Bits of each photo's code, in the order of the photos; "1" throughout for an open shutter.
    kernels : Estimator, optional
        Estimator of each photo's kernel on its own; when omitted they are searched together.
    seed : int
        Of the random starts.
    progress : callable, optional
        Called with the finished share 0..1.

    Raises as :func:`check_codes`.
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
        self._codes = tuple(codes)
        self._kernels = kernels
        self._seed = seed
        self._tell = progress

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Estimate the motion of one coded photo, (H, W) or (H, W, 3), linear light 0..1."""
        return self.estimate_from([photo])

    def estimate_from(self, photos: Sequence[ArrayLike]) -> MotionEstimate:
        """Estimate the motion from as many photos as there are codes.

        Parameters
        ----------
        photos : sequence of I (H, W) or (H, W, 3) array_like, linear light 0..1
            Of one size where they show one scene; they may be shifted, and differ in brightness.

        Returns
        -------
        MotionEstimate with ``direction`` known; other explanations follow with their weights.
        Where the photos show no motion blur, a path of 0 px, with ``motion_blur`` False in its
        ``details`` and a warning.

        Raises
        ------
        ValueError
            If the numbers of photos and codes differ, the sizes differ, or a photo cannot be
            searched.
        """
        with one_thread_a_call():
            progress = Progress(self._tell)
            progress.expect(1.0)
            exposures = exposures_of(
                photos, self._codes, kernels=self._kernels, progress=progress, cost=_KERNEL_SHARE
            )
            if exposures.at_rest is not None:
                progress.finish()
                return _at_rest(exposures.at_rest, photos=len(photos))
            rng = np.random.default_rng(self._seed)
            paths, times = find_paths(exposures, rng=rng, progress=progress, cost=_FIT_SHARE)
            estimate = _described(paths, times, exposures)
            progress.finish()
            return estimate


def _at_rest(estimate: MotionEstimate, *, photos: int) -> MotionEstimate:
    """Estimate of photos without motion blur: no order, and no error of the path."""
    details = {**estimate.details, "order_confidence": None, "path_uncertainty_px": None}
    warnings = estimate.warnings if photos == 1 else ("The photos show no motion blur",)
    return replace(
        estimate,
        method=CodedEstimator.method,
        warnings=warnings,
        psf_warnings=warnings,
        details=details,
    )


def _described(paths: Sequence[CandidatePath], times: int, exposures: Exposures) -> MotionEstimate:
    best = paths[0]
    photos = len(exposures.codes)
    warnings = []
    if photos > 1 and np.isnan(best.misfit):
        reason = "are too small beside their blur" if exposures.photos else "show different scenes"
        warnings.append(
            f"the photos {reason}: the path is fitted to their kernels alone, and less exact"
        )
        photos -= 1
    probability = _order_probability(best.misfit, photos, times=times, gap=cost_gap(paths))
    deviation_px = _ERROR_RATIO * exposures.shrunk * best.deviation_px
    error_px = float(np.sqrt((deviation_px**2).mean()))
    extent_px = exposures.shrunk * float(np.hypot(*np.ptp(best.path, axis=0)))
    if extent_px < _LEAST_EXTENTS * error_px:
        probability = min(probability, _KERNELS_ALONE)
        warnings.append(
            f"the path found is {extent_px:.1f} px wide and its expected error {error_px:.1f} px:"
            " the camera may not have moved"
        )
    return motion_of_paths(
        "coded",
        paths,
        probability=probability,
        shares=[1 / max(path.cost / best.cost - 1, _ALMOST_EQUAL) for path in paths[1:]],
        deviation_px=deviation_px,
        scale=exposures.shrunk,
        warnings=warnings,
        details={
            "searches_agreeing": times,
            "cost_gap": cost_gap(paths),
            "kernel_confidences": list(exposures.confidences),
            "scale": 1 / exposures.shrunk,
        },
    )


def _order_probability(misfit: float, photos: int, *, times: int, gap: float | None) -> float:
    """Probability that the best path of so many photos is the true one to within 1 px.

    It is low where their kernels alone were fitted, and falls with the misfit; else it depends on
    how many searches ended at that path, and on how much dearer the next one is (``gap``; None
    where no search ended elsewhere).
    """
    if photos == 1:
        return _ONE_PHOTO
    if not np.isfinite(misfit):
        return _KERNELS_ALONE
    shares = _SHARES_AGREED if times > 1 else _SHARES_ALONE
    missed = sum(gap is not None and gap <= limit for limit in _DEARER)
    return shares[missed] * explained_share(misfit, EXPLAINED)
