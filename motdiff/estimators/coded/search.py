"""Search for the path of coded photos: many starts, coarse to fine, crossings of candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from torch import Tensor

from motdiff.estimators.coded.candidates import (
    SAME_PX,
    CandidatePath,
    Evolution,
    cost_gap,
    expected_deviation_px,
    merged,
)
from motdiff.estimators.coded.exposures import Exposures
from motdiff.estimators.coded.fit import KNOTS, PhotoFit
from motdiff.estimators.coded.misfit import Term, descend
from motdiff.estimators.coded.path_measure import PathMeasure
from motdiff.estimators.coded.scene_term import SceneSpectra
from motdiff.estimators.coded.starts import (
    bridged,
    crossed,
    decoded_paths,
    loop_reversals,
    orders,
    with_knots,
)
from motdiff.metrics import rms_distance_px
from motdiff.motions import boracchi_foi
from motdiff.progress import Progress
from motdiff.types import FloatArray

CLEAR_GAP = 1000.0
"""Cost of the next path less the best's from which no other search is needed.

Wrong ends of searches beside kernels had 730 before the next path, at most.
"""
_DECODED = 64  # starting paths of each kind
_ORDERS = 48
_WALKS = 48
_EVOLUTION = Evolution(rounds=6, patience=2, improved=0.98, population=8)
_CHILDREN_FITTED = 10
_PARENTS = 4  # of the population, crossed with all

# the search beside the photos alone
_FEW_PHOTOS = 2  # their kernels mislead too often to be searched by themselves
_EXPLAINED = 1.0  # misfit; right paths have 0.6 to 0.97 on simulated walks
_FEW_KNOTS = 27  # half as many unknowns make a step twice as cheap
_DRAWS = 64  # starts of a search, some from the kernels' light and some without it
_LONE_WALKS = 64
_USUAL_PX = 50.0  # length of the walks where no kernel tells it
_MOST_SEARCHES = 3
# more rounds and patience, as each round changes less
_WIDE_EVOLUTION = Evolution(rounds=20, patience=5, improved=0.998, population=8)
_CHILDREN = 32  # of a round
_WIDE_RESULTS = 6  # handed to the finest grid
# shares of the children; the others are bridged
_REROUTED = 0.35
_TURNED = 0.2
_CROSSED = 0.2


def find_paths(
    exposures: Exposures,
    *,
    rng: np.random.Generator,
    progress: Progress | None = None,
    cost: float = 1.0,
) -> tuple[list[CandidatePath], int]:
    """Find the paths that explain the photos best.

    With three photos or more a search beside their kernels comes first, and is the last where its
    path explains the photos and no other comes near. The search beside the photos alone is
    repeated until two searches end at one path.

    Parameters
    ----------
    progress : Progress, optional
        Its plan holds ``cost`` for this work already.
    cost : float
        Of one search, in the unit of that plan.

    Returns
    -------
    list of CandidatePath, best first, and the number of searches that ended at the best one
    """
    progress = progress or Progress()
    spectra = exposures.spectra()
    search = _Search(exposures, spectra, rng, spend=lambda share: progress.spend(share * cost))
    x = search.from_kernels()
    if not spectra:
        return search.run(x), 1
    if len(exposures.codes) == _FEW_PHOTOS:
        return _wide_paths(
            search, spectra, starts=search.paths(x), is_searched=False, spend=search.spend
        )
    paths = search.run(x)
    gap = cost_gap(paths)
    if gap is not None and gap > CLEAR_GAP and paths[0].misfit <= _EXPLAINED:
        return paths, 1
    progress.expect_more(2 * cost)
    return _wide_paths(
        search,
        spectra,
        starts=np.stack([path.path for path in paths]),
        is_searched=True,
        spend=lambda share: progress.spend(2 * share * cost),
    )


class _Search(PhotoFit):
    """Search from the photos' kernels."""

    def __init__(
        self,
        exposures: Exposures,
        spectra: Sequence[SceneSpectra],
        rng: np.random.Generator,
        *,
        spend: Callable[[float], None],
    ) -> None:
        super().__init__(exposures, spectra)
        self.rng = rng
        self.spend = spend
        self.length_px = _USUAL_PX
        self.coarse_kernels = {sigma_px: self.kernels(sigma_px) for sigma_px in (4.0, 2.5, 1.5)}
        self.sharpest = self.kernels(1.0, saturated=True)

    def from_kernels(self) -> Tensor:
        """Candidates from all kinds of starts, fitted to the kernels."""
        from motdiff.psf_frame import without_faint_parts
        from motdiff.tracing import simplest_trajectory

        traced = simplest_trajectory(without_faint_parts(self.exposures.kernels[0]))
        self.length_px = float(np.clip(traced.length_px, 8, 90))
        starts = [
            self._decoded(_DECODED),
            orders(traced, knots=KNOTS, count=_ORDERS),
            _walks(self.rng, KNOTS, np.full(_WALKS, self.length_px)),
        ]
        x = self.pack(np.concatenate(starts))
        for term, keep in zip(self.coarse_kernels.values(), (48, 24, 10), strict=True):
            x, _ = self.best([term, self.loose], x, steps=8, keep=keep)
        return self.registered(x)

    def run(self, x: Tensor) -> list[CandidatePath]:
        """Paths at the ends of descents and crossings of candidates, best first."""
        coarse: list[Term] = [*self.scenes[:1], self.sharpest, self.loose]
        x, costs = self.best(coarse, x, steps=6, keep=_EVOLUTION.population)
        self.spend(0.25)
        x, costs = _EVOLUTION.run(
            self.unknowns,
            x,
            costs,
            changed=lambda parents: self._changed(coarse, parents),
            spend=lambda share: self.spend(0.5 * share),
        )
        if not self.scenes:
            x, costs = self.best(coarse, x[:3], steps=20, keep=3)
            self.spend(0.25)
            return self._described(coarse, x, costs)
        x, _ = self.best([self.scenes[1], self.sharpest, self.stiff], x[:6], steps=6, keep=6)
        self.spend(0.1)
        return self._ended(x)

    def finished(self, paths: FloatArray) -> list[CandidatePath]:
        """Paths (B, K, 2) fitted to the photos' finest details, best first."""
        return self._ended(self.registered(self.pack(paths)))

    def _ended(self, x: Tensor) -> list[CandidatePath]:
        # not the kernels: a wrong one stands against the right path
        x, _ = self.best(self.nearly, x, steps=6, keep=4)
        x, costs = self.best(self.finest, x, steps=25, keep=len(x))
        self.spend(0.15)
        return self._described(self.finest, x, costs)

    def _decoded(self, count: int, shifts: FloatArray | None = None) -> FloatArray:
        return decoded_paths(
            self.exposures.kernels,
            self.exposures.codes,
            knots=KNOTS,
            count=count,
            length_px=self.length_px,
            rng=self.rng,
            shifts=shifts,
        )

    def _changed(self, terms: Sequence[Term], x: Tensor) -> tuple[Tensor, Tensor]:
        """Children of candidates, fitted coarse to fine, and their costs."""
        new = self.pack(np.stack(self._children(x)))
        new, _ = descend([self.coarse_kernels[2.5], self.loose], new, steps=3)
        new, _ = self.best(
            [self.coarse_kernels[1.5], self.loose], new, steps=4, keep=_CHILDREN_FITTED
        )
        return descend(terms, self.registered(new), steps=5)

    def _children(self, x: Tensor) -> list[FloatArray]:
        """Cross the best with each other and decoded paths, and reverse loops."""
        shifts = self.unknowns.kernel_shifts(x)
        paths = self.paths(x) + shifts[:, :1].numpy()  # all aligned with the first kernel
        children = []
        for i, path in enumerate(paths[:_PARENTS]):
            partners = [*paths[:i], *paths[i + 1 :]]
            if i < 2:
                partners += list(self._decoded(12, shifts[i].numpy().astype(np.float64)))
            children += loop_reversals(path, count=4 if i < 2 else 2, rng=self.rng)
            crossings = (crossed(path, partner, rng=self.rng) for partner in partners)
            children += [child for child in crossings if child is not None]
        return children

    def _described(self, terms: Sequence[Term], x: Tensor, costs: Tensor) -> list[CandidatePath]:
        described = []
        for candidate, path, cost in zip(x[:, None], self.paths(x), costs.tolist(), strict=True):
            misfit = self.misfit(candidate)
            noise_factor = max(1.0, misfit) if self.scenes else 1.0
            deviation_px = np.sqrt(0.5 * noise_factor) * expected_deviation_px(
                self.unknowns, terms, candidate
            )
            described.append(CandidatePath(path, cost, misfit, deviation_px))
        return described


def _wide_paths(
    search: _Search,
    spectra: Sequence[SceneSpectra],
    *,
    starts: FloatArray,
    is_searched: bool,
    spend: Callable[[float], None],
) -> tuple[list[CandidatePath], int]:
    """Search beside the photos alone, from paths (N, K, 2) and random walks.

    Searches are repeated, the later ones from draws alone, until two of them end at one path,
    at most three times. Starts that a search ended at (``is_searched``) count as its end.

    Returns
    -------
    Paths, best first, and the number of searches that ended at the best
    """
    wide = _WideSearch(search.exposures, spectra, search.rng)
    starts = with_knots(starts, _FEW_KNOTS)
    results: list[tuple[Tensor, Tensor]] = []
    if is_searched:
        searched = wide.registered(wide.pack(starts))
        results.append(wide.best(wide.beside_photos(2), searched, steps=6, keep=len(searched)))
    share = 0.7 / (_MOST_SEARCHES - len(results))
    times = 0
    while times < 2 and len(results) < _MOST_SEARCHES:
        results.append(wide.run(starts, spend=lambda s: spend(share * s)))
        starts = starts[:0]
        x, _, times = merged(wide.unknowns, results, keep=_WIDE_RESULTS, same_px=SAME_PX)
    spend(share * (_MOST_SEARCHES - len(results)))
    if times == 1:  # what each of them has right may belong together
        x, costs = wide.best(wide.beside_photos(2), x, steps=2, keep=len(x))
        x, _ = wide.evolved(x, costs, spend=lambda s: spend(0.15 * s))
    else:
        spend(0.15)
    few_knots_paths = with_knots(wide.paths(x), KNOTS)
    paths = search.finished(few_knots_paths)
    # with more knots another path may be the best, at which no other search ended
    return paths, times if rms_distance_px(paths[0].path, few_knots_paths[0]) < SAME_PX else 1


class _WideSearch(PhotoFit):
    """Search beside the photos alone, with few knots.

    The coarser grids lead a path near a minimum; only the finest tells the right one, as wrong
    paths differ most beyond 0.16 cycles/px.
    """

    def __init__(
        self, exposures: Exposures, spectra: Sequence[SceneSpectra], rng: np.random.Generator
    ) -> None:
        super().__init__(exposures, spectra, knots=_FEW_KNOTS)
        self.rng = rng
        self.measure = PathMeasure(exposures.kernels, exposures.codes)

    def run(self, starts: FloatArray, *, spend: Callable[[float], None]) -> tuple[Tensor, Tensor]:
        """Candidates and costs, best first, from paths (N, K, 2), draws and random walks."""
        samples = self.measure.draw(_DRAWS, knots=self.knots, rng=self.rng)
        walks = _usual_walks(self.rng, self.knots, _LONE_WALKS)
        x = self.registered(self.pack(np.concatenate([starts, samples, walks])))
        x, _ = self.best(self.beside_photos(0), x, steps=4, keep=32)
        x, _ = self.best(self.beside_photos(1), x, steps=4, keep=12)
        x, costs = self.best(self.beside_photos(2), x, steps=4, keep=_WIDE_EVOLUTION.population)
        spend(0.2)
        return self.evolved(x, costs, spend=lambda s: spend(0.8 * s))

    def evolved(
        self, x: Tensor, costs: Tensor, *, spend: Callable[[float], None]
    ) -> tuple[Tensor, Tensor]:
        """Candidates and costs, best first, after changes of the best ones while that helps."""
        return _WIDE_EVOLUTION.run(self.unknowns, x, costs, changed=self._changed, spend=spend)

    def _changed(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Children of candidates, fitted on finer and finer grids, and their costs."""
        new = self.registered(self.pack(self._children(self.paths(x))))
        new, _ = self.best(self.beside_photos(0), new, steps=2, keep=20)
        new, _ = self.best(self.beside_photos(1), new, steps=3, keep=8)
        return descend(self.beside_photos(2), new, steps=4)

    def _children(self, paths: FloatArray) -> FloatArray:
        """Change parents drawn from (N, K, 2), the first likelier.

        A stretch is led through the light that the rest of the path leaves, a loop is turned, a
        stretch of another path taken, or one drawn anew between its ends.
        """
        rng = self.rng
        chance = np.exp(-0.3 * np.arange(len(paths)))
        parents = rng.choice(len(paths), _CHILDREN, p=chance / chance.sum())
        children = []
        for path in paths[parents]:
            kind = rng.random()
            child = None
            if kind < _REROUTED:
                child = self.measure.rerouted(path, rng=rng)
            elif kind < _REROUTED + _TURNED:
                child = loop_reversals(path, count=1, rng=rng)[0]
            elif kind < _REROUTED + _TURNED + _CROSSED:
                child = crossed(path, paths[rng.integers(len(paths))], rng=rng)
            if child is None:
                child = bridged(path, _usual_walks(rng, self.knots, 1)[0], rng=rng)
            children.append(child)
        return np.stack(children)


def _usual_walks(rng: np.random.Generator, knots: int, count: int) -> FloatArray:
    return _walks(rng, knots, _USUAL_PX * rng.uniform(0.5, 1.5, count))


def _walks(rng: np.random.Generator, knots: int, lengths_px: FloatArray) -> FloatArray:
    """Random walks (B, K, 2) of such lengths."""
    times = np.linspace(0, 1, knots)
    return np.stack([boracchi_foi(rng, max_length_px=px).at(times) for px in lengths_px])
