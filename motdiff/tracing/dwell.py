"""Time spent along a known path: non-negative least squares against a PSF."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, optimize

from motdiff.metrics import register_shift
from motdiff.path_psfs import interpolated, slice_psfs
from motdiff.psf_frame import in_frame
from motdiff.trajectory import Trajectory, arc_lengths, checked_points
from motdiff.types import FloatArray

_SPACING_PX = 0.5
_FLOOR = 1e-3  # least dwell of a piece, as a part of the mean: a Trajectory's time must increase
_SMOOTHNESS = 0.01  # weight of neighbouring dwells' differences, in the data's curvature
_RIDGE = 1e-6
_EXTENDED_PX = 1.0  # both ends, for the fit; ends without dwell are cut off again
_ROUNDS = 4  # of dwell and shift in turn
_MOST_SHIFT_PX = 2.0
_SHORTEST_PX = 0.05  # a path must lead somewhere, even for a point


def fit_dwell(path_px: ArrayLike, psf: ArrayLike) -> Trajectory:
    """Fit the time spent along a path, and its sub-pixel shift, so that its exact PSF is ``psf``.

    Parameters
    ----------
    path_px : (N, 2) array_like, px
        Ordered points; zero displacement is the index ``size // 2`` of the PSF.
    psf : (H, W) array_like
        Non-negative; any total.

    Returns
    -------
    Trajectory
        Of unknown direction.

    Raises
    ------
    ValueError
        If the path is not (N, 2) and finite, or as :func:`checked_psf`.
    """
    light = checked_psf(psf)
    target = in_frame(light / light.sum(), 2 * (max(light.shape) // 2) + 1)
    return _fit(_nodes(path_px), target)


def _fit(nodes: FloatArray, psf: FloatArray) -> Trajectory:
    """Minimise ``|| K' w - psf ||^2`` over dwells w, and the path's shift, in turn."""
    for index in range(_ROUNDS):
        pieces, target = _piece_psfs(nodes, psf)
        dwell = _non_negative_fit(pieces, target)
        if index == _ROUNDS - 1:
            break
        shift = np.array(register_shift(target, np.tensordot(dwell, pieces, axes=1)))
        if np.abs(shift).max() > _MOST_SHIFT_PX or np.abs(shift).max() < 0.02:
            break
        nodes = nodes + shift
    return _trajectory(nodes, dwell)


def _piece_psfs(nodes: FloatArray, psf: FloatArray) -> tuple[FloatArray, FloatArray]:
    """PSF of each piece between nodes (n, S, S), sum 1, and the target in the same frame.

    The frame just holds the path: no dwell explains light of the target further out.
    """
    half = int(np.ceil(np.abs(nodes).max())) + 1 + int(_MOST_SHIFT_PX)
    beyond = half - psf.shape[0] // 2
    target = np.pad(psf, beyond) if beyond >= 0 else psf[-beyond:beyond, -beyond:beyond]
    size = 2 * half + 1
    edges = np.linspace(0, 1, len(nodes))
    return slice_psfs(edges, nodes, edges, size) * (len(nodes) - 1), target


def _non_negative_fit(pieces: FloatArray, target: FloatArray) -> FloatArray:
    count = len(pieces)
    flat = pieces.reshape(count, -1)
    gram = flat @ flat.T
    scale = float(np.trace(gram)) / count
    differences = np.diff(np.eye(count), axis=0)
    gram += scale * (_SMOOTHNESS * differences.T @ differences + _RIDGE * np.eye(count))
    right = flat @ target.ravel()
    total = max(float(right.sum() / max(gram.sum(), 1e-30)), 1e-12)  # of the best uniform dwell
    floor = np.full(count, _FLOOR * total)
    # least squares on the Cholesky factor: the same minimum from n equations instead of S^2
    root = linalg.cholesky(gram)
    target_above = linalg.solve_triangular(root, right - gram @ floor, trans="T")
    above, _ = optimize.nnls(root, target_above, maxiter=100 * count)
    return np.asarray(floor + above, dtype=np.float64)


def _nodes(path_px: ArrayLike) -> FloatArray:
    path = checked_points("path_px", path_px)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    path = path[np.r_[True, steps > 1e-9]]
    if len(path) < 2 or steps.sum() < _SHORTEST_PX:
        half = np.array([0.5 * _SHORTEST_PX, 0.0])
        path = np.array([path[0] - half, path[0] + half])
    arc = arc_lengths(path)
    # the direction at an end, from the last pixel or so
    before = path[0] - interpolated(min(1.0, arc[-1]), arc, path)
    after = path[-1] - interpolated(max(arc[-1] - 1.0, 0.0), arc, path)
    first = path[0] + _EXTENDED_PX * before / np.linalg.norm(before)
    last = path[-1] + _EXTENDED_PX * after / np.linalg.norm(after)
    path = np.concatenate([first[None], path, last[None]])
    arc = arc_lengths(path)
    count = int(np.ceil(arc[-1] / _SPACING_PX)) + 1
    return interpolated(np.linspace(0, arc[-1], max(count, 2)), arc, path)


def _trajectory(nodes: FloatArray, dwell: FloatArray) -> Trajectory:
    """Cut the ends that got no time, and make a Trajectory of the rest."""
    busy = np.flatnonzero(dwell > 2 * dwell.min() + 1e-3 * dwell.mean())
    if busy.size:
        nodes = nodes[busy[0] : busy[-1] + 2]
        dwell = dwell[busy[0] : busy[-1] + 1]
    return Trajectory.from_samples(nodes, t=np.r_[0.0, np.cumsum(dwell)])


def checked_psf(psf: ArrayLike) -> FloatArray:
    """Return a PSF as float64; ValueError if not finite, non-negative, (H, W) and with light."""
    light = np.asarray(psf, dtype=np.float64)
    if (
        light.ndim != 2
        or not np.isfinite(light).all()
        or light.min(initial=0.0) < 0
        or light.sum() <= 0
    ):
        raise ValueError(
            "psf: must be a finite, non-negative (H, W) array with some light, got shape"
            f" {light.shape}"
        )
    return light
