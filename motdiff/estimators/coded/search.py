"""Search for the path of coded photos: many starts, coarse to fine, crossings of candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle

import numpy as np
import torch
from torch import Tensor

from motdiff.estimators.coded.candidates import (
    SAME_PX,
    CandidatePath,
    Evolution,
    expected_deviation_px,
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
from motdiff.estimators.coded.misfit import Term, descend
from motdiff.estimators.coded.path_measure import PathMeasure
from motdiff.estimators.coded.scene_term import SceneSpectra
from motdiff.estimators.coded.starts import (
    bridged,
    crossed,
    decoded_paths,
    loops_reordered,
    orders,
)
from motdiff.metrics import rms_distance_px
from motdiff.motions import boracchi_foi
from motdiff.progress import Progress
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

_DECODED = 64  # starting paths of each kind
_ORDERS = 48
_WALKS = 48
_KERNEL_EVOLUTION = Evolution(rounds=6, patience=2, improved=0.98, population=8)
_CHILDREN_FITTED = 10
_REORDERED_BESIDE_KERNELS = 4
_PARENTS = 4  # of the population, crossed with all

# the search of photos of one scene
_EXPLAINED = 1.1  # misfit; right paths have 0.6 to 1.0 on simulated walks
_FEW_KNOTS = 27  # half as many unknowns make a step twice as cheap
_DRAWS = 64  # starts of a search from the kernels' light
_LONE_WALKS = 32  # and without it
_LONE_SWEEPS = 64
_SWEEP_SHARES = (1.0, 0.6, 0.4)  # of Legendre polynomials of degree 1, 2 and 3
_USUAL_PX = 50.0  # length of the walks where no kernel tells it
_SEARCHES_AT_ONCE = 2
_MOST_SEARCHES = 4
_LOOSE_STARTS: Schedule = ((LOOSE, 4, 24),)
_STIFF_STARTS: Schedule = ((STIFF, 8, 12),)
_STARTS: Schedule = ((MIDDLE, 2, 32), (MIDDLE, 3, 16), (NEAR, 2, 12), (FINEST, 4, 8))
# more rounds and patience, as each round changes less
_SCENE_EVOLUTION = Evolution(rounds=20, patience=5, improved=0.998, population=8)
_CHILDREN = 32  # of a round
# in turn: a child far from a minimum comes to one loosely, one nearby is led away by that
_CHILD_SCHEDULES: tuple[Schedule, ...] = (
    ((LOOSE, 2, 20), (MIDDLE, 3, 8), (FINEST, 4, 8)),
    ((NEAR, 1, 16), (NEAR, 2, 8), (FINEST, 4, 8)),
)
_RESULTS = 6  # handed on with all knots
_LAST: Schedule = ((FINEST, 4, 4), (FINEST, 21, 4))
# shares of the children; the others are bridged
_REROUTED = 0.35
_REORDERED = 0.25
_CROSSED = 0.15


def find_paths(
    exposures: Exposures,
    *,
    rng: np.random.Generator,
    progress: Progress | None = None,
    cost: float = 1.0,
) -> tuple[list[CandidatePath], int]:
    """Find the paths that explain the photos best.

    Photos of one scene are searched, until two searches end at one path that explains them, four
    at most; else their kernels are.

    Parameters
    ----------
    progress : Progress, optional
        Its plan holds ``cost`` for this work already.
    cost : float
        Of the work, in the unit of that plan.

    Returns
    -------
    list of CandidatePath, best first, and the number of searches that ended at the best one
    """
    progress = progress or Progress()

    def spend(share: float) -> None:
        progress.spend(share * cost)

    spectra = exposures.spectra()
    if spectra:
        return _scene_paths(exposures, spectra, rng, spend=spend)
    return _KernelSearch(exposures, rng, spend=spend).run(), 1


def _described(
    fit: PhotoFit, terms: Sequence[Term], x: Tensor, costs: Tensor
) -> list[CandidatePath]:
    """Candidates with their misfit and the expected errors of their knots."""
    described = []
    for candidate, path, cost in zip(x[:, None], fit.paths(x), costs.tolist(), strict=True):
        misfit = fit.misfit(candidate)
        noise_factor = max(1.0, misfit) if fit.has_scene else 1.0
        deviation_px = np.sqrt(0.5 * noise_factor) * expected_deviation_px(
            fit.unknowns, terms, candidate
        )
        described.append(CandidatePath(path, cost, misfit, deviation_px))
    return described


class _KernelSearch(PhotoFit):
    """Search of a path that explains the photos' kernels."""

    def __init__(
        self, exposures: Exposures, rng: np.random.Generator, *, spend: Callable[[float], None]
    ) -> None:
        super().__init__(exposures, ())
        self.rng = rng
        self.spend = spend
        self.length_px = _USUAL_PX
        self.coarse_kernels = {sigma_px: self.kernels(sigma_px) for sigma_px in (4.0, 2.5, 1.5)}
        self.sharpest = self.kernels(1.0, saturated=True)

    def run(self) -> list[CandidatePath]:
        """Paths that explain the kernels, best first."""
        terms: list[Term] = [self.sharpest, self.loose]
        x, costs = self.best(terms, self._starts(), steps=6, keep=_KERNEL_EVOLUTION.population)
        self.spend(0.25)
        x, costs = _KERNEL_EVOLUTION.run(
            self.unknowns,
            x,
            costs,
            changed=lambda parents: self._changed(terms, parents),
            spend=lambda share: self.spend(0.5 * share),
        )
        x, costs = self.best(terms, x[:3], steps=20, keep=3)
        self.spend(0.25)
        return _described(self, terms, x, costs)

    def _starts(self) -> Tensor:
        """Candidates from all kinds of starts, fitted coarse to fine."""
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
        return x

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
        return descend(terms, new, steps=5)

    def _children(self, x: Tensor) -> list[FloatArray]:
        """Cross the best with each other and decoded paths, and reorder their loops."""
        shifts = self.unknowns.kernel_shifts(x)
        paths = self.paths(x) + shifts[:, :1].numpy()  # all aligned with the first kernel
        children = []
        for i, path in enumerate(paths[:_PARENTS]):
            partners = [*paths[:i], *paths[i + 1 :]]
            if i < 2:
                partners += list(self._decoded(12, shifts[i].numpy().astype(np.float64)))
            changed = [
                loops_reordered(path, rng=self.rng) for _ in range(_REORDERED_BESIDE_KERNELS)
            ]
            changed += [crossed(path, partner, rng=self.rng) for partner in partners]
            children += [child for child in changed if child is not None]
        return children


def _scene_paths(
    exposures: Exposures,
    spectra: Sequence[SceneSpectra],
    rng: np.random.Generator,
    *,
    spend: Callable[[float], None],
) -> tuple[list[CandidatePath], int]:
    """Paths that explain photos of one scene, best first, and how many searches ended at the best.

    Searches are repeated until two of them end at one path that explains the photos, four at most.
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
        x, _, times = merged(search.unknowns, results, keep=_RESULTS, same_px=SAME_PX)
        is_agreed = times > 1 and search.misfit(x[:1]) <= _EXPLAINED
    spend(share * (_MOST_SEARCHES - len(results)))
    if times == 1:  # what each of them has right may belong together
        x, costs = search.fitted(x, ((FINEST, 2, _RESULTS),))
        x, _ = search.evolved(x, costs, rng, spend=lambda s: spend(0.15 * s))
    else:
        spend(0.15)
    fine = PhotoFit(exposures, spectra)
    x = search.unknowns.resampled(x, KNOTS)
    searched_path = fine.paths(x)[0]
    x, costs = fine.fitted(x, _LAST)
    spend(0.15)
    paths = _described(fine, fine.beside_photos(FINEST), x, costs)
    # with more knots another path may be the best, at which no other search ended
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
        walks = _usual_walks(rng, self.knots, _LONE_WALKS)
        sweeps = _sweeps(rng, self.knots, _LONE_SWEEPS)
        random = self._packed(np.concatenate([walks, sweeps]))
        from_light = self._packed(self.measure.draw(_DRAWS, knots=self.knots, rng=rng))
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
        schedules = cycle(_CHILD_SCHEDULES)

        def changed(parents: Tensor) -> tuple[Tensor, Tensor]:
            children = self._children(self.paths(parents), rng)
            return self.fitted(self._packed(children), next(schedules))

        return _SCENE_EVOLUTION.run(self.unknowns, x, costs, changed=changed, spend=spend)

    def _packed(self, paths: FloatArray) -> Tensor:
        return self.registered(self.pack(paths))

    def _children(self, paths: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Change parents drawn from (N, K, 2), the first likelier.

        A stretch is led through the light that the rest of the path leaves, loops come in another
        order, a stretch of another path is taken, or one drawn anew between its ends.
        """
        chance = np.exp(-0.3 * np.arange(len(paths)))
        parents = rng.choice(len(paths), _CHILDREN, p=chance / chance.sum())
        children = []
        for path in paths[parents]:
            kind = rng.random()
            child = None
            if kind < _REROUTED:
                child = self.measure.rerouted(path, rng=rng)
            elif kind < _REROUTED + _REORDERED:
                child = loops_reordered(path, rng=rng)
            elif kind < _REROUTED + _REORDERED + _CROSSED:
                child = crossed(path, paths[rng.integers(len(paths))], rng=rng)
            if child is None:
                child = bridged(path, _usual_walks(rng, self.knots, 1)[0], rng=rng)
            children.append(child)
        return np.stack(children)


def _usual_walks(rng: np.random.Generator, knots: int, count: int) -> FloatArray:
    return _walks(rng, knots, _USUAL_PX * rng.uniform(0.5, 1.5, count))


def _sweeps(rng: np.random.Generator, knots: int, count: int) -> FloatArray:
    """Smooth motions (B, K, 2), cubic in time, as hands and machines make them."""
    t = np.linspace(-1, 1, knots)
    shares = rng.standard_normal((count, len(_SWEEP_SHARES), 2)) * np.array(_SWEEP_SHARES)[:, None]
    paths = np.polynomial.legendre.legvander(t, len(_SWEEP_SHARES))[:, 1:] @ shares
    extents = np.ptp(paths, axis=1).max(axis=1)
    lengths_px = _USUAL_PX * rng.uniform(0.1, 1.0, count)
    return np.asarray(paths * (lengths_px / extents)[:, None, None])


def _walks(rng: np.random.Generator, knots: int, lengths_px: FloatArray) -> FloatArray:
    """Random walks (B, K, 2) of such lengths."""
    times = np.linspace(0, 1, knots)
    return np.stack([boracchi_foi(rng, max_length_px=px).at(times) for px in lengths_px])
