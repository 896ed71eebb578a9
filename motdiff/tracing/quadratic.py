"""Quadratic paths (constant acceleration) fitted to an estimated PSF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import PSF_PX
from motdiff.tracing.dwell import checked_psf
from motdiff.tracing.path import trace_psf_to_trajectory
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

HAT_VARIANCE_PX2 = 1 / 6  # of the PSF's bilinear hat, along each axis
_EXPLAINED_MNC = 0.86  # of a quadratic path, to be preferred: docs/decisions/tracing.md
_POINTS = 49
_CLIMBED_ON = 3  # of the starts
_MOST_POINTS = 500  # a path has fewer; of noise all over the frame the brightest do


@dataclass(frozen=True)
class QuadraticPath:
    """Motion ``a (t - 1/2) + b ((t - 1/2)^2 - 1/12)``, t in 0..1; its time-mean is (0, 0).

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
                raise ValueError(
                    f"{name}: must be two finite numbers (x, y), got {value.tolist()}"
                )
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def trajectory(self, *, samples: int = 129) -> Trajectory:
        """Return the path as straight pieces between ``samples`` times, evenly spaced."""
        t = np.linspace(0, 1, samples)
        return Trajectory.from_samples(_points(np.concatenate([self.a, self.b]), t), t=t)


def quadratic_of_psf(psf: ArrayLike) -> QuadraticPath:
    """Quadratic path, in either direction, whose PSF is most alike to ``psf``.

    Climbed from seven starts that have the PSF's second moments: straight, bent, sped up and bent
    back motions.

    Parameters
    ----------
    psf : (H, W) array_like
        Non-negative, with some light.

    Raises
    ------
    ValueError
        If ``psf`` is no such array.
    """
    light = checked_psf(psf)
    brightest = np.argsort(-light, axis=None)[: min(_MOST_POINTS, np.count_nonzero(light))]
    rows, columns = np.unravel_index(brightest, light.shape)
    weight = light[rows, columns] / light[rows, columns].sum()
    target = np.stack([columns, rows], axis=-1).astype(np.float64)
    target -= weight @ target
    across, along = np.linalg.eigh((weight * target.T) @ target)[1].T  # the smaller moment first
    length, width = (np.sqrt(weight @ (target @ axis) ** 2) for axis in (along, across))
    # the two shapes' mean squares are 1/12 and 1/180
    straight = np.sqrt(12) * length * along
    bent = np.sqrt(180) * width * across
    back = np.sqrt(180) * length * along
    starts = [(straight, np.zeros(2))]
    starts += [(straight, sign * bent) for sign in (1, -1)]
    starts += [(0.7 * straight, sign * 0.7 * back) for sign in (1, -1)]
    starts += [(np.sqrt(12) * width * across, sign * back) for sign in (1, -1)]
    coarse = max(1.0, 0.15 * float(length))
    optima = [
        climbed(
            np.concatenate([a, b, [0, 0]]),
            target,
            weight,
            variance_px2=HAT_VARIANCE_PX2 + coarse**2,
        )
        for a, b in starts
    ]
    finest = [
        climbed(values, target, weight, variance_px2=2 * HAT_VARIANCE_PX2)
        for values, _ in sorted(optima, key=lambda optimum: optimum[1])[:_CLIMBED_ON]
    ]
    best = min(finest, key=lambda optimum: optimum[1])[0]
    return QuadraticPath(best[:2], best[2:4])


def _points(coefficients: FloatArray, t: FloatArray) -> FloatArray:
    """Points (N, 2), px, of the path with coefficients (4,) ``a, b`` at times t (N,)."""
    tau = t - 0.5
    return np.asarray(
        np.outer(tau, coefficients[:2]) + np.outer(tau**2 - 1 / 12, coefficients[2:4]),
        dtype=np.float64,
    )


def climbed(
    start: FloatArray, target: FloatArray, weight: FloatArray, *, variance_px2: float
) -> tuple[FloatArray, float]:
    """Coefficients and shift (6,) of a local optimum of the correlation with (M, 2), and its loss.

    The points' weights (M,) sum to 1.
    """
    t = (np.arange(_POINTS) + 0.5) / _POINTS
    shapes = np.stack(
        [t - 0.5, (t - 0.5) ** 2 - 1 / 12, np.ones(_POINTS)]
    )  # of a, b and the shift
    width = 4 * variance_px2
    even = np.full(_POINTS, 1 / _POINTS)

    def loss(values: FloatArray) -> tuple[float, FloatArray]:
        points = shapes.T @ values.reshape(3, 2)
        with_itself, pull_itself = _overlap(points, points, even, width)
        with_target, pull = _overlap(points, target, weight, width)
        gradient = pull_itself / with_itself - pull / with_target  # of -log of the cosine
        return float(0.5 * np.log(with_itself) - np.log(with_target)), (shapes @ gradient).ravel()

    optimum = optimize.minimize(loss, start, jac=True, method="L-BFGS-B")
    return np.asarray(optimum.x, dtype=np.float64), float(optimum.fun)


def _overlap(
    points: FloatArray, targets: FloatArray, weight: FloatArray, width: float
) -> tuple[float, FloatArray]:
    """Weighted mean of exp(-distance^2 / width) over pairs; its gradient (N, 2) in ``points``."""
    distance2 = (
        np.square(points).sum(axis=1)[:, None]
        + np.square(targets).sum(axis=1)
        - 2 * points @ targets.T
    )
    affinity = np.exp(distance2 / -width) * (weight / len(points))
    pulled = affinity.sum(axis=1, keepdims=True) * points - affinity @ targets
    return float(affinity.sum()) + 1e-300, -2 / width * pulled


def plain_trajectory(psf: ArrayLike, *, least_mnc: float = _EXPLAINED_MNC) -> Trajectory | None:
    """Quadratic path of an estimated PSF; None where none explains it.

    Parameters
    ----------
    psf : (H, W) array_like
        As :func:`quadratic_of_psf`.
    least_mnc : float
        With its PSF, of a path that explains it.
    """
    plain = quadratic_of_psf(psf).trajectory()
    if mnc_subpixel(plain.psf(plain.frame_size(PSF_PX)), psf) < least_mnc:
        return None
    return plain


def simplest_trajectory(psf: ArrayLike) -> Trajectory:
    """Trace an estimated PSF: a quadratic path where one explains it, else a walk.

    A walk covers all that is drawn, so the blotches of a blind kernel make it several times too
    long and lose its order in time, which a shutter code depends on. A straight or evenly bent
    path cannot follow them.

    Parameters
    ----------
    psf : (H, W) array_like
        As :func:`motdiff.tracing.path.trace_psf`, which traces what no quadratic path explains.
    """
    return plain_trajectory(psf) or trace_psf_to_trajectory(psf)
