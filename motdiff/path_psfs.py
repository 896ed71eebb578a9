"""Exact PSFs of a piecewise linear path over slices of time, by Gauss-Legendre quadrature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motdiff.types import FloatArray

_GAUSS_NODE = 1.0 / np.sqrt(3.0)  # of two: exact for the quadratic weights of bilinear hats


def slice_psfs(t: FloatArray, xy: FloatArray, edges: FloatArray, size: int) -> FloatArray:
    """Integrate the path, seen through the bilinear hat of each pixel, over each time slice.

    Inside one cell of the pixel grid and one straight piece the hat is a quadratic in time, so
    cutting at every grid line makes two Gauss nodes exact.

    The path (T, 2), px, at times (T,) from 0 to 1, must fit the frame, whose zero displacement is
    at index ``size // 2``. Of edges (slices + 1,), increasing within 0..1, the PSFs are (slices,
    size, size); each sums to its slice's duration.
    """
    crossings = [_grid_crossings(t, xy[:, axis]) for axis in (0, 1)]
    u = np.union1d(np.concatenate([t, *crossings]), edges)
    u = u[(u >= edges[0]) & (u <= edges[-1])]
    du = np.diff(u)
    mid = 0.5 * (u[1:] + u[:-1])

    slice_index = slice_of(mid, edges)
    cell = np.floor(interpolated(mid, t, xy)).astype(np.intp)
    psfs = np.zeros((len(edges) - 1) * size * size)
    # within a pixel cell and a straight piece, the hat's two factors are linear in time
    for node in (-_GAUSS_NODE, _GAUSS_NODE):
        fraction = interpolated(mid + 0.5 * du * node, t, xy) - cell
        for dx in (0, 1):
            for dy in (0, 1):
                weight = (
                    0.5 * du * np.abs(1 - dx - fraction[:, 0]) * np.abs(1 - dy - fraction[:, 1])
                )
                column = cell[:, 0] + dx + size // 2
                row = cell[:, 1] + dy + size // 2
                psfs += np.bincount(
                    (slice_index * size + row) * size + column, weight, minlength=psfs.size
                )
    return psfs.reshape(-1, size, size)


def slice_of(t: FloatArray, edges: FloatArray) -> NDArray[np.intp]:
    """Index of the time slice of each time (N,); the last edge belongs to the last slice."""
    return np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)


def interpolated(
    positions: float | FloatArray, knots: FloatArray, points: FloatArray
) -> FloatArray:
    """Points (..., K) at positions (...) between knots (N,), straight between points (N, K)."""
    return np.stack([np.interp(positions, knots, column) for column in points.T], axis=-1)


def _grid_crossings(t: FloatArray, values: FloatArray) -> FloatArray:
    """Find times at which a coordinate is an integer: pixel centres bound bilinear cells."""
    low = np.minimum(values[:-1], values[1:])
    high = np.maximum(values[:-1], values[1:])
    first = np.ceil(low)
    count = np.maximum(np.floor(high) - first + 1, 0).astype(np.intp)
    count[values[:-1] == values[1:]] = 0
    segment = np.repeat(np.arange(count.size), count)
    # running number of each crossing within its segment, from 0
    nth = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    rise = values[segment + 1] - values[segment]
    fraction = (first[segment] + nth - values[segment]) / rise
    return np.asarray(t[segment] + fraction * (t[segment + 1] - t[segment]), dtype=np.float64)
