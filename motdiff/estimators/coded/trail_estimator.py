"""Motion of a small light by its trails through known codes: estimator, and search of the path."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy import ndimage, optimize
from torch import Tensor

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.candidates import (
    UNEXPLAINED,
    CandidatePath,
    Evolution,
    candidate_paths,
    distance_px,
    distinct,
    explained_share,
    merged,
    motion_of_paths,
)
from motdiff.estimators.coded.codes import check_codes, middles, open_at
from motdiff.estimators.coded.misfit import Roughness, Term, descend
from motdiff.estimators.coded.starts import bridged, crossed, loop_reversals, orders
from motdiff.estimators.coded.trail_term import TrailTerm, TrailUnknowns, spot_px, trail_moments
from motdiff.estimators.point.estimator import background_light
from motdiff.motions import boracchi_foi
from motdiff.path_psfs import interpolated
from motdiff.photo_values import clipped_mask, luminance, numbered_photo
from motdiff.progress import Progress
from motdiff.psf_frame import PSF_PX
from motdiff.threads import one_thread_a_call
from motdiff.tracing.path import trace_psf_to_trajectory
from motdiff.trajectory import Trajectory, arc_lengths
from motdiff.types import FloatArray

_GAP_PX = 12  # within a trail, where the shutter was closed
_MARGIN_PX = 7  # around a trail: the spot's flanks
_MOST_PX = 160  # time and memory grow with the area
_TRAIL_SIGMA = 4.0  # of a 3 x 3 mean's noise
_PEAK_SIGMA = 12.0  # a trail's brightest pixel, against noise alone
_LEAST_NOISE = 1 / 255 / np.sqrt(12)  # 8 bits round by that
_MODEL_ERROR = 0.02  # of a pixel's light: the spot is no Gaussian, the pixels differ
_MOST_CLIPPED = 0.2  # share of a trail's pixels
# on simulated motions: docs/decisions/motion-estimation.md
_AGREED = 0.95
_ALONE = 0.3
_FOLDED = 0.6  # one photo of a path that meets itself, where two searches agree
_ERROR_RATIO = 1.5
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


class TrailEstimator:
    """Find the motion, with its order in time, of a small light's trail through a known code.

    The light, on a darker background and apart from others, is a Gaussian spot of fitted width.
    Each chip carries the same light, so one path must explain every pixel of the trail. Paths are
    searched from random walks, coarse to fine, until two searches end at one path.

    ``confidence`` is the probability that the order is right: the share of simulated motions of
    which it was, where two searches agreed or none did; lower on one photo of a path that meets
    itself, and where other paths explain the trails as well. ``details`` are as those of
    :class:`motdiff.estimators.coded.estimator.CodedEstimator`.

    Parameters
    ----------
    codes : sequence of str
        Bits of each photo's code, in the order of the photos; "1" throughout for an open shutter.
    seed : int
        Of the random starts.
    progress : callable, optional
        Called with the finished share 0..1.

    Raises as :func:`check_codes`.

    References
    ----------
    Howie et al., "Submillisecond fireball timing using de Bruijn timecodes", Meteoritics &
    Planetary Science 52, 2017.
    """

    method = "point"

    def __init__(
        self,
        codes: Sequence[str],
        *,
        seed: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        check_codes(codes)
        self._codes = tuple(codes)
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
            Where the light is in them, and how bright, may differ.

        Returns
        -------
        MotionEstimate with ``direction`` known; other explanations follow with their weights.

        Raises
        ------
        ValueError
            If the numbers of photos and codes differ, or a photo shows no light, or one that is
            cut off or saturated.
        """
        check_codes(self._codes, photos=len(photos))
        with one_thread_a_call():
            progress = Progress(self._tell)
            progress.expect(1.0)
            order = sorted(range(len(photos)), key=lambda i: -self._codes[i].count("1"))
            cut = []
            for i in order:
                with numbered_photo(i + 1, count=len(photos)):
                    cut.append(_trail(photos[i]))
            images, sigmas = zip(*cut, strict=True)
            codes = [self._codes[i] for i in order]
            search = _TrailSearch(codes, images, sigmas, np.random.default_rng(self._seed))
            estimate = _described(*search.run(progress), photos=len(photos))
            progress.finish()
            return estimate


def _trail(photo: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Trail of the brightest light without the background, and each pixel's standard deviation."""
    light = luminance(photo)
    above = light - background_light(light, PSF_PX)
    above = above - np.median(above)
    noise = max(float(1.4826 * np.median(np.abs(above))), _LEAST_NOISE)
    bright = ndimage.uniform_filter(above, 3) > _TRAIL_SIGMA * noise / 3
    joined = ndimage.binary_dilation(bright, iterations=_GAP_PX // 2)
    labels, count = ndimage.label(joined)
    if not count or above[bright].max() < _PEAK_SIGMA * noise:
        raise ValueError("shows no light above its background")
    sums = ndimage.sum_labels(np.where(bright, above, 0), labels, np.arange(1, count + 1))
    trail = bright & (labels == 1 + int(np.argmax(sums)))
    rows, columns = (np.flatnonzero(trail.any(axis=axis)) for axis in (1, 0))
    height, width = light.shape
    if rows[0] == 0 or columns[0] == 0 or rows[-1] == height - 1 or columns[-1] == width - 1:
        raise ValueError("the light's trail is cut off by the border")
    if max(np.ptp(rows), np.ptp(columns)) > _MOST_PX:
        raise ValueError(
            f"the light's trail is longer than {_MOST_PX} px; give the photo at a smaller size"
        )
    clipped = clipped_mask(photo)
    if clipped[trail].mean() > _MOST_CLIPPED:
        raise ValueError("the light is saturated on its trail; expose less or dim the light")
    crop = tuple(
        slice(max(0, index[0] - _MARGIN_PX), min(n, index[-1] + _MARGIN_PX + 1))
        for index, n in ((rows, height), (columns, width))
    )
    image = above[crop]
    sigma = np.sqrt(noise**2 + (_MODEL_ERROR * np.maximum(image, 0)) ** 2)
    other_lights = ndimage.binary_dilation(bright & ~trail, iterations=3)[crop]
    sigma[other_lights | clipped[crop]] = np.inf
    return np.where(other_lights, 0.0, image), sigma


def _described(paths: Sequence[CandidatePath], times: int, *, photos: int) -> MotionEstimate:
    best = paths[0]
    share = _ALONE
    if times > 1:
        folded = len(orders(Trajectory.from_samples(best.path), knots=len(best.path), count=4)) > 2
        share = _FOLDED if folded and photos == 1 else _AGREED
    excess = np.array(
        [0.5 * (path.cost - best.cost) / max(1.0, best.misfit) for path in paths[1:]]
    )
    likelihoods = np.exp(-np.minimum(excess, 700))  # against the best path's; 1e-304 at least
    share *= explained_share(best.misfit)
    return motion_of_paths(
        "point",
        paths,
        probability=float(share / (1 + likelihoods.sum())),
        shares=np.maximum(likelihoods, 1e-9),
        deviation_px=_ERROR_RATIO * best.deviation_px,
        details={"searches_agreeing": times},
    )


def run_by_light(
    path: FloatArray, image: FloatArray, is_open: FloatArray, *, width_px: float
) -> FloatArray:
    """Time a path (K, 2), px, by the light of its trail: each open moment carries as much.

    Parameters
    ----------
    path : (N, 2) float, px
        Points along it, in order; the origin is the middle of pixel ``(H // 2, W // 2)``.
    image : (H, W) float, non-negative
    is_open : (K - 1,) float
        Of each of the pieces of time that the knots bound.
    width_px : float
        Standard deviation of the spot.
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
    """Search of a path that explains trails, that with the most light first.

    Parameters
    ----------
    codes : sequence of I str
    images, sigmas : sequences of I (H, W) float
        Without background, and the standard deviation of each pixel, infinite where it says
        nothing; the middle of pixel ``(H // 2, W // 2)`` is the origin.
    """

    def __init__(
        self,
        codes: Sequence[str],
        images: Sequence[FloatArray],
        sigmas: Sequence[FloatArray],
        rng: np.random.Generator,
    ) -> None:
        self.images = images
        self.rng = rng
        chips = len(codes[0])
        self.unknowns = TrailUnknowns(chips * -(-_LEAST_PIECES // chips) + 1, len(codes))
        self.rough = Roughness(self.unknowns, _ROUGHNESS)
        self.coarse = []
        for blur_px, share in _COARSE:
            allowed = [
                np.maximum(sigma, share * image.max())
                for sigma, image in zip(sigmas, images, strict=True)
            ]
            self.coarse.append(TrailTerm(self.unknowns, codes, images, allowed, blur_px=blur_px))
        self.fine = TrailTerm(self.unknowns, codes, images, sigmas)
        self.is_open = open_at(codes, middles(self.unknowns.knots - 1))
        self.light = [
            image.sum() / is_open.mean()
            for image, is_open in zip(images, self.is_open, strict=True)
        ]
        self.moments = [trail_moments(image) for image in images]
        self.spot_px = min(spot_px(image) for image in images)

    def run(self, progress: Progress) -> tuple[list[CandidatePath], int]:
        """Paths that explain the trails, best first, and how many searches ended at the best.

        Searches, the later ones from random walks alone, are repeated until two end at one path
        that explains the trails, which is then no chance. The plan of ``progress`` holds a cost of
        1 for them already.
        """
        results: list[tuple[Tensor, Tensor]] = []
        for index in range(_SEARCHES):
            results.append(self.evolved(self.starts(traced=not index)))
            progress.spend(1 / (_SEARCHES + 1))
            x, costs, times = merged(
                self.unknowns, results, keep=_EVOLUTION.population, same_px=_SAME_PX
            )
            if times > 1 and self.misfit(x[:1]) < UNEXPLAINED:
                progress.spend((_SEARCHES - index) / (_SEARCHES + 1))
                break
        else:
            x, costs = self.evolved(x)  # crossings of several searches' ends
            progress.spend(1 / (_SEARCHES + 1))
            distances_px = [distance_px(self.unknowns, x[0], best[0]) for best, _ in results]
            times = max(1, sum(d < _SAME_PX for d in distances_px))
        terms: list[Term] = [self.fine, self.rough]
        paths = candidate_paths(
            self.unknowns, terms, x[:_RESULTS], costs[:_RESULTS], misfit=self.misfit
        )
        return paths, times

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
        paths: list[FloatArray] = []
        image = np.maximum(self.images[0], 0)
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
