"""Search for the path that explains coded photos: from many starts, coarse to fine, by crossing
what was found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from motdiff.estimators.coded.exposures import Exposures
from motdiff.estimators.coded.fit import KNOTS, PhotoFit
from motdiff.estimators.coded.found import FoundPath, expected_deviation_px, merged
from motdiff.estimators.coded.misfit import SceneSpectra, Term, descend
from motdiff.estimators.coded.starts import bridged, crossed, decoded_paths, loop_reversals, orders
from motdiff.motions import boracchi_foi
from motdiff.progress import Progress
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_DECODED = 64
_ORDERS = 48
_WALKS = 48
_POPULATION = 8
_KEPT = 10
_PARENTS = 4
_ROUNDS = 6
_STILL = 2
_IMPROVED = 0.98

# the search beside the photos alone
_DOUBTFUL = 1.0  # misfit; right paths have 0.6 to 0.97 on simulated walks
_FEW_PHOTOS = 2  # their kernels mislead too often to be all that a search begins from
_FEW_KNOTS = 27  # half as many unknowns make a step twice as cheap
_LONE_WALKS = 96
_USUAL_PX = 50.0
_MOST_SEARCHES = 4
_SAME_PX = 1.0
_WIDE_ROUNDS = 20
_WIDE_STILL = 4
_CHILDREN = 32
_KEPT_OF_WIDE = 6
_PATIENT = 0.995


def find_paths(
    exposures: Exposures,
    *,
    rng: np.random.Generator,
    progress: Progress | None = None,
    cost: float = 1.0,
) -> tuple[list[FoundPath], int]:
    """Find the paths that explain the photos best.

    Where the best one leaves more than noise, some kernel may be wrong: the search goes on from
    random walks and without the kernels. With two photos that is done at once.

    Parameters
    ----------
    exposures : Exposures
    rng : numpy Generator
    progress : Progress, optional
        Where the work done is reported; its plan holds ``cost`` for it already.
    cost : float
        Of one search, in the unit of that plan.

    Returns
    -------
    list of FoundPath, best first, and how many searches found the best one
    """
    told = progress or Progress()
    spectra = exposures.spectra()
    search = _Search(exposures, spectra, rng, spend=lambda share: told.spend(share * cost))
    x = search.from_kernels()
    if spectra and len(exposures.codes) == _FEW_PHOTOS:
        return _found_widely(
            search, spectra, known=search.paths(x), most=_MOST_SEARCHES, spend=search.spend
        )
    found = search.run(x)
    times = 1
    for most in (
        1,
        _MOST_SEARCHES,
    ):  # what one search finds and three photos bear out needs no other
        if not found[0].misfit > _DOUBTFUL:
            break
        told.expect_more(2 * cost)
        known = np.stack([path.path for path in found])
        other, again = _found_widely(
            search,
            spectra,
            known=known,
            most=most,
            spend=lambda share: told.spend(2 * share * cost),
        )
        if other[0].misfit < found[0].misfit:
            found = other
            times = again
    return found, times


class _Search(PhotoFit):
    """A search that the photos' kernels lead."""

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
        from motdiff.estimators.multiscale import without_faint_parts
        from motdiff.tracing import simplest_trajectory

        traced = simplest_trajectory(without_faint_parts(self.exposures.kernels[0]))
        self.length_px = float(np.clip(traced.length_px, 8, 90))
        starts = [
            self._decoded(_DECODED),
            orders(traced, knots=KNOTS, most=_ORDERS),
            _walks(self.rng, KNOTS, np.full(_WALKS, self.length_px)),
        ]
        x = self.pack(np.concatenate(starts))
        for term, keep in zip(self.coarse_kernels.values(), (48, 24, 10), strict=True):
            x, _ = self.best([term, self.loose], x, steps=8, keep=keep)
        return self.registered(x)

    def run(self, x: Tensor) -> list[FoundPath]:
        """Paths that candidates lead to, best first."""
        coarse: list[Term] = [*self.scenes[:1], self.sharpest, self.loose]
        x, costs = self.best(coarse, x, steps=6, keep=_POPULATION)
        self.spend(0.25)
        x, costs = self._evolved(coarse, x, costs)
        if not self.scenes:
            x, costs = self.best(coarse, x[:3], steps=20, keep=3)
            self.spend(0.25)
            return self._described(coarse, x, costs)
        x, costs = self.best([self.scenes[1], self.sharpest, self.stiff], x[:6], steps=6, keep=3)
        self.spend(0.1)
        return self._ended(x)

    def finished(self, paths: FloatArray) -> list[FoundPath]:
        """Paths that others (B, K, 2) become beside the photos' finest details, best first."""
        x = self.registered(self.pack(paths))
        x, _ = self.best([self.scenes[1], self.sharpest, self.stiff], x, steps=6, keep=4)
        return self._ended(x)

    def _ended(self, x: Tensor) -> list[FoundPath]:
        finest: list[Term] = [self.scenes[2], self.sharpest, self.stiff]
        x, costs = self.best(finest, x, steps=12, keep=len(x))
        self.spend(0.15)
        return self._described(finest, x, costs)

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

    def _evolved(self, terms: Sequence[Term], x: Tensor, costs: Tensor) -> tuple[Tensor, Tensor]:
        """Cross the best candidates with each other and with decoded paths, and reverse their
        loops, while it helps.
        """
        still = 0
        for done in range(_ROUNDS):
            new = self.pack(np.stack(self._children(x)))
            new, _ = descend([self.coarse_kernels[2.5], self.loose], new, steps=3)
            new, _ = self.best([self.coarse_kernels[1.5], self.loose], new, steps=4, keep=_KEPT)
            new, reached = descend(terms, self.registered(new), steps=5)
            before = float(costs.min())
            x, costs = self.distinct(
                torch.cat([x, new]), torch.cat([costs, reached]), keep=_POPULATION
            )
            still = 0 if float(costs[0]) < _IMPROVED * before else still + 1
            self.spend(0.5 / _ROUNDS)
            if still == _STILL:
                self.spend(0.5 * (_ROUNDS - 1 - done) / _ROUNDS)
                break
        return x, costs

    def _children(self, x: Tensor) -> list[FloatArray]:
        shifts = self.unknowns.kernel_shifts(x)
        paths = self.paths(x) + shifts[:, :1].numpy()  # all laid on the first kernel
        children = []
        for i, path in enumerate(paths[:_PARENTS]):
            others = [paths[j] for j in range(len(paths)) if j != i]
            if i < 2:
                others += list(self._decoded(12, shifts[i].numpy().astype(np.float64)))
            children += loop_reversals(path, most=4 if i < 2 else 2, rng=self.rng)
            children += [
                child
                for other in others
                if (child := crossed(path, other, rng=self.rng)) is not None
            ]
        return children

    def _described(self, terms: Sequence[Term], x: Tensor, costs: Tensor) -> list[FoundPath]:
        found = []
        for one, path, cost in zip(x, self.paths(x), costs.tolist(), strict=True):
            misfit = self.misfit(one[None])
            unexplained = max(1.0, misfit) if self.scenes else 1.0
            deviation_px = np.sqrt(0.5 * unexplained) * expected_deviation_px(
                self.unknowns, terms, one[None]
            )
            found.append(FoundPath(path, cost, misfit, deviation_px))
        return found


def _found_widely(
    search: _Search,
    spectra: Sequence[SceneSpectra],
    *,
    known: FloatArray,
    most: int,
    spend: Callable[[float], None],
) -> tuple[list[FoundPath], int]:
    """Paths of the search beside the photos alone, best first, and how many of its searches ended
    at the best.
    """
    wide, times = _widely_searched(
        search.exposures, spectra, search.rng, known=known, most=most, spend=spend
    )
    found = search.finished(wide)
    apart = found[0].path - wide[0]
    moved_px = np.sqrt(((apart - apart.mean(axis=0)) ** 2).sum(axis=1).mean())
    return (
        found,
        times if moved_px < _SAME_PX else 1,
    )  # in the finest details another path may be the best


def _widely_searched(
    exposures: Exposures,
    spectra: Sequence[SceneSpectra],
    rng: np.random.Generator,
    *,
    known: FloatArray,
    most: int,
    spend: Callable[[float], None],
) -> tuple[FloatArray, int]:
    """Search beside the photos alone, from known paths (N, K, 2) and random walks.

    Searches are repeated, the later ones from walks alone, until two of them end at one path,
    ``most`` times at most.

    Returns
    -------
    (M, K, 2) best paths, and how many searches ended at the first
    """
    fit = PhotoFit(exposures, spectra, knots=_FEW_KNOTS)
    share = 0.85 / most
    begun = _with_knots(known, _FEW_KNOTS)
    ends: list[tuple[Tensor, Tensor]] = []
    for done in range(1, most + 1):
        ends.append(_wide_search(fit, begun, rng, spend=lambda part: spend(share * part)))
        begun = begun[:0]
        x, _, times = merged(fit.unknowns, ends, keep=_KEPT_OF_WIDE, same_px=_SAME_PX)
        if times > 1:
            spend(share * (most - done))
            break
    return _with_knots(fit.paths(x), KNOTS), times


def _wide_search(
    fit: PhotoFit, known: FloatArray, rng: np.random.Generator, *, spend: Callable[[float], None]
) -> tuple[Tensor, Tensor]:
    """Candidates and their costs, best first, from known paths (N, K, 2), of few knots, and as
    many walks as usual.

    Stretches of the best paths are drawn anew between their ends, turned, or taken from each
    other; on the middle grid, where the photos still allow an error of 0.3 px, but few wrong
    orders.
    """
    coarse: list[Term] = [fit.scenes[0], fit.loose]
    middle: list[Term] = [fit.scenes[1], fit.stiff]
    x = fit.registered(
        fit.pack(np.concatenate([known, _usual_walks(rng, fit.knots, _LONE_WALKS)]))
    )
    x, _ = fit.best(coarse, x, steps=4, keep=32)
    x, costs = fit.best(middle, x, steps=4, keep=12)
    spend(0.2)
    still = 0
    for done in range(_WIDE_ROUNDS):
        new = fit.registered(
            fit.pack(_children_of(fit.paths(x), _usual_walks(rng, fit.knots, _CHILDREN), rng=rng))
        )
        new, _ = fit.best(coarse, new, steps=2, keep=20)
        new, _ = fit.best(middle, new, steps=2, keep=8)
        new, reached = descend(middle, new, steps=4)
        before = float(costs.min())
        x, costs = fit.distinct(torch.cat([x, new]), torch.cat([costs, reached]), keep=_POPULATION)
        still = 0 if float(costs[0]) < _PATIENT * before else still + 1
        spend(0.8 / _WIDE_ROUNDS)
        if still == _WIDE_STILL:
            spend(0.8 * (_WIDE_ROUNDS - 1 - done) / _WIDE_ROUNDS)
            break
    return x, costs


def _children_of(paths: FloatArray, walks: FloatArray, *, rng: np.random.Generator) -> FloatArray:
    """As many changed paths as there are walks, of the paths (N, K, 2) that come first most
    often.
    """
    chance = np.exp(-0.3 * np.arange(len(paths)))
    children = []
    for parent, walk in zip(
        rng.choice(len(paths), len(walks), p=chance / chance.sum()), walks, strict=True
    ):
        path = paths[parent]
        kind = rng.random()
        child = None
        if kind < 0.25:
            child = loop_reversals(path, most=1, rng=rng)[0]
        elif kind < 0.5:
            child = crossed(path, paths[rng.integers(len(paths))], rng=rng)
        children.append(bridged(path, walk, rng=rng) if child is None else child)
    return np.stack(children)


def _with_knots(paths: FloatArray, knots: int) -> FloatArray:
    """Paths (N, K, 2) at so many times spaced evenly."""
    return np.stack([Trajectory.from_samples(path).at(np.linspace(0, 1, knots)) for path in paths])


def _usual_walks(rng: np.random.Generator, knots: int, count: int) -> FloatArray:
    return _walks(rng, knots, _USUAL_PX * rng.uniform(0.5, 1.5, count))


def _walks(rng: np.random.Generator, knots: int, lengths_px: FloatArray) -> FloatArray:
    """Random walks (B, K, 2) of such lengths."""
    at = np.linspace(0, 1, knots)
    return np.stack(
        [boracchi_foi(rng, max_length_px=length_px).at(at) for length_px in lengths_px]
    )
