"""Smooth paths in time fitted to a PSF: a Legendre series with the prior of a hand's motion.

A trace follows the lines of a kernel; its PSF is not the kernel, and the time along it is fitted
afterwards. Here path and time are one curve, fitted from several starts, so that a path is
preferred whose velocity is smooth where it crosses itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from motdiff.metrics import path_distance_px
from motdiff.tracing.quadratic import HAT_VARIANCE_PX2
from motdiff.trajectory import Trajectory, bilinear_otf
from motdiff.types import ComplexArray, FloatArray

_ORDER = 32  # of the Legendre series
_NODES = 112
_SAMPLES = 241  # of the trajectory
# standard deviation of coefficient n over the path's rms radius, 1.2 / (1 + (n / 4)^fall): between
# shakes of 0.2 and 0.5 s of a phone's gyroscope while orders compete, wider for the last fit
_STEADY = 1.2
_CORNER = 4.0
_FALL = 2.5
_LAST_FALL = 2.0
_PRIOR_START = 1e3  # of the coefficient 0, a shift, in rms radii: free
# The kernel's error is unknown: half so many times the log of what of it the path leaves, with an
# error of the floor in any case.
_KERNEL_COUNT = 100
_LAST_KERNEL_COUNT = 600
_FLOOR = 0.01
_COARSE_PX = 2.0  # Gaussian through which starts are compared first
_COARSE_BAND_CY_PX = 0.225
_FRAME_PX = 64  # a period that holds the kernels
_DRAWS = 16
_DRAWS_SEED = 0
_CLIMBED_ON = 4
_COARSE_STEPS = 25
_FINE_STEPS = 40
_LAST_STEPS = 160
_LEAST_VARIANCE_PX2 = 0.05
_SAME_ORDER_PX = 2.0  # distance, at equal arc length, between paths of one order


class PathOtf:
    """OTF ``sum_k w_k exp(-2 pi i f . p_k)`` of weighted nodes.

    Parameters
    ----------
    fy_cy_px, fx_cy_px : (R,) and (C,) float, cycles/px
        Frequencies of the grid's rows and columns.
    weight : (K,) float
        Time spent at each node: weights of a quadrature over the exposure, sum 1.
    """

    def __init__(self, fy_cy_px: FloatArray, fx_cy_px: FloatArray, weight: FloatArray) -> None:
        self._slope_y = _single(-2j * np.pi * fy_cy_px)
        self._slope_x = _single(-2j * np.pi * fx_cy_px)
        self._weight = weight
        self._single_weight = weight.astype(np.float32)

    def otf(self, points: FloatArray) -> NDArray[np.complex64]:
        """OTF (R, C) of nodes (K, 2), px, which :meth:`slope` differentiates next."""
        self._rows = _phasors(self._slope_y.imag, points[:, 1])
        self._columns = _phasors(self._slope_x.imag, points[:, 0])
        return np.asarray((self._rows * self._single_weight) @ self._columns.T)

    def slope(self, of_otf: ComplexArray | NDArray[np.complex64]) -> FloatArray:
        """Slope (K, 2), per px, from a function's slope (R, C) in the OTF.

        The slope in a complex number is that in its real part plus i times that in its imaginary
        part.
        """
        pulled = _single(np.conj(of_otf))
        # the derivative of exp(-2 pi i f p) in p brings -2 pi i f down
        y = (self._slope_y[:, None] * self._rows * (pulled @ self._columns)).sum(axis=0).real
        x = (self._rows * (pulled @ (self._slope_x[:, None] * self._columns))).sum(axis=0).real
        return self._weight[:, None] * np.stack([x, y], axis=-1).astype(np.float64)


class KernelLikeness:
    """Likeness of OTFs with a kernel at the same place: the cosine of the angle between them.

    Parameters
    ----------
    kernel : (k, k) float
        Zero displacement at index ``k // 2``.
    fy_cy_px, fx_cy_px : (R,) and (C,) float, cycles/px
        Grid of frequencies; columns of the half plane, from 0.
    blur_px : float, px
        Sigma of a Gaussian through which both are compared.
    """

    def __init__(
        self,
        kernel: ArrayLike,
        fy_cy_px: FloatArray,
        fx_cy_px: FloatArray,
        *,
        blur_px: float = 0.0,
    ) -> None:
        radius2 = fy_cy_px[:, None] ** 2 + fx_cy_px**2
        # of the half plane: each column but 0 stands for its conjugate as well
        both_signs = np.where(fx_cy_px > 0, 2.0, 1.0)
        self._weight = (both_signs * np.exp(-((2 * np.pi * blur_px) ** 2) * radius2)).astype(
            np.float32
        )
        self.otf = _single(kernel_otf(kernel, fy_cy_px, fx_cy_px))
        self._norm = float(np.sqrt((self._weight * power(self.otf)).sum()))

    def __call__(self, otf: NDArray[np.complex64]) -> tuple[float, NDArray[np.complex64]]:
        """Cosine, -1..1, for an OTF (R, C), and its slope (R, C) in it."""
        norm = float(np.sqrt((self._weight * power(otf)).sum()))
        cosine = float((self._weight * (np.conj(self.otf) * otf).real).sum()) / (norm * self._norm)
        slope = self._weight * (self.otf / (norm * self._norm) - cosine / norm**2 * otf)
        return cosine, np.asarray(slope, dtype=np.complex64)


def kernel_otf(kernel: ArrayLike, fy_cy_px: FloatArray, fx_cy_px: FloatArray) -> ComplexArray:
    """OTF (R, C) of a kernel (k, k), zero displacement at index ``k // 2``."""
    light = np.asarray(kernel, dtype=np.float64)
    place = np.arange(len(light)) - len(light) // 2
    rows, columns = (np.exp(-2j * np.pi * np.outer(f, place)) for f in (fy_cy_px, fx_cy_px))
    return np.asarray(rows @ light @ columns.T, dtype=np.complex128)


def _phasors(slope: NDArray[np.float32], place: FloatArray) -> NDArray[np.complex64]:
    """``exp(i slope place)`` (N, K): cosine and sine are quicker than a complex exponential."""
    angle_rad = slope[:, None] * place.astype(np.float32)
    phasors = np.empty(angle_rad.shape, dtype=np.complex64)
    phasors.real = np.cos(angle_rad)
    phasors.imag = np.sin(angle_rad)
    return phasors


def power(otf: NDArray[np.complexfloating]) -> NDArray[np.float32]:
    """Squared modulus of an OTF."""
    return np.asarray(otf.real**2 + otf.imag**2, dtype=np.float32)


def _single(values: NDArray[np.complexfloating]) -> NDArray[np.complex64]:
    return np.asarray(values, dtype=np.complex64)


@dataclass(frozen=True)
class SmoothPath:
    """Fitted path.

    Attributes
    ----------
    trajectory : Trajectory
    likeness : float
        Correlation of its PSF with the one that it was fitted to.
    margin : float
        How much less likely, as a log, the best path of another order is.
    """

    trajectory: Trajectory
    likeness: float
    margin: float


def smooth_path(psf: ArrayLike, starts: Sequence[Trajectory]) -> SmoothPath:
    """Fit a smooth path to a PSF, from other paths and from random ones.

    Parameters
    ----------
    psf : (S, S) array_like
        Non-negative, with some light; zero displacement at index ``S // 2``.
    starts : sequence of Trajectory
        Such as a trace; centred, wherever the PSF lies in its frame.

    Returns
    -------
    SmoothPath
        Of unknown direction.
    """
    light = np.asarray(psf, dtype=np.float64)
    light = light / light.sum()
    middle, spread = _moments(light)
    radius_px = float(np.sqrt(np.trace(spread)))
    coarse = _Fit(light, radius_px, blur_px=_COARSE_PX, band_cy_px=_COARSE_BAND_CY_PX)
    fine = _Fit(light, radius_px)
    last = _Fit(light, radius_px, fall=_LAST_FALL, kernel_count=_LAST_KERNEL_COUNT)
    rng = np.random.default_rng(_DRAWS_SEED)
    series = [_series(path) for path in starts]
    series += [_drawn(spread, rng) for _ in range(_DRAWS)]
    for coefficients in series:
        coefficients[0] = middle
    climbed = [coarse.climb(coefficients, steps=_COARSE_STEPS) for coefficients in series]
    likeliest = np.argsort([cost for _, cost in climbed])[:_CLIMBED_ON].tolist()
    chosen = dict.fromkeys([*range(len(starts)), *likeliest])
    finest = [fine.climb(climbed[i][0], steps=_FINE_STEPS) for i in chosen]
    finest.sort(key=lambda optimum: optimum[1])
    least_cost = finest[0][1]
    best, _ = last.climb(finest[0][0], steps=_LAST_STEPS)
    path = _trajectory(finest[0][0])
    margins = [
        cost - least_cost
        for coefficients, cost in finest[1:]
        if path_distance_px(_trajectory(coefficients), path) > _SAME_ORDER_PX
    ]
    return SmoothPath(_trajectory(best), last.likeness(best), min(margins, default=np.inf))


class _Fit:
    """Cost of Legendre series beside a PSF (S, S), and its descent."""

    def __init__(
        self,
        psf: FloatArray,
        radius_px: float,
        *,
        fall: float = _FALL,
        kernel_count: int = _KERNEL_COUNT,
        blur_px: float = 0.0,
        band_cy_px: float = 0.5,
    ) -> None:
        side = 2 * len(psf) if len(psf) > _FRAME_PX else _FRAME_PX
        rows = np.sort(np.fft.fftfreq(side)).astype(np.float64)
        columns = np.fft.rfftfreq(side).astype(np.float64)
        fy, fx = rows[np.abs(rows) <= band_cy_px], columns[columns <= band_cy_px]
        nodes, weight = legendre.leggauss(_NODES)
        self._basis = legendre.legvander(nodes, _ORDER)
        self._otf = PathOtf(fy, fx, weight / 2)
        self._hat = bilinear_otf(fx, fy[:, None]).astype(np.float32)
        self._alike = KernelLikeness(psf, fy, fx, blur_px=blur_px)
        self._count = kernel_count
        relative = np.r_[_PRIOR_START, _relative_deviation(np.arange(1, _ORDER + 1), fall)]
        self._precision = 1 / (radius_px * relative[:, None]) ** 2

    def climb(self, coefficients: FloatArray, *, steps: int) -> tuple[FloatArray, float]:
        """Coefficients (N + 1, 2) of a local optimum, and its cost."""
        optimum = optimize.minimize(
            self._cost,
            coefficients.ravel(),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": steps},
        )
        return optimum.x.reshape(-1, 2), float(optimum.fun)

    def likeness(self, coefficients: FloatArray) -> float:
        return self._alike(self._otf.otf(self._basis @ coefficients) * self._hat)[0]

    def _cost(self, values: FloatArray) -> tuple[float, FloatArray]:
        coefficients = values.reshape(-1, 2)
        cosine, slope = self._alike(self._otf.otf(self._basis @ coefficients) * self._hat)
        error = 1 - cosine**2 + _FLOOR
        pulled = self._otf.slope(-self._count * cosine / error * slope * self._hat)
        weighted = self._precision * coefficients
        cost = 0.5 * self._count * np.log(error) + 0.5 * (weighted * coefficients).sum()
        return float(cost), (self._basis.T @ pulled + weighted).ravel()


def _relative_deviation(order: NDArray[np.intp], fall: float) -> FloatArray:
    return np.asarray(_STEADY / (1 + (order / _CORNER) ** fall))


def _series(path: Trajectory) -> FloatArray:
    """Legendre coefficients (N + 1, 2), px, of a path over the exposure."""
    nodes, weight = legendre.leggauss(4 * _NODES)
    basis = legendre.legvander(nodes, _ORDER)
    norms = 2 / (2 * np.arange(_ORDER + 1) + 1)
    return np.asarray((basis.T @ (weight[:, None] * path.at((nodes + 1) / 2))) / norms[:, None])


def _drawn(spread: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Random series (N + 1, 2), px, whose points have the covariance ``spread`` (2, 2), px^2."""
    order = np.arange(1, _ORDER + 1)
    draw = rng.standard_normal((_ORDER, 2)) * _relative_deviation(order, _FALL)[:, None]
    covariance = (draw / (2 * order[:, None] + 1)).T @ draw
    angle_rad = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    mapped = np.linalg.inv(_root(covariance)) @ np.array([[c, -s], [s, c]]) @ _root(spread)
    return np.concatenate([np.zeros((1, 2)), draw @ mapped])


def _root(spread: FloatArray) -> FloatArray:
    variances, axes = np.linalg.eigh(spread)
    return np.asarray((axes * np.sqrt(np.maximum(variances, 1e-9))) @ axes.T)


def _moments(light: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centroid (2,), px, of a PSF with sum 1, and its path's covariance (2, 2), px^2."""
    rows, columns = (np.arange(n) - n // 2 for n in light.shape)
    middle = np.array([light.sum(axis=0) @ columns, light.sum(axis=1) @ rows])
    x, y = columns - middle[0], rows - middle[1]
    mixed = y @ light @ x
    spread = np.array([[light.sum(axis=0) @ x**2, mixed], [mixed, light.sum(axis=1) @ y**2]])
    variances, axes = np.linalg.eigh(spread - HAT_VARIANCE_PX2 * np.eye(2))
    return middle, (axes * np.maximum(variances, _LEAST_VARIANCE_PX2)) @ axes.T


def _trajectory(coefficients: FloatArray) -> Trajectory:
    t = np.linspace(0, 1, _SAMPLES)
    return Trajectory.from_samples(legendre.legval(2 * t - 1, coefficients).T, t=t)
