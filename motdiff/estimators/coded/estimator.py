"""Estimator for photos of one motion through known codes, and its search in those of one scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.estimators.coded.candidates import (
    EXPLAINED,
    SAME_PX,
    CandidatePath,
    Evolution,
    cost_gap,
    explained_share,
    merged,
    motion_of_paths,
)
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.coded.exposures import Exposures, exposures_of
from motdiff.estimators.coded.fit import (
    FINEST,
    KNOTS,
    LOOSE,
    MIDDLE,
    NEAR,
    STIFF,
    KernelSearch,
    PhotoFit,
    Schedule,
)
from motdiff.estimators.coded.path_measure import PathMeasure
from motdiff.estimators.coded.scene_term import SceneSpectra
from motdiff.estimators.coded.starts import (
    bridged,
    crossed,
    loops_reordered,
    random_sweeps,
    random_walks,
)
from motdiff.metrics import rms_distance_px
from motdiff.progress import Progress
from motdiff.threads import one_thread_a_call, side_by_side
from motdiff.types import FloatArray

CLEARLY_DEARER = 40.0
"""Sum of squares by which the next path must be dearer for a search to end where two agree: of
paths with smaller gaps a third was wrong."""
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
_FEW_KNOTS = 27  # half as many unknowns make a step twice as cheap
_DRAWS = 64  # starts of a search from the kernels' light
_LONE_WALKS = 32  # and without it
_LONE_SWEEPS = 64
_USUAL_PX = 50.0  # length of random walks, and largest extent of sweeps
_SEARCHES_AT_ONCE = 2
_MOST_SEARCHES = 4
_LOOSE_STARTS: Schedule = ((LOOSE, 4, 24),)
_STIFF_STARTS: Schedule = ((STIFF, 8, 12),)
_STARTS: Schedule = ((MIDDLE, 2, 32), (MIDDLE, 3, 16), (NEAR, 2, 12), (FINEST, 4, 8))
# more rounds and patience, as each round changes less
_EVOLUTION = Evolution(rounds=20, patience=5, improved=0.998, population=8)
_CHILDREN = 32  # of a round
_CHILD_FIT: Schedule = ((MIDDLE, 4, 16), (MIDDLE, 4, 12), (NEAR, 3, 8), (FINEST, 4, 8))
_RESULTS = 6  # handed on with all knots
_LAST: Schedule = ((FINEST, 4, 4), (FINEST, 21, 4))
# of the children, roughly by how many were cheaper than the best path; what cannot be is bridged
_CHILD_SHARES = {
    "rerouted": 0.17,
    "exchanged": 0.37,
    "reordered": 0.13,
    "crossed": 0.2,
    "bridged": 0.13,
}


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

            def spend(share: float) -> None:
                progress.spend(share * _FIT_SHARE)

            spectra = exposures.spectra()
            if spectra:
                paths, times = _scene_paths(exposures, spectra, rng, spend=spend)
            else:
                paths, times = KernelSearch(exposures, rng, spend=spend).run(), 1
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


def _scene_paths(
    exposures: Exposures,
    spectra: Sequence[SceneSpectra],
    rng: np.random.Generator,
    *,
    spend: Callable[[float], None],
) -> tuple[list[CandidatePath], int]:
    """Paths that explain photos of one scene, best first; how many searches ended at the best.

    That number is 1 where the last fits found another path than the searches.
    """
    search = _SceneSearch(exposures, spectra)
    share = 0.7 / _MOST_SEARCHES
    results: list[tuple[Tensor, Tensor]] = []
    is_agreed = False
    while not is_agreed and len(results) < _MOST_SEARCHES:
        searches = [
            partial(search.run, generator, spend=lambda s: spend(share * s))
            for generator in rng.spawn(_SEARCHES_AT_ONCE)
        ]
        results += side_by_side(searches)
        x, costs, times = merged(search.unknowns, results, keep=_RESULTS, same_px=SAME_PX)
        # paths nearly as cheap may be one search's fault: a path cheaper than both is often missed
        is_clear = len(costs) == 1 or float(costs[1] - costs[0]) > CLEARLY_DEARER
        is_agreed = times > 1 and is_clear and search.misfit(x[:1]) <= EXPLAINED
    spend(share * (_MOST_SEARCHES - len(results)))
    fine = PhotoFit(exposures, spectra)
    searched_path = fine.paths(search.unknowns.resampled(x[:1], KNOTS))[0]
    if is_agreed:
        spend(0.15)
    else:  # what each of them has right may belong together
        x, costs = search.fitted(x, ((FINEST, 2, _RESULTS),))
        x, _ = search.evolved(x, costs, rng, spend=lambda s: spend(0.15 * s))
        x = x[:_RESULTS]
    x, costs = fine.fitted(search.unknowns.resampled(x, KNOTS), _LAST)
    spend(0.15)
    paths = fine.described(fine.beside_photos(FINEST), x, costs)
    # changed, or with more knots, another path may be the best, at which no other search ended
    return paths, times if rms_distance_px(paths[0].path, searched_path) < SAME_PX else 1


class _SceneSearch(PhotoFit):
    """Search of a path that explains photos of one scene, with few knots.

    Only the finest stage tells the right path, as wrong ones differ most beyond 0.16 cycles/px.
    """

    def __init__(self, exposures: Exposures, spectra: Sequence[SceneSpectra]) -> None:
        super().__init__(exposures, spectra, knots=_FEW_KNOTS)
        self.measure = PathMeasure(exposures.kernels, exposures.codes)

    def run(
        self, rng: np.random.Generator, *, spend: Callable[[float], None]
    ) -> tuple[Tensor, Tensor]:
        """Candidates and costs, best first, from draws and random motions."""
        walks = self._walks(rng, _LONE_WALKS)
        sweeps = random_sweeps(rng, self.knots, _USUAL_PX * rng.uniform(0.1, 1.0, _LONE_SWEEPS))
        random = self.registered(np.concatenate([walks, sweeps]))
        from_light = self.registered(self.measure.draw(_DRAWS, knots=self.knots, rng=rng))
        loose, _ = self.fitted(torch.cat([from_light, random]), _LOOSE_STARTS)
        stiff, _ = self.fitted(random, _STIFF_STARTS)
        x, costs = self.fitted(torch.cat([loose, stiff, from_light]), _STARTS)
        spend(0.2)
        return self.evolved(x, costs, rng, spend=lambda s: spend(0.8 * s))

    def evolved(
        self, x: Tensor, costs: Tensor, rng: np.random.Generator, *, spend: Callable[[float], None]
    ) -> tuple[Tensor, Tensor]:
        """Candidates and costs, best first, after changes of the best ones while that helps."""

        def changed(parents: Tensor) -> tuple[Tensor, Tensor]:
            children = self._children(self.paths(parents), rng)
            return self.fitted(self.registered(children), _CHILD_FIT)

        return _EVOLUTION.run(self.unknowns, x, costs, changed=changed, spend=spend)

    def _children(self, paths: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Change parents drawn from (N, K, 2), the first likelier.

        A stretch is led through the light that the rest of the path leaves, two stretches exchange
        theirs, loops come in another order, a stretch of another path is taken, or one drawn anew
        between its ends.
        """
        chance = np.exp(-0.3 * np.arange(len(paths)))
        parents = rng.choice(len(paths), _CHILDREN, p=chance / chance.sum())
        kinds = rng.choice(list(_CHILD_SHARES), _CHILDREN, p=list(_CHILD_SHARES.values()))
        children = []
        for path, kind in zip(paths[parents], kinds, strict=True):
            child = None
            if kind == "rerouted":
                child = self.measure.rerouted(path, rng=rng)
            elif kind == "exchanged":
                child = self.measure.exchanged(path, rng=rng)
            elif kind == "reordered":
                child = loops_reordered(path, rng=rng)
            elif kind == "crossed":
                child = crossed(path, paths[rng.integers(len(paths))], rng=rng)
            if child is None:
                child = bridged(path, self._walks(rng, 1)[0], rng=rng)
            children.append(child)
        return np.stack(children)

    def _walks(self, rng: np.random.Generator, count: int) -> FloatArray:
        return random_walks(rng, self.knots, _USUAL_PX * rng.uniform(0.5, 1.5, count))
