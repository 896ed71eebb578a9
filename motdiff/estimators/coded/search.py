"""Search for the path of coded photos: many starts, coarse to fine, crossings of candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from torch import Tensor

from motdiff.estimators.coded.candidates import (
    EXPLAINED,
    SAME_PX,
    CandidatePath,
    Evolution,
    merged,
)
from motdiff.estimators.coded.exposures import Exposures
from motdiff.estimators.coded.fit import (
    FINEST,
    KNOTS,
    LOOSE,
    MIDDLE,
    NEAR,
    STIFF,
    PhotoFit,
    Schedule,
)
from motdiff.estimators.coded.kernel_search import KernelSearch
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
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

CLEARLY_DEARER = 40.0
"""Sum of squares by which the next path must be dearer for a search to end where two agree: of
paths with smaller gaps a third was wrong."""
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


def find_paths(
    exposures: Exposures,
    *,
    rng: np.random.Generator,
    progress: Progress | None = None,
    cost: float = 1.0,
) -> tuple[list[CandidatePath], int]:
    """Find the paths that explain the photos best.

    Photos of one scene are searched, until two searches end at one path that explains them, and
    no other is nearly as cheap, four at most; else their kernels are.

    Parameters
    ----------
    progress : Progress, optional
        Its plan holds ``cost`` for this work already.
    cost : float
        Of the work, in the unit of that plan.

    Returns
    -------
    list of CandidatePath, best first, and the number of searches that ended at the best one; 1
    where the last fits found another
    """
    progress = progress or Progress()

    def spend(share: float) -> None:
        progress.spend(share * cost)

    spectra = exposures.spectra()
    if spectra:
        return _scene_paths(exposures, spectra, rng, spend=spend)
    return KernelSearch(exposures, rng, spend=spend).run(), 1


def _scene_paths(
    exposures: Exposures,
    spectra: Sequence[SceneSpectra],
    rng: np.random.Generator,
    *,
    spend: Callable[[float], None],
) -> tuple[list[CandidatePath], int]:
    """Paths that explain photos of one scene, best first, and how many searches ended at the best.

    Searches are repeated until two of them end at one path that explains the photos, and no other
    is nearly as cheap, four at most.
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
        self,
        x: Tensor,
        costs: Tensor,
        rng: np.random.Generator,
        *,
        spend: Callable[[float], None],
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
