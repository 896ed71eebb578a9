"""OTFs of paths with their slopes, and their likeness with a kernel: what fits of paths share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motdiff.tracing.quadratic import HAT_VARIANCE_PX2
from motdiff.types import ComplexArray, FloatArray

_LEAST_VARIANCE_PX2 = 0.05


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


def path_moments(light: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centroid (2,), px, of a PSF with sum 1, and its path's covariance (2, 2), px^2."""
    rows, columns = (np.arange(n) - n // 2 for n in light.shape)
    middle = np.array([light.sum(axis=0) @ columns, light.sum(axis=1) @ rows])
    x, y = columns - middle[0], rows - middle[1]
    mixed = y @ light @ x
    spread = np.array([[light.sum(axis=0) @ x**2, mixed], [mixed, light.sum(axis=1) @ y**2]])
    variances, axes = np.linalg.eigh(spread - HAT_VARIANCE_PX2 * np.eye(2))
    return middle, (axes * np.maximum(variances, _LEAST_VARIANCE_PX2)) @ axes.T
