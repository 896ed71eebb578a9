"""The smoothest walk that covers a drawn path: beam search over a branch graph."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from motdiff.tracing.graph import BranchGraph
from motdiff.types import FloatArray

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
    """Find the walk over all branches with the least bending, and return it as one polyline.

    A walk pays for the bending energy of its Gaussian-smoothed curve, ``integral |G * p''|^2 ds``
    (a reversal costs 4, a right angle 2, going straight through a crossing nothing), for lines it
    runs along again, and for lines it leaves out. Since the energy is felt over several pixels, it
    decides at shallow crossings, where two strands share pixels, as well as at clean ones.

    Parameters
    ----------
    graph : BranchGraph
        In one part.

    Returns
    -------
    (N, 2) float, column and row in the pixels of the map.
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
