"""Search for the path that explains coded photos: from many starts, coarse to fine, by crossing what was found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from motdiff.crops import pick_crops
from motdiff.estimators.coded.misfit import (
    KernelTerm,
    Roughness,
    SceneSpectra,
    SceneTerm,
    Term,
    Unknowns,
    descend,
    scene_spectra,
)
from motdiff.estimators.coded.otfs import CodedOtfs
from motdiff.estimators.coded.starts import bridged, crossed, decoded_paths, loop_reversals, orders
from motdiff.motions import boracchi_foi
from motdiff.progress import Progress
from motdiff.psf_frame import centroid_px
from motdiff.trajectory import Trajectory

__all__ = ["UNEXPLAINED", "Exposures", "FoundPath", "find_paths"]

FloatArray = NDArray[np.float64]

_KNOTS, _FEW_KNOTS = 53, 27
_SATURATION = 60.0
_LOOSE, _STIFF = 0.3, 30.0  # roughness beside kernels, beside photos: second differences of 0.2 px
_DISTINCT_PX = 0.3
_PATH_ERRORS_PX = (1.0, 0.3, 0.04)  # allowed on the three grids; at last, what straight pieces between knots leave
_SIDE_STEP_PX = 6  # photos are cut to sides that the three grids divide
_LARGEST_SIDE_PX = 252
_LEAST_INSIDE_PX = 96  # of a photo without its borders
_DECODED, _ORDERS, _WALKS = 64, 48, 48
_POPULATION, _KEPT, _PARENTS = 8, 10, 4
_ROUNDS, _FINE_ROUNDS, _STILL = 6, 3, 2
_IMPROVED = 0.98
_LONE_WALKS, _USUAL_PX = 96, 50.0
_MOST_SEARCHES, _SAME_PX = 4, 1.0
_WIDE_ROUNDS, _WIDE_STILL, _CHILDREN, _KEPT_OF_WIDE = 20, 4, 32, 6
_PATIENT = 0.995
_FEW_PHOTOS = 2  # their kernels mislead too often to be all that a search begins from
UNEXPLAINED = 1.25
"""Misfit above which a path does not explain the photos."""


@dataclass(frozen=True)
class Exposures:
    """What is known of photos of one motion, that with the most light first.

    Attributes
    ----------
    codes : tuple of I str
    kernels : tuple of I (S, S) float
        Found in each photo alone.
    weights : (I,) float
        Inverse of the relative squared error expected of each kernel, times the values that it is spread over.
    gains : (I,) float
        Brightness of each photo against the first, beyond what the codes explain.
    photos : tuple of I (H, W) float, or empty
        Photos of one scene, laid on each other to within a few px; empty where the scenes differ.
    """

    codes: tuple[str, ...]
    kernels: tuple[FloatArray, ...]
    weights: FloatArray
    gains: FloatArray
    photos: tuple[FloatArray, ...] = ()


@dataclass(frozen=True)
class FoundPath:
    """A path that explains the photos.

    Attributes
    ----------
    path : (K, 2) float, px
        At times spaced evenly over the exposure.
    cost : float
        Its sum of squares.
    misfit : float
        Of the photos, as a multiple of what noise alone leaves; NaN where only kernels are compared.
    deviation_px : (K,) float
        Standard deviation of each knot, as the fit's curvature and misfit give it.
    """

    path: FloatArray
    cost: float
    misfit: float
    deviation_px: FloatArray = field(repr=False)


def find_paths(
    exposures: Exposures,
    *,
    rng: np.random.Generator,
    progress: Progress | None = None,
    cost: float = 1.0,
) -> list[FoundPath]:
    """Find the paths that explain the photos best.

    Where none does, some kernel was wrong: the search goes on from random walks and without the kernels. With two
    photos that is done at once.

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
    list of FoundPath, best first: at least one
    """
    told = progress or Progress()
    spectra = _spectra(exposures)
    search = _Search(exposures, spectra, rng, spend=lambda share: told.spend(share * cost))
    x = search.from_kernels()
    if spectra and len(exposures.codes) == _FEW_PHOTOS:
        return search.finished(_widely_searched(exposures, spectra, rng, known=search.paths(x), spend=search.spend))
    found = search.run(x)
    if found[0].misfit > UNEXPLAINED:
        told.expect_more(2 * cost)
        known = np.stack([path.path for path in found])
        wide = _widely_searched(exposures, spectra, rng, known=known, spend=lambda share: told.spend(2 * share * cost))
        found = min(found, search.finished(wide), key=lambda paths: paths[0].misfit)
    return found


def _spectra(exposures: Exposures) -> list[SceneSpectra]:
    """Spectra of the photos on three grids, coarse to fine; none where the scene is not shared or too small."""
    photos = exposures.photos
    if len(photos) < 2:
        return []
    y, x = (np.concatenate(axis) for axis in zip(*(np.nonzero(k) for k in exposures.kernels), strict=True))
    margin_px = int(np.ceil(0.5 * max(np.ptp(y), np.ptp(x)))) + 10
    side = min(_LARGEST_SIDE_PX, *(n // _SIDE_STEP_PX * _SIDE_STEP_PX for n in photos[0].shape))
    if side - 2 * margin_px < _LEAST_INSIDE_PX:
        return []
    top, left = pick_crops(photos[0], size=side, count=1)[0]  # where the scene has texture
    cut = [photo[top : top + side, left : left + side] for photo in photos]
    return scene_spectra(cut, grids=[side // part for part in (6, 3, 2)], margin_px=margin_px)


class _Fit:
    """Paths of so many knots beside the photos: their terms, and what is done with candidates."""

    def __init__(
        self, exposures: Exposures, spectra: Sequence[SceneSpectra], rng: np.random.Generator, *, knots: int
    ) -> None:
        self.exposures, self.rng, self.knots = exposures, rng, knots
        self.unknowns = Unknowns(knots, len(exposures.codes))
        self.otfs = CodedOtfs(exposures.codes, knots)
        self.loose, self.stiff = Roughness(self.unknowns, _LOOSE), Roughness(self.unknowns, _STIFF)
        self.centroids = torch.tensor(np.array([centroid_px(kernel)[::-1] for kernel in exposures.kernels]))
        self.scenes = [
            SceneTerm(self.unknowns, self.otfs, one, path_error_px=error_px)
            for one, error_px in zip(spectra, _PATH_ERRORS_PX, strict=False)
        ]

    def pack(self, paths: FloatArray) -> Tensor:
        """Candidates of paths (B, K, 2), centred, with the kernels' shifts that lay centroid on centroid."""
        centred = torch.tensor(paths - paths.mean(axis=1, keepdims=True), dtype=torch.float32)
        shifts = self.centroids.float() - self.otfs.centroids(centred)
        gains = torch.tensor(np.tile(self.exposures.gains, (len(paths), 1)), dtype=torch.float32)
        return self.unknowns.pack(centred, gains, shifts)

    def registered(self, x: Tensor) -> Tensor:
        """Candidates with the photos' shifts found, where these are of one scene."""
        return self.scenes[0].registered(x) if self.scenes else x

    def paths(self, x: Tensor) -> FloatArray:
        """Paths (B, K, 2) of candidates."""
        return self.unknowns.paths(x).numpy().astype(np.float64)

    def walks(self, count: int, length_px: float | None = None) -> FloatArray:
        """Random walks (count, K, 2), of any usual length when omitted."""
        at = np.linspace(0, 1, self.knots)
        lengths = np.full(count, length_px) if length_px else _USUAL_PX * self.rng.uniform(0.5, 1.5, count)
        return np.stack([boracchi_foi(self.rng, max_length_px=length).at(at) for length in lengths])

    def best(self, terms: Sequence[Term], x: Tensor, *, steps: int, keep: int) -> tuple[Tensor, Tensor]:
        """Candidates after some steps of descent, the best of them."""
        return self.distinct(*descend(terms, x, steps=steps), keep=keep)

    def apart_px(self, one: Tensor, other: Tensor) -> float:
        """Rms distance of the paths of two candidates (N,), after the best shift."""
        apart = self.unknowns.paths((one - other)[None])[0]
        return float((apart - apart.mean(0)).square().sum(1).mean().sqrt())

    def distinct(self, x: Tensor, costs: Tensor, *, keep: int) -> tuple[Tensor, Tensor]:
        """Best candidates, none nearer than 0.3 px rms to a better one."""
        kept = list[int]()
        for i in torch.argsort(costs).tolist():
            if all(self.apart_px(x[i], x[j]) > _DISTINCT_PX for j in kept):
                kept.append(i)
            if len(kept) == keep:
                break
        return x[kept], costs[kept]


class _Search(_Fit):
    """A search that the photos' kernels lead."""

    def __init__(
        self, exposures: Exposures, spectra: Sequence[SceneSpectra], rng: np.random.Generator, *,
        spend: Callable[[float], None],
    ) -> None:  # fmt: skip
        super().__init__(exposures, spectra, rng, knots=_KNOTS)
        self.spend, self.length_px = spend, _USUAL_PX
        self.kernels = {sigma: self._kernels_at(sigma) for sigma in (4.0, 2.5, 1.5)}
        self.sharpest = self._kernels_at(1.0, _SATURATION)

    def from_kernels(self) -> Tensor:
        """Candidates from all kinds of starts, fitted to the kernels."""
        from motdiff.estimators.multiscale import without_faint_parts
        from motdiff.tracing import simplest_trajectory

        traced = simplest_trajectory(without_faint_parts(self.exposures.kernels[0]))
        self.length_px = float(np.clip(traced.length_px, 8, 90))
        starts = [
            self._decoded(_DECODED),
            orders(traced, knots=_KNOTS, most=_ORDERS),
            self.walks(_WALKS, self.length_px),
        ]
        x = self.pack(np.concatenate(starts))
        for term, keep in zip(self.kernels.values(), (48, 24, 10), strict=True):
            x, _ = self.best([term, self.loose], x, steps=8, keep=keep)
        return self.registered(x)

    def run(self, x: Tensor) -> list[FoundPath]:
        """Paths that candidates lead to, best first."""
        coarse: list[Term] = [*self.scenes[:1], self.sharpest, self.loose]
        x, costs = self.best(coarse, x, steps=6, keep=_POPULATION)
        self.spend(0.25)
        x, costs = self._evolved(coarse, x, costs, rounds=_ROUNDS, steps=5, keep=_KEPT, share=0.4)
        if not self.scenes:
            x, costs = self.best(coarse, x[:3], steps=20, keep=3)
            self.spend(0.35)
            return self._described(coarse, x, costs)
        fine: list[Term] = [self.scenes[1], self.sharpest, self.stiff]
        x, costs = self.best(fine, x[:6], steps=6, keep=6)
        x, costs = self._evolved(fine, x, costs, rounds=_FINE_ROUNDS, steps=4, keep=5, share=0.2)
        return self._ended(x[:3])

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

    def _kernels_at(self, sigma_px: float, saturation: float | None = None) -> KernelTerm:
        known = self.exposures
        return KernelTerm(
            self.unknowns, self.otfs, known.kernels,
            sigma_px=sigma_px, weights=known.weights, saturation=saturation,
        )  # fmt: skip

    def _decoded(self, count: int, shifts: FloatArray | None = None) -> FloatArray:
        return decoded_paths(
            self.exposures.kernels, self.exposures.codes, knots=_KNOTS, count=count, length_px=self.length_px,
            rng=self.rng, shifts=shifts,
        )  # fmt: skip

    def _evolved(
        self, terms: Sequence[Term], x: Tensor, costs: Tensor, *,
        rounds: int, steps: int, keep: int, share: float,
    ) -> tuple[Tensor, Tensor]:  # fmt: skip
        """Cross the best candidates with each other and with decoded paths, and reverse their loops, while it helps."""
        still = 0
        for done in range(rounds):
            new = self.pack(np.stack(self._children(x)))
            new, _ = descend([self.kernels[2.5], self.loose], new, steps=3)
            new, _ = self.best([self.kernels[1.5], self.loose], new, steps=4, keep=keep)
            new = self.registered(new)
            if self.scenes and self.scenes[0] not in terms:
                new, _ = descend([self.scenes[0], self.sharpest, self.loose], new, steps=3)
            new, reached = descend(terms, new, steps=steps)
            before = float(costs.min())
            x, costs = self.distinct(torch.cat([x, new]), torch.cat([costs, reached]), keep=_POPULATION)
            still = 0 if float(costs[0]) < _IMPROVED * before else still + 1
            self.spend(share / rounds)
            if still == _STILL:
                self.spend(share * (rounds - 1 - done) / rounds)
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
            children += [child for other in others if (child := crossed(path, other, rng=self.rng)) is not None]
        return children

    def _described(self, terms: Sequence[Term], x: Tensor, costs: Tensor) -> list[FoundPath]:
        found = []
        for i in range(len(x)):
            one = x[i : i + 1]
            size = self.unknowns.size
            matrix, slope = torch.zeros(1, size, size), torch.zeros(1, size)
            for term in terms:
                term.add_normal(one, matrix, slope)
            scene = self.scenes[2] if self.scenes else None
            misfit = float(scene.cost(one)) / scene.values if scene else float("nan")
            curvature = matrix[0].double() + 1e-9 * matrix[0].diagonal().mean() * torch.eye(size)
            spread = 0.5 * torch.linalg.inv(curvature)[: 2 * _KNOTS, : 2 * _KNOTS]
            centring = torch.eye(_KNOTS).double() - 1 / _KNOTS  # the place of the whole path is of no account
            variance = sum((centring @ spread[axis::2, axis::2] @ centring).diagonal().clamp(min=0) for axis in (0, 1))
            assert isinstance(variance, Tensor)
            deviation = (max(1.0, misfit) if scene else 1.0) ** 0.5 * variance.sqrt().numpy()
            found.append(
                FoundPath(self.paths(one)[0], float(costs[i]), misfit, np.asarray(deviation, dtype=np.float64))
            )
        return found


def _widely_searched(
    exposures: Exposures, spectra: Sequence[SceneSpectra], rng: np.random.Generator, *,
    known: FloatArray, spend: Callable[[float], None],
) -> FloatArray:  # fmt: skip
    """Search beside the photos alone, from known paths (N, K, 2) and random walks: the best paths (M, K, 2).

    Searches are repeated, from other walks, until one ends where the best of those before it did.
    """
    fit = _Fit(exposures, spectra, rng, knots=_FEW_KNOTS)
    share = 0.85 / _MOST_SEARCHES
    x, costs = _wide_search(fit, _with_knots(known, _FEW_KNOTS), spend=lambda part: spend(share * part))
    for done in range(1, _MOST_SEARCHES):
        other, reached = _wide_search(fit, known[:0, :_FEW_KNOTS], spend=lambda part: spend(share * part))
        agreed = fit.apart_px(x[0], other[0]) < _SAME_PX
        x, costs = fit.distinct(torch.cat([x, other]), torch.cat([costs, reached]), keep=_POPULATION)
        if agreed:
            spend(share * (_MOST_SEARCHES - 1 - done))
            break
    return _with_knots(fit.paths(x[:_KEPT_OF_WIDE]), _KNOTS)


def _wide_search(fit: _Fit, known: FloatArray, *, spend: Callable[[float], None]) -> tuple[Tensor, Tensor]:
    """Candidates and their costs, best first, from known paths (N, K, 2), of few knots, and as many walks as usual.

    Stretches of the best paths are drawn anew between their ends, turned, or taken from each other; on the middle
    grid, where the photos still allow an error of 0.3 px, but few wrong orders.
    """
    coarse: list[Term] = [fit.scenes[0], fit.loose]
    middle: list[Term] = [fit.scenes[1], fit.stiff]
    x = fit.registered(fit.pack(np.concatenate([known, fit.walks(_LONE_WALKS)])))
    x, _ = fit.best(coarse, x, steps=4, keep=32)
    x, costs = fit.best(middle, x, steps=4, keep=12)
    spend(0.2)
    still = 0
    for done in range(_WIDE_ROUNDS):
        new = fit.registered(fit.pack(_children_of(fit.paths(x), fit.walks(_CHILDREN), rng=fit.rng)))
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
    """As many changed paths as there are walks, of the paths (N, K, 2) that come first most often."""
    chance = np.exp(-0.3 * np.arange(len(paths)))
    children = []
    for parent, walk in zip(rng.choice(len(paths), len(walks), p=chance / chance.sum()), walks, strict=True):
        path, kind = paths[parent], rng.random()
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
