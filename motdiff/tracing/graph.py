"""A drawn path as a graph: thin lines between ends and crossings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, spatial

from motdiff.types import BoolArray, FloatArray

_EIGHT = np.ones((3, 3), dtype=bool)
_PINHOLE_AREA = 2  # pixels: such holes lie between strands that run along each other
_SOFT_HIGH = 0.5  # hysteresis on a soft map, as parts of its maximum
_SOFT_LOW = 0.25


@dataclass(frozen=True)
class Branch:
    """A line between two nodes.

    Attributes
    ----------
    points : (n, 2) float, n >= 2
        Column and row along the line, pixels of the map, nodes included.
    ends : (int, int)
        Nodes at its first and last point.
    extra_px : float
        Drawn pixels beyond those of a single line of usual width: the mark of strands side by
        side.
    optional : bool
        True for a guess across a gap: a trail may use it but need not.
    worth : float, 0..1
        Weight of its pixels where a trail leaves them out: small for a faint line among bright
        ones.
    """

    points: FloatArray
    ends: tuple[int, int]
    extra_px: float = 0.0
    optional: bool = False
    worth: float = 1.0


@dataclass(frozen=True)
class BranchGraph:
    """Nodes (M, 2) (column, row) and the branches between them."""

    nodes: FloatArray
    branches: tuple[Branch, ...]


def drawn_pixels(hr_map: ArrayLike) -> BoolArray:
    """Mask of the path's pixels in a binary or soft map (hysteresis threshold relative to its
    maximum).

    Raises
    ------
    ValueError
        If the map is not a finite, non-negative (H, W) array with something drawn in it.
    """
    soft = np.asarray(hr_map, dtype=np.float64)
    if soft.ndim != 2 or not np.isfinite(soft).all() or soft.min(initial=0.0) < 0:
        raise ValueError(
            f"hr_map: must be a finite, non-negative (H, W) array, got shape {soft.shape}"
        )
    peak = float(soft.max(initial=0.0))
    if peak <= 0:
        raise ValueError(
            "hr_map: nothing is drawn in it (all zero); needs at least one pixel of path"
        )
    labels, _ = ndimage.label(soft >= _SOFT_LOW * peak, structure=_EIGHT)
    strong = np.unique(labels[soft >= _SOFT_HIGH * peak])
    return np.asarray(np.isin(labels, strong[strong > 0]), dtype=bool)


def branch_graph(
    drawn: BoolArray, *, gap_px: float = 6.0, speck_px: int = 4, spur_px: float = 0.0
) -> BranchGraph:
    """Skeletonise the drawn pixels, join their parts and split them into branches at ends and
    crossings.

    Parameters
    ----------
    drawn : (H, W) bool
    gap_px : float
        Longest gap bridged, in pixels of the map. Parts further away are kept only if they are the
        largest.
    speck_px : int
        Parts of fewer pixels than this are dust when there is anything larger.
    spur_px : float
        Dead ends shorter than this are taken off, shortest first; of a forked tip the longer prong
        stays.
    """
    from skimage.morphology import skeletonize

    # padded, so that lines along the frame thin like any others
    thin = np.asarray(skeletonize(_without_pinholes(np.pad(drawn, 1))), dtype=bool)[1:-1, 1:-1]
    skeleton = _joined_parts(thin, gap_px, speck_px)
    nodes, branches = _split(skeleton)
    while spurs := _spurs(nodes, branches, spur_px):
        for branch in spurs:
            column, row = np.rint(branch.points[1:]).astype(np.intp).T
            skeleton[row, column] = False
        nodes, branches = _split(skeleton)
    branches = _with_extra(branches, drawn)
    return BranchGraph(nodes, (*branches, *_gap_branches(nodes, branches, gap_px)))


def _without_pinholes(drawn: BoolArray) -> BoolArray:
    labels, _ = ndimage.label(~drawn)
    area = np.bincount(labels.ravel())
    return np.asarray(drawn | (area[labels] <= _PINHOLE_AREA), dtype=bool)


def _joined_parts(skeleton: BoolArray, gap_px: float, speck_px: int) -> BoolArray:
    """Keep the largest part, and every part that short straight bridges can reach, with the
    bridges drawn.
    """
    labels, count = ndimage.label(skeleton, structure=_EIGHT)
    if count <= 1:
        return skeleton
    parts = [np.argwhere(labels == label) for label in range(1, count + 1)]
    parts.sort(key=len, reverse=True)
    kept = parts[0]
    rest = [part for part in parts[1:] if len(part) >= speck_px]
    joined = np.zeros_like(skeleton)
    joined[tuple(kept.T)] = True
    while rest:
        tree = spatial.cKDTree(kept)
        reaches = [tree.query(part) for part in rest]
        nearest = int(np.argmin([distance.min() for distance, _ in reaches]))
        distance, index = reaches[nearest]
        if distance.min() > max(gap_px, 1.5):
            break
        part = rest.pop(nearest)
        here = int(np.argmin(distance))
        bridge = np.rint(
            np.linspace(part[here], kept[index[here]], int(np.ceil(distance[here])) + 1)
        ).astype(np.intp)
        joined[tuple(part.T)] = True
        joined[tuple(bridge.T)] = True
        kept = np.concatenate([kept, part, bridge])
    return joined


def _neighbours(skeleton: BoolArray, pixels: NDArray[np.intp]) -> list[list[int]]:
    """8-neighbours of each pixel; a diagonal step is dropped where two straight steps make it."""
    number = np.full(np.add(skeleton.shape, 2), -1, dtype=np.intp)
    number[pixels[:, 0] + 1, pixels[:, 1] + 1] = np.arange(len(pixels))
    found: list[list[int]] = [[] for _ in range(len(pixels))]
    for i, (row, column) in enumerate(pixels + 1):
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                j = int(number[row + dr, column + dc])
                if j < 0 or j == i:
                    continue
                if dr and dc and (number[row + dr, column] >= 0 or number[row, column + dc] >= 0):
                    continue
                found[i].append(j)
    return found


def _spurs(nodes: FloatArray, branches: list[Branch], spur_px: float) -> list[Branch]:
    """Find the shortest short dead end at each crossing, turned so that it starts at the
    crossing.
    """
    degree = np.bincount([end for branch in branches for end in branch.ends], minlength=len(nodes))
    shortest: dict[int, Branch] = {}
    for branch in branches:
        turned = (
            branch
            if degree[branch.ends[1]] == 1
            else Branch(branch.points[::-1], branch.ends[::-1])
        )
        crossing, tip = turned.ends
        if degree[tip] != 1 or degree[crossing] < 3 or len(branch.points) - 1 >= spur_px:
            continue
        if crossing not in shortest or len(branch.points) < len(shortest[crossing].points):
            shortest[crossing] = turned
    return list(shortest.values())


def _split(skeleton: BoolArray) -> tuple[FloatArray, list[Branch]]:
    pixels = np.argwhere(skeleton)
    neighbours = _neighbours(skeleton, pixels)
    position = pixels[:, ::-1].astype(np.float64)
    node_of: dict[int, int] = {}
    nodes: list[FloatArray] = []

    def add_node(members: list[int]) -> None:
        node_of.update(dict.fromkeys(members, len(nodes)))
        nodes.append(position[members].mean(axis=0))

    crossing = [len(near) > 2 for near in neighbours]
    for start in range(len(pixels)):
        if start in node_of or len(neighbours[start]) == 2:
            continue
        cluster = [start]
        queue = [start] if crossing[start] else []
        while queue:  # crossings drawn several pixels wide are one node
            for j in neighbours[queue.pop()]:
                if crossing[j] and j not in cluster:
                    cluster.append(j)
                    queue.append(j)
        add_node(cluster)
    branches: list[Branch] = []
    used: set[int] = set()

    def walk(first: int, second: int) -> None:
        line = [first, second]
        while line[-1] not in node_of:
            used.add(line[-1])
            a, b = neighbours[line[-1]]
            line.append(b if a == line[-2] else a)
        ends = node_of[line[0]], node_of[line[-1]]
        inner = position[line[1:-1]] if len(line) > 2 else np.empty((0, 2))
        points = np.concatenate([nodes[ends[0]][None], inner, nodes[ends[1]][None]])
        branches.append(Branch(points, ends))

    for start in list(node_of):
        for second in neighbours[start]:
            if second in node_of:  # neighbouring nodes; a cluster is not joined to itself
                if start < second and node_of[start] != node_of[second]:
                    walk(start, second)
            elif second not in used:
                walk(start, second)
    for start in range(
        len(pixels)
    ):  # what is left are loops without any crossing: cut them at their sharpest bend
        if start in node_of or start in used:
            continue
        loop = [start, neighbours[start][0]]
        while loop[-1] != start:
            a, b = neighbours[loop[-1]]
            loop.append(b if a == loop[-2] else a)
        cut = loop[_sharpest(position[loop[:-1]])]
        add_node([cut])
        walk(cut, neighbours[cut][0])
    return np.array(nodes), branches


def _sharpest(loop: FloatArray, reach: int = 5) -> int:
    ahead = np.roll(loop, -reach, axis=0) - loop
    behind = loop - np.roll(loop, reach, axis=0)
    norms = np.linalg.norm(ahead, axis=1) * np.linalg.norm(behind, axis=1)
    return int(np.argmin(np.sum(ahead * behind, axis=1) / np.maximum(norms, 1e-9)))


def _with_extra(branches: list[Branch], drawn: BoolArray) -> list[Branch]:
    if not branches:
        return branches
    owner = np.repeat(np.arange(len(branches)), [len(branch.points) for branch in branches])
    _, nearest = spatial.cKDTree(np.concatenate([branch.points for branch in branches])).query(
        np.argwhere(drawn)[:, ::-1]
    )
    area = np.bincount(owner[nearest], minlength=len(branches)).astype(np.float64)
    steps = np.array([max(1, len(branch.points) - 1) for branch in branches])
    order = np.argsort(area / steps)
    # the width below which half of the line lies
    width = max(
        1.0,
        float((area / steps)[order][np.searchsorted(np.cumsum(steps[order]), 0.5 * steps.sum())]),
    )
    return [
        replace(branch, extra_px=float(min(max(0.0, area[i] / width - steps[i] - 1), steps[i])))
        for i, branch in enumerate(branches)
    ]


def _gap_branches(nodes: FloatArray, branches: list[Branch], gap_px: float) -> list[Branch]:
    """Find optional branches across gaps between loose ends of one part."""
    degree = np.bincount([end for branch in branches for end in branch.ends], minlength=len(nodes))
    loose = [int(i) for i in np.flatnonzero(degree == 1)]
    guesses = []
    for at, i in enumerate(loose):
        for j in loose[at + 1 :]:
            if np.linalg.norm(nodes[i] - nodes[j]) <= gap_px:
                guesses.append(Branch(nodes[[i, j]], (i, j), optional=True))
    return guesses
