"""Exact drawing of a piecewise linear path on a pixel grid: PSFs by integration, maps by thin lines."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

__all__ = ["slice_of", "slice_psfs", "thin_path"]

FloatArray = NDArray[np.float64]

_GAUSS_NODE = 1.0 / np.sqrt(3.0)  # two-point Gauss-Legendre: exact for the quadratic weights below


def slice_psfs(t: FloatArray, xy: FloatArray, edges: FloatArray, size: int) -> FloatArray:
    """Integrate the path, seen through the bilinear hat of each pixel, over each time slice.

    Inside one cell of the pixel grid and one straight piece the hat is a quadratic in time, so cutting at every
    grid line makes two Gauss nodes exact.

    Parameters
    ----------
    t : (T,) float, 0..1 increasing
    xy : (T, 2) float, px; must fit the frame
    edges : (slices + 1,) float, increasing within 0..1
    size : int
        Frame side, px; zero displacement at index ``size // 2``.

    Returns
    -------
    (slices, size, size) float; each slice sums to its duration.
    """
    crossings = [_grid_crossings(t, xy[:, axis]) for axis in (0, 1)]
    u = np.union1d(np.concatenate([t, *crossings]), edges)
    u = u[(u >= edges[0]) & (u <= edges[-1])]
    du, mid = np.diff(u), 0.5 * (u[1:] + u[:-1])

    def at(times: FloatArray) -> FloatArray:
        return np.stack([np.interp(times, t, xy[:, axis]) for axis in (0, 1)], axis=-1)

    slice_index = slice_of(mid, edges)
    cell = np.floor(at(mid)).astype(np.intp)
    psfs = np.zeros((len(edges) - 1) * size * size)
    for node in (-_GAUSS_NODE, _GAUSS_NODE):
        part = at(mid + 0.5 * du * node) - cell
        for dx in (0, 1):
            for dy in (0, 1):
                weight = 0.5 * du * np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
                column, row = cell[:, 0] + dx + size // 2, cell[:, 1] + dy + size // 2
                psfs += np.bincount((slice_index * size + row) * size + column, weight, minlength=psfs.size)
    return psfs.reshape(-1, size, size)


def slice_of(t: FloatArray, edges: FloatArray) -> NDArray[np.intp]:
    """Index of the time slice that each time (N,) belongs to; a time on the last edge belongs to the last slice."""
    return np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)


def thin_path(index: NDArray[np.intp]) -> NDArray[np.intp]:
    """Thin a walk of touching pixels to an 8-connected line without corner steps.

    Parameters
    ----------
    index : (N, 2) int
        Pixels along the path; consecutive ones equal or 8-neighbours.

    Returns
    -------
    (M, 2) int, M <= N, with the same ends.
    """
    moved = np.r_[True, np.any(np.diff(index, axis=0) != 0, axis=1)]
    walk = index[moved]
    kept = [walk[0]]
    for here, after in itertools.pairwise(walk[1:]):
        if np.abs(after - kept[-1]).max() > 1:  # otherwise its neighbours already touch: a corner
            kept.append(here)
    kept.append(walk[-1])
    return np.array(kept)


def _grid_crossings(t: FloatArray, values: FloatArray) -> FloatArray:
    """Find the times at which a coordinate passes an integer; pixel centres bound the bilinear cells."""
    low, high = np.minimum(values[:-1], values[1:]), np.maximum(values[:-1], values[1:])
    first = np.ceil(low)
    count = np.maximum(np.floor(high) - first + 1, 0).astype(np.intp)
    count[values[:-1] == values[1:]] = 0
    segment = np.repeat(np.arange(count.size), count)
    nth = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    rise = values[segment + 1] - values[segment]
    fraction = (first[segment] + nth - values[segment]) / rise
    return np.asarray(t[segment] + fraction * (t[segment + 1] - t[segment]), dtype=np.float64)
