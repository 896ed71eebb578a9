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
from motdiff.estimators.coded.starts import crossed, decoded_paths, loop_reversals, orders
from motdiff.motions import boracchi_foi
from motdiff.progress import Progress
from motdiff.psf_frame import centroid_px

__all__ = ["UNEXPLAINED", "Exposures", "FoundPath", "find_paths"]

FloatArray = NDArray[np.float64]

_KNOTS = 53
_SATURATION = 60.0
_LOOSE, _STIFF = 0.3, 30.0  # roughness beside kernels, beside photos: second differences of 0.2 px
_DISTINCT_PX = 0.3
_SIDE_STEP_PX = 6  # photos are cut to sides that the three grids divide
_LARGEST_SIDE_PX = 252
_LEAST_INSIDE_PX = 96  # of a photo without its borders
_DECODED, _ORDERS, _WALKS = 64, 48, 48
_POPULATION, _KEPT, _PARENTS = 8, 10, 4
_ROUNDS, _FINE_ROUNDS, _STILL = 6, 3, 2
_IMPROVED = 0.98
_LONE_WALKS, _USUAL_PX = 96, 50.0
_LITTLE_BELIEF = 0.05
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

    Where none does, some kernel was wrong: the search is repeated from random walks with little belief in the kernels.

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
    search = _Search(exposures, rng, spend=lambda share: told.spend(share * cost), belief=1.0)
    found = search.run(search.from_kernels())
    if found[0].misfit > UNEXPLAINED:
        told.expect_more(2 * cost)
        search = _Search(exposures, rng, spend=lambda share: told.spend(2 * share * cost), belief=_LITTLE_BELIEF)
        again = search.run(search.from_walks([path.path for path in found]))
        found = min(found, again, key=lambda paths: paths[0].misfit)
    return found


class _Search:
    """State of a search: its terms, and the generator of random numbers."""

    def __init__(
        self, exposures: Exposures, rng: np.random.Generator, *, spend: Callable[[float], None], belief: float
    ) -> None:
        self.exposures, self.rng, self.spend, self.belief = exposures, rng, spend, belief
        self.length_px = _USUAL_PX
        self.unknowns = Unknowns(_KNOTS, len(exposures.codes))
        self.otfs = CodedOtfs(exposures.codes, _KNOTS)
        self.loose, self.stiff = Roughness(self.unknowns, _LOOSE), Roughness(self.unknowns, _STIFF)

        self.kernels = {sigma: self._kernels_at(sigma) for sigma in (4.0, 2.5, 1.5)}
        self.sharpest = self._kernels_at(1.0, belief * _SATURATION)
        self.centroids = torch.tensor(np.array([centroid_px(kernel)[::-1] for kernel in exposures.kernels]))
        self.scenes = [
            SceneTerm(self.unknowns, self.otfs, spectra, path_error_px=error_px)
            for spectra, error_px in zip(self._spectra(), (1.0, 0.3, 0.0), strict=False)
        ]

    def run(self, x: Tensor) -> list[FoundPath]:
        """Paths that candidates lead to, best first."""
        coarse: list[Term] = [*self.scenes[:1], self.sharpest, self.loose]
        x, costs = self._best(coarse, x, steps=6, keep=_POPULATION)
        self.spend(0.25)
        x, costs = self._evolved(coarse, x, costs, rounds=_ROUNDS, steps=5, keep=_KEPT, share=0.4)
        if not self.scenes:
            x, costs = self._best(coarse, x[:3], steps=20, keep=3)
            self.spend(0.35)
            return self._described(coarse, x, costs)
        fine: list[Term] = [self.scenes[1], self.sharpest, self.stiff]
        x, costs = self._best(fine, x[:6], steps=6, keep=6)
        x, costs = self._evolved(fine, x, costs, rounds=_FINE_ROUNDS, steps=4, keep=5, share=0.2)
        finest: list[Term] = [self.scenes[2], self.sharpest, self.stiff]
        x, costs = self._best(finest, x[:3], steps=12, keep=3)
        self.spend(0.15)
        return self._described(finest, x, costs)

    def _kernels_at(self, sigma_px: float, saturation: float | None = None) -> KernelTerm:
        known = self.exposures
        return KernelTerm(
            self.unknowns, self.otfs, known.kernels,
            sigma_px=sigma_px, weights=self.belief * known.weights, saturation=saturation,
        )  # fmt: skip

    def _spectra(self) -> list[SceneSpectra]:
        """Spectra of the photos on three grids, coarse to fine; none where the scene is not shared or too small."""
        photos = self.exposures.photos
        if len(photos) < 2:
            return []
        y, x = (np.concatenate(axis) for axis in zip(*(np.nonzero(k) for k in self.exposures.kernels), strict=True))
        margin_px = int(np.ceil(0.5 * max(np.ptp(y), np.ptp(x)))) + 10
        side = min(_LARGEST_SIDE_PX, *(n // _SIDE_STEP_PX * _SIDE_STEP_PX for n in photos[0].shape))
        if side - 2 * margin_px < _LEAST_INSIDE_PX:
            return []
        top, left = pick_crops(photos[0], size=side, count=1)[0]  # where the scene has texture
        cut = [photo[top : top + side, left : left + side] for photo in photos]
        return scene_spectra(cut, grids=[side // part for part in (6, 3, 2)], margin_px=margin_px)

    def _pack(self, paths: FloatArray) -> Tensor:
        """Candidates of paths (B, K, 2), centred, with the kernels' shifts that lay centroid on centroid."""
        centred = torch.tensor(paths - paths.mean(axis=1, keepdims=True), dtype=torch.float32)
        shifts = self.centroids.float() - self.otfs.centroids(centred)
        gains = torch.tensor(np.tile(self.exposures.gains, (len(paths), 1)), dtype=torch.float32)
        return self.unknowns.pack(centred, gains, shifts)

    def from_walks(self, known: Sequence[FloatArray]) -> Tensor:
        """Candidates from random walks, and from paths (K, 2) that were found before."""
        lengths = _USUAL_PX * self.rng.uniform(0.5, 1.5, _LONE_WALKS)
        x = self._pack(np.stack([*known, *(self._walk(length) for length in lengths)]))
        return self.scenes[0].registered(x)

    def from_kernels(self) -> Tensor:
        """Candidates from all kinds of starts, fitted to the kernels."""
        from motdiff.estimators.multiscale import without_faint_parts
        from motdiff.tracing import simplest_trajectory

        traced = simplest_trajectory(without_faint_parts(self.exposures.kernels[0]))
        self.length_px = float(np.clip(traced.length_px, 8, 90))
        starts = [
            self._decoded(_DECODED),
            orders(traced, knots=_KNOTS, most=_ORDERS),
            np.stack([self._walk(self.length_px) for _ in range(_WALKS)]),
        ]
        x = self._pack(np.concatenate(starts))
        for term, keep in zip(self.kernels.values(), (48, 24, 10), strict=True):
            x, _ = self._best([term, self.loose], x, steps=8, keep=keep)
        return self.scenes[0].registered(x) if self.scenes else x

    def _walk(self, length_px: float) -> FloatArray:
        return boracchi_foi(self.rng, max_length_px=length_px).at(np.linspace(0, 1, _KNOTS))

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
            new = self._pack(np.stack(self._children(x)))
            if self.belief == 1:
                new, _ = descend([self.kernels[2.5], self.loose], new, steps=3)
                new, _ = self._best([self.kernels[1.5], self.loose], new, steps=4, keep=keep)
            if self.scenes:
                coarse: list[Term] = [self.scenes[0], self.sharpest, self.loose]
                new = self.scenes[0].registered(new)
                if self.belief < 1:
                    new, _ = self._best(coarse, new, steps=1, keep=keep)
                if self.scenes[0] not in terms:
                    new, _ = descend(coarse, new, steps=3)
            new, reached = descend(terms, new, steps=steps)
            before = float(costs.min())
            x, costs = self._distinct(torch.cat([x, new]), torch.cat([costs, reached]), keep=_POPULATION)
            still = 0 if float(costs[0]) < _IMPROVED * before else still + 1
            self.spend(share / rounds)
            if still == _STILL:
                self.spend(share * (rounds - 1 - done) / rounds)
                break
        return x, costs

    def _children(self, x: Tensor) -> list[FloatArray]:
        shifts = self.unknowns.kernel_shifts(x)
        paths = (self.unknowns.paths(x) + shifts[:, :1]).numpy().astype(np.float64)  # all laid on the first kernel
        children = []
        for i, path in enumerate(paths[:_PARENTS]):
            others = [paths[j] for j in range(len(paths)) if j != i]
            if i < 2:
                others += list(self._decoded(12, shifts[i].numpy().astype(np.float64)))
            children += loop_reversals(path, most=4 if i < 2 else 2, rng=self.rng)
            children += [child for other in others if (child := crossed(path, other, rng=self.rng)) is not None]
        return children

    def _best(self, terms: Sequence[Term], x: Tensor, *, steps: int, keep: int) -> tuple[Tensor, Tensor]:
        return self._distinct(*descend(terms, x, steps=steps), keep=keep)

    def _distinct(self, x: Tensor, costs: Tensor, *, keep: int) -> tuple[Tensor, Tensor]:
        """Best candidates, none nearer than 0.3 px rms to a better one."""
        paths, kept = self.unknowns.paths(x), list[int]()
        for i in torch.argsort(costs).tolist():
            apart = [paths[i] - paths[j] for j in kept]
            if all(float((d - d.mean(0)).square().sum(1).mean().sqrt()) > _DISTINCT_PX for d in apart):
                kept.append(i)
            if len(kept) == keep:
                break
        return x[kept], costs[kept]

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
            path = self.unknowns.paths(one)[0].numpy().astype(np.float64)
            found.append(FoundPath(path, float(costs[i]), misfit, np.asarray(deviation, dtype=np.float64)))
        return found
