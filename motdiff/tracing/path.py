"""Ordered path under a grey PSF: its ridges, and the smoothest walk that covers them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from motdiff.psf_frame import MAP_PITCH
from motdiff.tracing.dwell import checked_psf, fit_dwell
from motdiff.tracing.graph import BranchGraph, branch_graph
from motdiff.trajectory import Trajectory
from motdiff.types import BoolArray, FloatArray

# bends are felt through a Gaussian this wide: pixel stairs vanish, crossings stay straight
_SMOOTHING_PX = 2.0
_MEMORY_PX = 5 * _SMOOTHING_PX
_UNCOVERED_COST = 0.8  # per pixel of line left out
_REPEAT_COST = 0.03  # per pixel passed again
_GAP_COST = 0.6  # per pixel of a gap jumped
_BURIED_END_COST = 1.0  # for an end of the path that is no loose end of the lines
# a hand that stops and turns back is likelier than its bend of 180 degrees looks
_REVERSAL_RELIEF = 2.0
_PROMISE = 0.03  # per pixel still to cover, when partial walks are compared
_MOST_PASSES = 3
_BEAM = 300  # partial walks kept at each step
_MARGIN_PX = 3
_RIDGE_PX = 0.4  # scale of the ridge filter, on top of the 0.6 px of the spline that interpolates
_SPUR_PX = 7.0  # fine pixels: what a skeleton grows at blobs
_NOISY_SPUR_PX = 12.0
_NOISE_MEDIANS = 8.0  # ridges this far above the median response are no noise
_WEAK_SHARE = 0.015  # hysteresis, as shares of the strongest ridge
_STRONG_SHARE = 0.08
_LOCAL_SHARE = 0.1  # fainter crests so near a strong one are its side lobes
_LOCAL_PX = 1.5
_PSF_GAP_PX = 14.0  # fine pixels: fast stretches sink into noise
_DUST_SHARE = 0.04  # components with less ridge than this share of the largest are dust
_CREST_PX = 0.6  # a Gaussian this wide measures a line's light
_STAIR_PX = 1.0  # map pixels: a Gaussian this wide takes the pixel stairs off a traced line


@dataclass(frozen=True)
class _Line:
    """A branch in one direction, with its bends (changes of the unit tangent)."""

    start: int
    stop: int
    length: float
    first: FloatArray  # unit tangents at both ends
    last: FloatArray
    at: FloatArray  # (b,) arc length of each bend
    bends: FloatArray  # (b, 2)
    bend_cost: float


class _Walk(NamedTuple):  # made by the ten thousand
    cost: float
    uncovered_px: float  # weighted length of line
    passes: int  # two bits per branch
    recent: tuple[int, ...]  # directed branches that still influence the next turn
    before: _Walk | None
    step: int

    def steps(self) -> list[int]:
        """Return its directed branches, the first first."""
        steps = []
        walk = self
        while walk.before is not None:
            steps.append(walk.step)
            walk = walk.before
        return steps[::-1]


def smoothest_trail(graph: BranchGraph) -> FloatArray:
    """Walk over all branches with the least bending, as one polyline (N, 2) in map pixels.

    A walk pays for the bending energy of its Gaussian-smoothed curve, ``integral |G * p''|^2 ds``
    (a reversal costs 4, a right angle 2, going straight through a crossing nothing), for lines it
    runs along again, and for lines it leaves out. Since the energy is felt over several pixels, it
    decides at shallow crossings, where two strands share pixels, as well as at clean ones.

    The graph is in one part; points are column and row.
    """
    if not graph.branches:
        return graph.nodes[:1]
    steps = _TrailSearch(graph).best_walk().steps()
    polyline = [graph.branches[i // 2].points[:: -1 if i % 2 else 1] for i in steps]
    return np.concatenate([polyline[0], *(points[1:] for points in polyline[1:])])


class _TrailSearch:
    """Beam search over the walks of a graph.

    A step is a directed branch: ``2 branch`` along its points, ``2 branch + 1`` against them.
    """

    def __init__(self, graph: BranchGraph) -> None:
        self._lines = [
            _line(branch.points[::direction], branch.node_pair[::direction])
            for branch in graph.branches
            for direction in (1, -1)
        ]
        self._leaving: dict[int, list[int]] = {}
        for i, line in enumerate(self._lines):
            self._leaving.setdefault(line.start, []).append(i)
        self._optional = [branch.optional for branch in graph.branches]
        self._weight = [branch.weight for branch in graph.branches]
        self._extra_px = [branch.extra_px for branch in graph.branches]
        self._buried = {
            node: _BURIED_END_COST * (len(steps) > 1) for node, steps in self._leaving.items()
        }
        # cost of each turn, and the recent branches after it
        self._turns: dict[tuple[tuple[int, ...], int], tuple[float, tuple[int, ...]]] = {}

    def best_walk(self) -> _Walk:
        """Return the walk of least cost."""
        walks = self._starts()
        best = walks[0]
        best_cost = np.inf
        for _ in range(_MOST_PASSES * len(self._lines)):
            for walk in walks:
                end = self._lines[walk.step].stop
                final = walk.cost + self._buried[end] + _UNCOVERED_COST * walk.uncovered_px
                if final < best_cost - 1e-9:
                    best = walk
                    best_cost = final
            longer = (walk for beam in _beam(walks) for walk in self._continued(beam))
            # reliefs of later reversals may still lower the cost
            walks = [walk for walk in longer if walk.cost < best_cost + 4]
        return best

    def _starts(self) -> list[_Walk]:
        """Return all walks of one step."""
        total_px = sum(
            weight * (line.length + extra_px)
            for line, weight, extra_px, optional in zip(
                self._lines[::2], self._weight, self._extra_px, self._optional, strict=True
            )
            if not optional
        )
        starts = (
            self._extended(_Walk(self._buried[line.start], total_px, 0, (), None, -2), i)
            for i, line in enumerate(self._lines)
        )
        return [walk for walk in starts if walk is not None]

    def _continued(self, walk: _Walk) -> Iterator[_Walk]:
        """Yield a walk with each step that may follow; it turns back at a dead end alone."""
        if walk.uncovered_px < 1e-6:
            return
        following = self._leaving[self._lines[walk.step].stop]
        for i in following:
            if i != walk.step ^ 1 or len(following) == 1:
                longer = self._extended(walk, i)
                if longer is not None:
                    yield longer

    def _extended(self, walk: _Walk, i: int) -> _Walk | None:
        """Return a walk with one more step; None where its branch was passed often enough."""
        branch = i // 2
        line = self._lines[i]
        relief = _REVERSAL_RELIEF if walk.step == i ^ 1 else 0.0
        passes = (walk.passes >> 2 * branch) & 3
        if passes >= _MOST_PASSES or (self._optional[branch] and passes):
            return None
        turn = self._turns.get((walk.recent, i))
        if turn is None:
            turn = self._turns[walk.recent, i] = _turn(self._lines, walk.recent, i)
        cost = walk.cost + turn[0] - relief
        uncovered_px = walk.uncovered_px
        if self._optional[branch]:
            cost += _GAP_COST * line.length
        elif passes:
            cost += _REPEAT_COST * line.length + line.bend_cost
            if passes == 1:
                uncovered_px -= self._weight[branch] * self._extra_px[branch]
        else:
            uncovered_px -= self._weight[branch] * line.length
        return _Walk(cost, uncovered_px, walk.passes + (1 << 2 * branch), turn[1], walk, i)


def _beam(walks: Iterable[_Walk]) -> list[_Walk]:
    """Return the most promising walks; of those that passed and turn alike the cheapest one."""
    unique: dict[tuple[tuple[int, ...], int], _Walk] = {}
    for walk in walks:
        key = (walk.recent, walk.passes)
        if key not in unique or walk.cost < unique[key].cost:
            unique[key] = walk
    return sorted(unique.values(), key=lambda w: w.cost + _PROMISE * w.uncovered_px)[:_BEAM]


def _line(points: FloatArray, node_pair: tuple[int, ...]) -> _Line:
    smooth = points.copy()
    if len(points) > 2:
        smooth[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
    steps = np.diff(smooth, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    steps = steps[lengths > 1e-9]
    lengths = lengths[lengths > 1e-9]
    if not len(steps):
        steps = np.array([[1.0, 0.0]])
        lengths = np.array([1e-9])
    tangents = steps / lengths[:, None]
    at = np.cumsum(lengths)[:-1]
    bends = np.diff(tangents, axis=0)
    cost = float(np.sum(_coupling(at[:, None] - at[None, :]) * (bends @ bends.T)))
    length = float(lengths.sum())
    return _Line(node_pair[0], node_pair[1], length, tangents[0], tangents[-1], at, bends, cost)


def _coupling(distance_px: FloatArray) -> FloatArray:
    """Product of two bends' Gaussians, integrated along the curve; 1 at distance 0."""
    return np.asarray(np.exp(-((distance_px / (2 * _SMOOTHING_PX)) ** 2)), dtype=np.float64)


def _turn(
    lines: list[_Line], recent: tuple[int, ...], following: int
) -> tuple[float, tuple[int, ...]]:
    """Cost of going on along ``following``, and the branches that influence the turn after it."""
    cost = _turn_cost([lines[j] for j in recent], lines[following])
    recent = (*recent, following)
    while len(recent) > 1 and sum(lines[j].length for j in recent[1:]) >= _MEMORY_PX:
        recent = recent[1:]
    return cost, recent


def _turn_cost(recent: list[_Line], following: _Line) -> float:
    """Bending energy that a line adds: its corner's, and its bends' with the recent ones."""
    if not recent:
        return 0.0
    corner = following.first - recent[-1].last
    new_at = np.concatenate([np.zeros(1), following.at])
    new_bends = np.concatenate([corner[None], following.bends])
    old_at = []
    old_bends = []
    end = 0.0
    for k in range(len(recent) - 1, -1, -1):
        line = recent[k]
        old_at.append(line.at - line.length + end)
        old_bends.append(line.bends)
        end -= line.length
        if k:
            old_at.append(np.array([end]))
            old_bends.append((line.first - recent[k - 1].last)[None])
    past_at = np.concatenate(old_at)
    past_bends = np.concatenate(old_bends)
    couplings = _coupling(new_at[:, None] - past_at[None, :])
    with_past = 2 * np.sum(couplings * (new_bends @ past_bends.T))
    with_corner = 2 * np.sum(_coupling(following.at) * (following.bends @ corner))
    return float(with_past + with_corner + corner @ corner)


def trace_psf(psf: ArrayLike) -> FloatArray:
    """Trace the ordered path (N, 2), px, under a grey PSF: its ridges, straight at crossings.

    Parameters
    ----------
    psf : (H, W) array_like
        Non-negative, with zero displacement at index ``size // 2``; may be thick, speckled or
        noisy.

    Raises
    ------
    ValueError
        If the PSF is not finite and non-negative, or has no light.
    """
    light = checked_psf(psf)
    crests, spur_px = _ridges(light)
    middle = np.array([light.shape[1] // 2, light.shape[0] // 2])
    graph = branch_graph(crests, gap_px=_PSF_GAP_PX, spur_px=spur_px)
    return path_of(_with_weights(graph, light), MAP_PITCH * middle + MAP_PITCH * _MARGIN_PX)


def trace_psf_to_trajectory(psf: ArrayLike) -> Trajectory:
    """Turn a PSF into a trajectory: :func:`trace_psf`, then its dwell.

    Parameters
    ----------
    psf : (H, W) array_like
        As :func:`trace_psf`.
    """
    return fit_dwell(trace_psf(psf), psf)


def _ridges(light: FloatArray) -> tuple[BoolArray, float]:
    """Mark the crests of ridges on a padded grid of pitch 1/4 px, and the length of spurs on it.

    A crest is a local maximum across the ridge: so a fast, faint stretch shows next to a slow,
    bright one.
    """
    padded = np.pad(light / light.max(), _MARGIN_PX)
    grid = np.meshgrid(
        *(np.arange(MAP_PITCH * (n - 1) + 1) / MAP_PITCH for n in padded.shape), indexing="ij"
    )
    # without the prefilter the spline smooths: no overshoot
    fine = ndimage.map_coordinates(padded, grid, order=3, prefilter=False)
    sigma = _RIDGE_PX * MAP_PITCH
    yy, xx, xy = (
        ndimage.gaussian_filter(fine, sigma, order=order) for order in ((2, 0), (0, 2), (1, 1))
    )
    # the negative of the Hessian's smaller eigenvalue, and its direction across the ridge
    ridge = np.maximum(0.5 * (np.hypot(xx - yy, 2 * xy) - xx - yy), 0.0)
    across = 0.5 * np.arctan2(2 * xy, xx - yy) + 0.5 * np.pi
    peak = float(ridge.max())
    noise = _NOISE_MEDIANS * float(np.median(ridge))
    spur_px = _SPUR_PX if noise < _WEAK_SHARE * peak else _NOISY_SPUR_PX
    index = np.indices(ridge.shape).astype(np.float64)
    step = np.stack([np.sin(across), np.cos(across)])
    beside = np.maximum(
        *(ndimage.map_coordinates(ridge, index + sign * step, order=1) for sign in (-1, 1))
    )
    weak = max(_WEAK_SHARE * peak, noise)
    strong = max(_STRONG_SHARE * peak, 1.7 * weak)
    local_peak = ndimage.maximum_filter(ridge, int(2 * _LOCAL_PX * MAP_PITCH) + 1)
    crest = (ridge >= beside) & (ridge >= np.maximum(weak, _LOCAL_SHARE * local_peak))
    crest = ndimage.binary_dilation(crest, structure=np.ones((3, 3)))
    labels, count = ndimage.label(crest, structure=np.ones((3, 3)))
    if not count:
        return np.asarray(fine >= fine.max(), dtype=bool), 0.0
    numbers = np.arange(count + 1)
    mass = ndimage.sum_labels(ridge, labels, numbers)
    is_path = (mass >= _DUST_SHARE * mass[1:].max()) & (
        ndimage.maximum(ridge, labels, numbers) >= min(strong, ridge.max())
    )
    is_path[0] = False  # the background
    return np.asarray(is_path[labels], dtype=bool), spur_px


def _with_weights(graph: BranchGraph, light: FloatArray) -> BranchGraph:
    """Weigh each line by the square of its light over the median's, at most 1: noise is faint."""
    if not graph.branches:
        return graph
    soft = ndimage.gaussian_filter(np.pad(light, _MARGIN_PX), _CREST_PX)
    crests = [
        ndimage.map_coordinates(soft, branch.points[:, ::-1].T / MAP_PITCH, order=1)
        for branch in graph.branches
    ]
    # the median is 0 where most of the lines are bridges over dark gaps
    median = max(float(np.median(np.concatenate(crests))), np.finfo(float).tiny)
    branches = [
        replace(branch, weight=min(1.0, float(crest.mean()) / median) ** 2)
        for branch, crest in zip(graph.branches, crests, strict=True)
    ]
    return replace(graph, branches=tuple(branches))


def path_of(graph: BranchGraph, centre: float | FloatArray) -> FloatArray:
    """Path (N, 2), px, along a graph's smoothest trail, from ``centre``, its place on the map."""
    return (_without_stairs(smoothest_trail(graph)) - centre) / MAP_PITCH


def _without_stairs(points: FloatArray) -> FloatArray:
    """Smooth a pixel polyline along its length; its two ends stay."""
    if len(points) < 3:
        return points
    pad = min(6, len(points) - 1)
    before = 2 * points[0] - points[pad:0:-1]  # mirrored through the ends
    after = 2 * points[-1] - points[-2 : -pad - 2 : -1]
    smooth = ndimage.gaussian_filter1d(np.concatenate([before, points, after]), _STAIR_PX, axis=0)
    return np.asarray(smooth[pad:-pad], dtype=np.float64)
