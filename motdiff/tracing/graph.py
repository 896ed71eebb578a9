"""A drawn path as a graph: thin lines between ends and crossings."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, spatial

from motdiff.types import BoolArray, FloatArray

_EIGHT = np.ones((3, 3), dtype=bool)
_PINHOLE_AREA = 2  # pixels: such holes lie between strands that run along each other
_SPECK_PX = 4  # components of fewer pixels are dust when there is anything larger
_BEND_REACH = 5  # pixels to either side of a bend


@dataclass(frozen=True)
class Branch:
    """A line between two nodes.

    Attributes
    ----------
    points : (n, 2) float, n >= 2
        Column and row along the line, pixels of the map, nodes included.
    node_pair : (int, int)
        Nodes at its first and last point.
    extra_px : float
        Path pixels beyond those of a single line of usual width: the mark of strands side by side.
    optional : bool
        True for a guess across a gap: a trail may use it but need not.
    weight : float, 0..1
        Of its pixels where a trail leaves them out: small for a faint line among bright ones.
    """

    points: FloatArray
    node_pair: tuple[int, int]
    extra_px: float = 0.0
    optional: bool = False
    weight: float = 1.0


@dataclass(frozen=True)
class BranchGraph:
    """Nodes (M, 2) (column, row) and the branches between them."""

    nodes: FloatArray
    branches: tuple[Branch, ...]


def branch_graph(mask: BoolArray, *, gap_px: float = 6.0, spur_px: float = 0.0) -> BranchGraph:
    """Skeletonise path pixels, join their components and split them at ends and crossings.

    Parameters
    ----------
    mask : (H, W) bool
    gap_px : float
        Longest gap bridged, in pixels of the map. Components further away are dropped unless they
        are the largest.
    spur_px : float
        Dead ends shorter than this are taken off, shortest first; of a forked tip the longer prong
        stays.
    """
    from skimage.morphology import skeletonize

    # padded, so that lines along the frame thin like any others
    thin = np.asarray(skeletonize(_without_pinholes(np.pad(mask, 1))), dtype=bool)[1:-1, 1:-1]
    skeleton = _joined(thin, gap_px)
    nodes, branches = _split(skeleton)
    while spurs := _spurs(nodes, branches, spur_px):
        for branch in spurs:
            column, row = np.rint(branch.points[1:]).astype(np.intp).T
            skeleton[row, column] = False
        nodes, branches = _split(skeleton)
    branches = _with_extra(branches, mask)
    return BranchGraph(nodes, (*branches, *_gap_branches(nodes, branches, gap_px)))


def _without_pinholes(mask: BoolArray) -> BoolArray:
    labels, _ = ndimage.label(~mask)
    area = np.bincount(labels.ravel())
    return np.asarray(mask | (area[labels] <= _PINHOLE_AREA), dtype=bool)


def _joined(skeleton: BoolArray, gap_px: float) -> BoolArray:
    """Join to the largest component all others within reach of short straight bridges."""
    labels, count = ndimage.label(skeleton, structure=_EIGHT)
    if count <= 1:
        return skeleton
    components = [np.argwhere(labels == label) for label in range(1, count + 1)]
    components.sort(key=len, reverse=True)
    pixels, *candidates = components
    candidates = [candidate for candidate in candidates if len(candidate) >= _SPECK_PX]
    while candidates:
        tree = spatial.cKDTree(pixels)
        reaches = [tree.query(candidate) for candidate in candidates]
        nearest = int(np.argmin([distance.min() for distance, _ in reaches]))
        distance, index = reaches[nearest]
        if distance.min() > max(gap_px, 1.5):
            break
        component = candidates.pop(nearest)
        i = int(np.argmin(distance))
        steps = int(np.ceil(distance[i])) + 1
        bridge = np.rint(np.linspace(component[i], pixels[index[i]], steps)).astype(np.intp)
        pixels = np.concatenate([pixels, component, bridge])
    joined = np.zeros_like(skeleton)
    joined[tuple(pixels.T)] = True
    return joined


def _neighbours(skeleton: BoolArray, pixels: NDArray[np.intp]) -> list[list[int]]:
    """8-neighbours of each pixel; a diagonal step is dropped where two straight steps make it."""
    number = np.full(np.add(skeleton.shape, 2), -1, dtype=np.intp)
    number[pixels[:, 0] + 1, pixels[:, 1] + 1] = np.arange(len(pixels))
    neighbours: list[list[int]] = [[] for _ in range(len(pixels))]
    for i, (row, column) in enumerate(pixels + 1):
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                j = int(number[row + dr, column + dc])
                if j < 0 or j == i:
                    continue
                if dr and dc and (number[row + dr, column] >= 0 or number[row, column + dc] >= 0):
                    continue
                neighbours[i].append(j)
    return neighbours


def _degrees(nodes: FloatArray, branches: list[Branch]) -> NDArray[np.intp]:
    return np.bincount(
        [end for branch in branches for end in branch.node_pair], minlength=len(nodes)
    )


def _spurs(nodes: FloatArray, branches: list[Branch], spur_px: float) -> list[Branch]:
    """Find the shortest short dead end at each crossing, from the crossing to its tip."""
    degree = _degrees(nodes, branches)
    shortest: dict[int, Branch] = {}
    for branch in branches:
        if degree[branch.node_pair[1]] != 1:
            branch = Branch(branch.points[::-1], branch.node_pair[::-1])
        crossing, tip = branch.node_pair
        if degree[tip] != 1 or degree[crossing] < 3 or len(branch.points) - 1 >= spur_px:
            continue
        if crossing not in shortest or len(branch.points) < len(shortest[crossing].points):
            shortest[crossing] = branch
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

    crossing = [len(adjacent) > 2 for adjacent in neighbours]
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
    visited: set[int] = set()

    def walk(first: int, second: int) -> None:
        line = [first, second]
        while line[-1] not in node_of:
            visited.add(line[-1])
            a, b = neighbours[line[-1]]
            line.append(b if a == line[-2] else a)  # not back to where the line comes from
        node_pair = node_of[line[0]], node_of[line[-1]]
        inner = position[np.array(line[1:-1], dtype=np.intp)]
        points = np.concatenate([nodes[node_pair[0]][None], inner, nodes[node_pair[1]][None]])
        branches.append(Branch(points, node_pair))

    for start in list(node_of):
        for second in neighbours[start]:
            if second in node_of:  # neighbouring nodes; a cluster is not joined to itself
                if start < second and node_of[start] != node_of[second]:
                    walk(start, second)
            elif second not in visited:
                walk(start, second)
    for start in range(len(pixels)):  # loops without any crossing: cut at their sharpest bend
        if start in node_of or start in visited:
            continue
        loop = [start, neighbours[start][0]]
        while loop[-1] != start:
            a, b = neighbours[loop[-1]]
            loop.append(b if a == loop[-2] else a)
        cut = loop[_sharpest(position[loop[:-1]])]
        add_node([cut])
        walk(cut, neighbours[cut][0])
    return np.array(nodes), branches


def _sharpest(loop: FloatArray) -> int:
    forward = np.roll(loop, -_BEND_REACH, axis=0) - loop
    backward = loop - np.roll(loop, _BEND_REACH, axis=0)
    norms = np.linalg.norm(forward, axis=1) * np.linalg.norm(backward, axis=1)
    return int(np.argmin(np.sum(forward * backward, axis=1) / np.maximum(norms, 1e-9)))


def _with_extra(branches: list[Branch], mask: BoolArray) -> list[Branch]:
    if not branches:
        return branches
    owner = np.repeat(np.arange(len(branches)), [len(branch.points) for branch in branches])
    tree = spatial.cKDTree(np.concatenate([branch.points for branch in branches]))
    _, nearest = tree.query(np.argwhere(mask)[:, ::-1])
    area = np.bincount(owner[nearest], minlength=len(branches)).astype(np.float64)
    steps = np.array([max(1, len(branch.points) - 1) for branch in branches])
    order = np.argsort(area / steps)
    median = np.searchsorted(np.cumsum(steps[order]), 0.5 * steps.sum())  # weighted by length
    width = max(1.0, float((area / steps)[order][median]))
    return [
        replace(branch, extra_px=float(min(max(0.0, area[i] / width - steps[i] - 1), steps[i])))
        for i, branch in enumerate(branches)
    ]


def _gap_branches(nodes: FloatArray, branches: list[Branch], gap_px: float) -> list[Branch]:
    """Find optional branches across gaps between loose ends."""
    loose_ends = np.flatnonzero(_degrees(nodes, branches) == 1).tolist()
    return [
        Branch(nodes[[i, j]], (i, j), optional=True)
        for i, j in itertools.combinations(loose_ends, 2)
        if np.linalg.norm(nodes[i] - nodes[j]) <= gap_px
    ]
