"""Ordered paths from grey PSFs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from motdiff.psf_frame import MAP_PITCH
from motdiff.tracing.dwell import checked_psf, fit_dwell
from motdiff.tracing.graph import BranchGraph, branch_graph
from motdiff.tracing.trail import smoothest_trail
from motdiff.trajectory import Trajectory
from motdiff.types import BoolArray, FloatArray

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
# of 141 traced paths beyond both 30 had the right order, of 99 others 72
# (docs/decisions/tracing.md)
_LENGTH_PER_EXTENT = 2.5
_CROSSINGS = 1
_LEAST_SINE = 0.2  # between strands that cross
_STEP_PX = 0.25


def trace_psf(psf: ArrayLike) -> FloatArray:
    """Trace the ordered path under a grey PSF: its ridges, straight through crossings.

    Parameters
    ----------
    psf : (H, W) array_like
        Non-negative, with zero displacement at index ``size // 2``; may be thick, speckled or
        noisy.

    Returns
    -------
    (N, 2) float, px

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
    """Turn a PSF into a trajectory: :func:`trace_psf`, then :func:`motdiff.tracing.fit_dwell`.

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


def is_tangled(path: Trajectory) -> bool:
    """Whether a path, long for its extent, crosses itself too often for a certain order."""
    return path.length_px > _LENGTH_PER_EXTENT * path.extent_px and crossings(path) > _CROSSINGS


def crossings(path: Trajectory) -> int:
    """Count the self-crossings of a path, in pieces of a quarter of a pixel.

    Strands that touch do not cross, nor do strands that are retraced: within about a pixel of a
    crossing they part by a sine of 0.2 or more.
    """
    points = path.arc_resampled(max(2, round(path.length_px / _STEP_PX) + 1))
    # side of each piece (rows) on which each point lies; pieces that cross part each other's ends
    side = _cross(np.diff(points, axis=0)[:, None], points - points[:-1, None])
    parted = side[:, :-1] * side[:, 1:] < 0
    reach = round(1 / _STEP_PX)
    pieces = np.arange(len(points) - 1)
    chords = (
        points[np.minimum(pieces + 1 + reach, len(points) - 1)]
        - points[np.maximum(pieces - reach, 0)]
    )
    least_cross = _LEAST_SINE * ((2 * reach + 1) * _STEP_PX) ** 2
    steep = np.abs(_cross(chords[:, None], chords[None])) > least_cross
    return int(np.triu(parted & parted.T & steep, 2).sum())


def _cross(u: FloatArray, v: FloatArray) -> FloatArray:
    (ux, uy), (vx, vy) = np.moveaxis(u, -1, 0), np.moveaxis(v, -1, 0)
    return np.asarray(ux * vy - uy * vx, dtype=np.float64)
