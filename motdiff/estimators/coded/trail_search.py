"""Search for the path whose trails a small light drew through known codes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage, optimize
from torch import Tensor

from motdiff.estimators.coded.candidates import (
    UNEXPLAINED,
    CandidatePath,
    Evolution,
    distance_px,
    distinct,
    expected_deviation_px,
    merged,
)
from motdiff.estimators.coded.codes import middles, open_at
from motdiff.estimators.coded.misfit import Roughness, Term, descend
from motdiff.estimators.coded.starts import bridged, crossed, loop_reversals, orders
from motdiff.estimators.coded.trail_term import TrailTerm, TrailUnknowns
from motdiff.motions import boracchi_foi
from motdiff.path_psfs import interpolated
from motdiff.progress import Progress
from motdiff.trajectory import arc_lengths
from motdiff.types import FloatArray

_LEAST_PIECES = 52  # of time; each chip has a whole number of them
_ROUGHNESS = 10.0  # second differences of 0.3 px at 53 knots
# blur, px, and the error allowed, as a share of the brightest pixel
_COARSE = ((4.0, 0.06), (2.5, 0.04), (1.5, 0.02), (1.0, 0.007))
_STARTS = 160  # random walks of a search
_SELECTED = (80, 40, 20)  # after each coarse blur
_SAME_PX = 0.3  # nearer paths are one: trails tell a path to a fraction of a pixel
_EVOLUTION = Evolution(rounds=40, patience=6, improved=0.98, population=12, apart_px=_SAME_PX)
_PARENTS = 6  # crossed with each other
_NEWCOMERS = 8  # walks of each round, against inbreeding
_REROUTED = 5  # children of a parent with a stretch drawn anew
_SEARCHES = 5
_RESULTS = 4
_WALK_PX = (20.0, 90.0)  # length of a path, px
_LONGEST_PX = 160.0  # walks stretched to the trail's shape are drawn again beyond it
_TRACE_BLURS_PX = (0.7, 1.2, 2.0)  # bridge the gaps of closed chips
_FAINT = 0.04
_TRACED_POINTS = 161
_ORDERS = 24
_PIECE_PX = 0.5  # of a traced path whose light is measured; how even it is
_MOST_PIECES = 140
_EVEN = 0.05
_SLIP = 0.03  # of time, where a path is run earlier or later
_SLIP_SPAN = 0.15  # share of the exposure over which it lasts


@dataclass(frozen=True)
class Trails:
    """A small light's trails, that with the most light first.

    Attributes
    ----------
    codes : tuple of I str
    images : tuple of I (H, W) float
        Without background; the middle of pixel ``(H // 2, W // 2)`` is the origin.
    sigmas : tuple of I (H, W) float
        Standard deviation of each pixel; infinite where it says nothing.
    """

    codes: tuple[str, ...]
    images: tuple[FloatArray, ...]
    sigmas: tuple[FloatArray, ...]


def find_trail_paths(
    trails: Trails,
    *,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[list[CandidatePath], int]:
    """Find the paths that explain the trails best.

    Searches, the later ones from random walks alone, are repeated until two of them end at one
    path that explains the trails, which is then no chance.

    Parameters
    ----------
    progress : Progress, optional
        Its plan holds a cost of 1 for this work already.

    Returns
    -------
    list of CandidatePath, best first, and the number of searches that ended at the best one
    """
    progress = progress or Progress()
    search = _TrailSearch(trails, rng)
    results: list[tuple[Tensor, Tensor]] = []
    for index in range(_SEARCHES):
        results.append(search.evolved(search.starts(traced=not index)))
        progress.spend(1 / (_SEARCHES + 1))
        x, costs, times = merged(
            search.unknowns, results, keep=_EVOLUTION.population, same_px=_SAME_PX
        )
        if times > 1 and search.misfit(x[:1]) < UNEXPLAINED:
            progress.spend((_SEARCHES - index) / (_SEARCHES + 1))
            break
    else:
        x, costs = search.evolved(x)  # crossings of several searches' ends
        progress.spend(1 / (_SEARCHES + 1))
        times = max(
            1, sum(distance_px(search.unknowns, x[0], best[0]) < _SAME_PX for best, _ in results)
        )
    return search.described(x[:_RESULTS], costs[:_RESULTS]), times


def run_by_light(
    path: FloatArray, image: FloatArray, is_open: FloatArray, *, width_px: float
) -> FloatArray:
    """Time a path by the light of its trail: each open moment carries as much.

    Parameters
    ----------
    path : (N, 2) float, px
        Points along it, in order; the origin is the middle of pixel ``(H // 2, W // 2)``.
    image : (H, W) float, non-negative
    is_open : (K - 1,) float
        Of each of the pieces of time that the knots bound.
    width_px : float
        Standard deviation of the spot.

    Returns
    -------
    (K, 2) float, px, at evenly spaced times
    """
    arc = arc_lengths(path)
    pieces = int(np.clip(arc[-1] / _PIECE_PX, 20, _MOST_PIECES))
    edges = np.linspace(0, arc[-1], pieces + 1)
    spots = interpolated(0.5 * (edges[1:] + edges[:-1]), arc, path)
    down, across = (
        np.exp(-0.5 * ((np.arange(n) - n // 2 - spots[:, axis, None]) / width_px) ** 2)
        for n, axis in zip(image.shape, (1, 0), strict=True)
    )
    shapes = (down[:, :, None] * across[:, None]).reshape(pieces, -1).T
    even = _EVEN * np.linalg.norm(shapes, axis=0).mean() * np.diff(np.eye(pieces), axis=0)
    matrix = shapes.T @ shapes + even.T @ even
    factor = np.linalg.cholesky(matrix + 1e-6 * np.trace(matrix) / pieces * np.eye(pieces))
    light, _ = optimize.nnls(factor.T, np.linalg.solve(factor, shapes.T @ image.ravel()))
    # a little light everywhere, and at all times: where the shutter is closed the path goes on
    by_arc = np.concatenate([[0.0], np.cumsum(light / max(light.sum(), 1e-12) + 1e-3 / pieces)])
    by_time = np.concatenate([[0.0], np.cumsum(is_open / is_open.sum() + 1e-3 / is_open.size)])
    return interpolated(np.interp(by_time / by_time[-1], by_arc / by_arc[-1], edges), arc, path)


class _TrailSearch:
    def __init__(self, trails: Trails, rng: np.random.Generator) -> None:
        self.trails = trails
        self.rng = rng
        chips = len(trails.codes[0])
        self.unknowns = TrailUnknowns(chips * -(-_LEAST_PIECES // chips) + 1, len(trails.codes))
        self.rough = Roughness(self.unknowns, _ROUGHNESS)
        peak = [float(image.max()) for image in trails.images]
        self.coarse = [
            self._term(
                [
                    np.maximum(sigma, share * top)
                    for sigma, top in zip(trails.sigmas, peak, strict=True)
                ],
                blur_px,
            )
            for blur_px, share in _COARSE
        ]
        self.fine = self._term(trails.sigmas, 0.0)
        self.is_open = open_at(trails.codes, middles(self.unknowns.knots - 1))
        self.light = [
            image.sum() / is_open.mean()
            for image, is_open in zip(trails.images, self.is_open, strict=True)
        ]
        self.moments = [_moments(image) for image in trails.images]
        self.spot_px = min(_spot_px(image) for image in trails.images)

    def _term(self, sigmas: Sequence[FloatArray], blur_px: float) -> TrailTerm:
        return TrailTerm(
            self.unknowns, self.trails.codes, self.trails.images, sigmas, blur_px=blur_px
        )

    def misfit(self, x: Tensor) -> float:
        """Misfit of a candidate (1, N), with its roughness, as a multiple of the noise.

        Where the shutter is closed a wrong path costs no light, but seldom is it smooth.
        """
        return float(self.fine.cost(x) + self.rough.cost(x)) / self.fine.values

    def starts(self, *, traced: bool) -> Tensor:
        """Paths from new random walks, and traced ones where asked, fitted coarse to fine."""
        paths = self._traced() if traced else []
        paths += [self._walk() for _ in range(_STARTS)]
        x = self._pack(np.stack(paths))
        for term, keep in zip(self.coarse[:3], _SELECTED, strict=True):
            x, _ = self._best([term, self.rough], x, steps=6, keep=keep)
        return x

    def evolved(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Paths crossed, their loops reversed and stretches rerouted, while it helps."""
        finest: list[Term] = [self.coarse[3], self.rough]
        x, costs = self._best(finest, x, steps=6, keep=_EVOLUTION.population)

        def changed(parents: Tensor) -> tuple[Tensor, Tensor]:
            new = self._pack(np.stack(self._children(parents)))
            new, _ = descend([self.coarse[1], self.rough], new, steps=2)
            new, _ = self._best(
                [self.coarse[2], self.rough], new, steps=4, keep=2 * _EVOLUTION.population
            )
            return descend(finest, new, steps=5)

        x, _ = _EVOLUTION.run(self.unknowns, x, costs, changed=changed)
        return self._best([self.fine, self.rough], x[:6], steps=20, keep=_RESULTS)

    def _traced(self) -> list[FloatArray]:
        """Orders of paths traced in the first photo, gaps bridged by blur, timed by its light."""
        from motdiff.tracing import trace_psf_to_trajectory

        paths: list[FloatArray] = []
        image = np.maximum(self.trails.images[0], 0)
        centre = np.array([image.shape[1] // 2, image.shape[0] // 2])
        for blur_px in _TRACE_BLURS_PX:
            soft = ndimage.gaussian_filter(image, blur_px)
            soft[soft < _FAINT * soft.max()] = 0
            try:
                traced = trace_psf_to_trajectory(soft)
            except ValueError:  # a dot
                continue
            rows, columns = np.indices(soft.shape)
            middle = np.array([(soft * columns).sum(), (soft * rows).sum()]) / soft.sum() - centre
            paths += [
                run_by_light(path + middle, image, self.is_open[0], width_px=self.spot_px + 0.3)
                for path in orders(traced, knots=_TRACED_POINTS, count=_ORDERS)
            ]
        return paths

    def _walk(self) -> FloatArray:
        """Random walk (K, 2) whose trail has the first photo's centroid and covariance."""
        centre, spread = self.moments[0]
        spread = spread - (self.spot_px**2 + 1 / 12 - 0.05) * np.eye(2)
        values, axes = np.linalg.eigh(spread)
        shape = axes @ np.diag(np.sqrt(np.maximum(values, 0.05)))
        times = np.linspace(0, 1, self.unknowns.knots)
        while True:
            length_px = self.rng.uniform(*_WALK_PX)
            walk = boracchi_foi(self.rng, max_length_px=length_px, samples=500).at(times)
            middle = 0.5 * (walk[1:] + walk[:-1])
            mean = np.average(middle, axis=0, weights=self.is_open[0])
            covariance = np.cov((middle - mean).T, aweights=self.is_open[0])
            root = np.linalg.cholesky(covariance + 1e-3 * np.eye(2))
            turn, _ = np.linalg.qr(self.rng.standard_normal((2, 2)))
            path = (shape @ turn @ np.linalg.solve(root, (walk - mean).T)).T + centre
            if np.linalg.norm(np.diff(path, axis=0), axis=1).sum() < _LONGEST_PX:
                return np.asarray(path, dtype=np.float64)

    def _pack(self, paths: FloatArray) -> Tensor:
        """Candidates of paths (B, K, 2), moved so that each trail has its photo's centroid."""
        middle = 0.5 * (paths[:, 1:] + paths[:, :-1])
        shifts = np.stack(
            [
                centre - np.einsum("bsd,s->bd", middle, is_open / is_open.sum())
                for (centre, _), is_open in zip(self.moments, self.is_open, strict=True)
            ],
            axis=1,
        )
        paths = paths + shifts[:, :1]
        count = len(paths)
        return self.unknowns.pack_trails(
            torch.tensor(paths, dtype=torch.float32),
            torch.tensor(shifts - shifts[:, :1], dtype=torch.float32),
            torch.tensor(self.light, dtype=torch.float32).expand(count, -1),
            torch.full((count,), self.spot_px),
        )

    def _children(self, x: Tensor) -> list[FloatArray]:
        paths = self.unknowns.paths(x).numpy().astype(np.float64)
        children = [self._walk() for _ in range(_NEWCOMERS)]
        for i, path in enumerate(paths[:_PARENTS]):
            children += loop_reversals(path, count=5, rng=self.rng)
            partners = (*paths[:i], *paths[i + 1 :])
            crossings = (crossed(path, partner, rng=self.rng) for partner in partners)
            children += [child for child in crossings if child is not None]
            children += [self._slipped(path), path[::-1]]
            children += [bridged(path, self._walk(), rng=self.rng) for _ in range(_REROUTED)]
        return children

    def _slipped(self, path: FloatArray) -> FloatArray:
        """Path that runs earlier or later for a while."""
        times = np.linspace(0, 1, len(path))
        window = np.exp(-0.5 * ((times - self.rng.uniform()) / _SLIP_SPAN) ** 2)
        slipped = np.clip(times + self.rng.normal(0, _SLIP) * window, 0, 1)
        return interpolated(slipped, times, path)

    def _best(
        self, terms: Sequence[Term], x: Tensor, *, steps: int, keep: int
    ) -> tuple[Tensor, Tensor]:
        """Candidates after some steps of descent, the best of them."""
        return distinct(
            self.unknowns, *descend(terms, x, steps=steps), keep=keep, apart_px=_SAME_PX
        )

    def described(self, x: Tensor, costs: Tensor) -> list[CandidatePath]:
        """Candidates with their misfit and the standard deviations of their knots."""
        described = []
        for candidate, cost in zip(x[:, None], costs.tolist(), strict=True):
            misfit = self.misfit(candidate)
            path = self.unknowns.paths(candidate)[0].numpy().astype(np.float64)
            terms: list[Term] = [self.fine, self.rough]
            noise_factor = max(1.0, misfit) ** 0.5
            deviation_px = noise_factor * expected_deviation_px(self.unknowns, terms, candidate)
            described.append(CandidatePath(path, cost, misfit, deviation_px))
        return described


def _moments(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centroid (2,) and covariance (2, 2) of a trail, px, (x, y)."""
    weight = np.maximum(image, 0)
    weight = np.where(weight > 0.05 * weight.max(), weight, 0)
    rows, columns = np.indices(image.shape)
    x = columns.ravel() - image.shape[1] // 2
    y = rows.ravel() - image.shape[0] // 2
    points = np.stack([x, y], axis=-1)
    flat = weight.ravel() / weight.sum()
    centre = flat @ points
    offsets = points - centre
    return centre, (offsets * flat[:, None]).T @ offsets


def _spot_px(image: FloatArray) -> float:
    """Estimate the standard deviation of the light's spot, px, by the curvature of the ridges."""
    blur_px = 0.7
    soft = ndimage.gaussian_filter(image, blur_px)
    xx, yy, xy = (
        ndimage.gaussian_filter(image, blur_px, order=order) for order in ((0, 2), (2, 0), (1, 1))
    )
    sharpest = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
    ridge = ((soft == ndimage.maximum_filter(soft, 3)) | (soft > 0.5 * soft.max())) & (
        soft > 0.25 * soft.max()
    )
    ridge &= sharpest < 0
    width2 = float(np.percentile(-soft[ridge] / sharpest[ridge], 20)) if ridge.any() else 1.0
    return float(np.sqrt(np.clip(width2 - blur_px**2 - 1 / 12, 0.3**2, 3.0**2)))
