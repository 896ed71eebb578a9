"""Paths that are a quadratic function of time, and the best of them for a true motion: the limit of their class."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from motdiff.metrics import mnc_subpixel
from motdiff.trajectory import Trajectory

__all__ = ["QuadraticPath", "most_alike_quadratic", "nearest_quadratic"]

FloatArray = NDArray[np.float64]

_HAT_VARIANCE_PX2 = 1 / 6  # of the PSF's bilinear hat, along each axis
_BLURS_PX = (3.0, 1.2, 0.0)  # on top of the hat, coarse to fine
_POINTS, _TRUE_POINTS = 49, 240
_ANGLES = 4
_BENDS = (0.0, 0.8, -0.8)  # of the bend across the motion, over the path's extent
_NO_BETTER = 1e-6


@dataclass(frozen=True)
class QuadraticPath:
    """Motion ``p(t) = a (t - 1/2) + b ((t - 1/2)^2 - 1/12)`` for t in 0..1, with its time-mean at (0, 0).

    Parameters
    ----------
    a, b : (2,) float, px
        Displacement from start to end, and half the change of velocity; x before y.
    """

    a: FloatArray
    b: FloatArray

    def __post_init__(self) -> None:
        for name in ("a", "b"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (2,) or not np.isfinite(value).all():
                raise ValueError(f"{name}: must be two finite numbers (x, y), got {value.tolist()}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def reversed(self) -> QuadraticPath:
        """Return the same path run backwards in time."""
        return QuadraticPath(-self.a, self.b)

    def trajectory(self, *, samples: int = 129) -> Trajectory:
        """Return the path as straight pieces between ``samples`` times, evenly spaced."""
        t = np.linspace(0, 1, samples)
        return Trajectory.from_samples(_points(np.concatenate([self.a, self.b]), t), t=t)


def nearest_quadratic(truth: Trajectory) -> QuadraticPath:
    """Quadratic path with the least mean square distance to ``truth`` at equal times; a closed form.

    For coding an exposure, where it matters what the motion does when. Its reverse is the nearest of the reverse.

    Parameters
    ----------
    truth : Trajectory
    """
    steps = np.diff(truth.t)
    start, end = truth.t[:-1] - 0.5, truth.t[1:] - 0.5
    a, b = np.zeros(2), np.zeros(2)
    for share in (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)):  # Gauss: exact for pieces times t^2
        tau = start + share * (end - start)
        xy = truth.xy[:-1] + share * np.diff(truth.xy, axis=0)
        a += 0.5 * (steps * tau) @ xy
        b += 0.5 * (steps * (tau**2 - 1 / 12)) @ xy
    return QuadraticPath(12 * a, 180 * b)  # the two shapes are orthogonal, of mean square 1/12 and 1/180


def most_alike_quadratic(truth: Trajectory, *, size: int = 64) -> QuadraticPath:
    """Quadratic path whose PSF is most alike to that of ``truth`` (sub-pixel MNC): the oracle of the parametric class.

    Climbed from 13 starts twice each, on PSFs blurred less and less: a local optimum, but at least as good as
    :func:`nearest_quadratic`, which is a candidate. Of its two directions it has the one nearer to the truth's.

    Parameters
    ----------
    truth : Trajectory
    size : int, px
        Side of the PSFs that are compared; it must hold the motion.
    """
    nearest = nearest_quadratic(truth)
    target = truth.at((np.arange(_TRUE_POINTS) + 0.5) / _TRUE_POINTS)
    psf = truth.psf(size)

    def alike(path: QuadraticPath) -> float:
        drawn = path.trajectory()
        return mnc_subpixel(drawn.psf(max(size, drawn.frame_size())), psf)

    best, score = nearest, alike(nearest)
    for start, blurs_px in itertools.product(_starts(nearest, target), (_BLURS_PX, _BLURS_PX[1:])):
        found = start
        for blur_px in blurs_px:
            found = _climbed(found, target, _HAT_VARIANCE_PX2 + blur_px**2)
        path = QuadraticPath(found[:2], found[2:4])
        path_score = alike(path)
        if path_score > score + _NO_BETTER:
            best, score = path, path_score
    return best if best.a @ nearest.a >= 0 else best.reversed()


def _points(coefficients: FloatArray, t: FloatArray) -> FloatArray:
    """Points (N, 2), px, of the path with coefficients (4,), ``a`` before ``b``, at times t (N,)."""
    tau = t - 0.5
    return np.asarray(np.outer(tau, coefficients[:2]) + np.outer(tau**2 - 1 / 12, coefficients[2:4]), dtype=np.float64)


def _starts(nearest: QuadraticPath, target: FloatArray) -> list[FloatArray]:
    """Coefficients and a shift (6,): the nearest path, and straight and bent ones all around."""
    extent_px = float(np.ptp(target, axis=0).max())
    starts = [np.concatenate([nearest.a, nearest.b, [0, 0]])]
    for angle_rad in np.pi * np.arange(_ANGLES) / _ANGLES:
        along = np.array([np.cos(angle_rad), np.sin(angle_rad)])
        across = np.array([-along[1], along[0]])
        starts += [extent_px * np.concatenate([along, 4 * bend * across, [0, 0]]) for bend in _BENDS]
    return starts


def _climbed(start: FloatArray, target: FloatArray, variance_px2: float) -> FloatArray:
    """Coefficients and shift (6,) of a local optimum of the correlation with the target's points (M, 2)."""
    t = (np.arange(_POINTS) + 0.5) / _POINTS
    shapes = np.stack([t - 0.5, (t - 0.5) ** 2 - 1 / 12, np.ones(_POINTS)])  # of a, b and the shift
    width = 4 * variance_px2

    def loss(values: FloatArray) -> tuple[float, FloatArray]:
        points = shapes.T @ values.reshape(3, 2)
        with_itself, pull_itself = _overlap(points, points, width)
        with_target, pull = _overlap(points, target, width)
        gradient = pull_itself / with_itself - pull / with_target  # of -log of the cosine
        return float(0.5 * np.log(with_itself) - np.log(with_target)), (shapes @ gradient).ravel()

    return np.asarray(optimize.minimize(loss, start, jac=True, method="TNC").x, dtype=np.float64)


def _overlap(points: FloatArray, others: FloatArray, width: float) -> tuple[float, FloatArray]:
    """Mean over pairs of exp(-distance^2 / width), with its gradient (N, 2) in the first points."""
    apart = points[:, None] - others[None]
    near = np.exp(-np.square(apart).sum(axis=-1) / width) / (len(points) * len(others))
    return float(near.sum()) + 1e-300, -2 / width * np.einsum("ij,ijk->ik", near, apart)
