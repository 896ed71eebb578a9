"""Best quadratic paths of a known motion: the limits of estimators that know no others."""

from __future__ import annotations

import itertools

import numpy as np

from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import PSF_PX
from motdiff.tracing.quadratic import HAT_VARIANCE_PX2, QuadraticPath, climbed
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_BLURS_PX = (3.0, 1.2, 0.0)  # on top of the hat, coarse to fine
_TRUE_POINTS = 240
_ANGLES = 4
_BENDS = (0.0, 0.8, -0.8)  # of the bend across the motion, over the path's extent
_NO_BETTER = 1e-6


def nearest_quadratic(truth: Trajectory) -> QuadraticPath:
    """Quadratic path of least mean square distance to ``truth`` at equal times, in closed form.

    For coded exposure, where the timing of the motion matters. Its reverse is the nearest of the
    reverse.
    """
    steps = np.diff(truth.t)
    start = truth.t[:-1] - 0.5
    end = truth.t[1:] - 0.5
    a = np.zeros(2)
    b = np.zeros(2)
    # Gauss-Legendre nodes of a piece: exact for straight pieces times t^2, a cubic
    for share in (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)):
        tau = start + share * (end - start)
        xy = truth.xy[:-1] + share * np.diff(truth.xy, axis=0)
        a += 0.5 * (steps * tau) @ xy
        b += 0.5 * (steps * (tau**2 - 1 / 12)) @ xy
    # the two shapes are orthogonal, of mean square 1/12 and 1/180
    return QuadraticPath(12 * a, 180 * b)


def most_alike_quadratic(truth: Trajectory, *, size: int = PSF_PX) -> QuadraticPath:
    """Quadratic path whose PSF is most alike to that of ``truth``: the oracle of the class.

    Climbed from 13 starts twice each, on PSFs blurred less and less: a local optimum, but at least
    as good as :func:`nearest_quadratic`, which is a candidate. Of its two directions it has the
    one nearer to the truth's.

    Parameters
    ----------
    size : int, px
        Side of the PSFs that are compared; it must hold the motion.
    """
    nearest = nearest_quadratic(truth)
    target = truth.at((np.arange(_TRUE_POINTS) + 0.5) / _TRUE_POINTS)
    weight = np.full(_TRUE_POINTS, 1 / _TRUE_POINTS)
    psf = truth.psf(size)

    def alike(path: QuadraticPath) -> float:
        walked = path.trajectory()
        return mnc_subpixel(walked.psf(walked.frame_size(size)), psf)

    best = nearest
    score = alike(nearest)
    for start, blurs_px in itertools.product(_starts(nearest, target), (_BLURS_PX, _BLURS_PX[1:])):
        coefficients = start
        for blur_px in blurs_px:
            coefficients = climbed(
                coefficients, target, weight, variance_px2=HAT_VARIANCE_PX2 + blur_px**2
            )[0]
        path = QuadraticPath(coefficients[:2], coefficients[2:4])
        path_score = alike(path)
        if path_score > score + _NO_BETTER:
            best = path
            score = path_score
    if best.a @ nearest.a < 0:  # a PSF has no direction, the truth has
        return QuadraticPath(-best.a, best.b)
    return best


def _starts(nearest: QuadraticPath, target: FloatArray) -> list[FloatArray]:
    """Coefficients and a shift (6,): the nearest path, and straight and bent ones all around."""
    extent_px = float(np.ptp(target, axis=0).max())
    starts = [np.concatenate([nearest.a, nearest.b, [0, 0]])]
    for angle_rad in np.pi * np.arange(_ANGLES) / _ANGLES:
        along = np.array([np.cos(angle_rad), np.sin(angle_rad)])
        across = np.array([-along[1], along[0]])
        starts += [
            extent_px * np.concatenate([along, 4 * bend * across, [0, 0]]) for bend in _BENDS
        ]
    return starts
