"""Simple motions fitted to a photo: straight, bent or accelerated, four numbers in all.

A kernel of a thousand pixels is known to within the errors of a blind search; a motion of four
numbers is known to a fraction of a pixel. It is fitted to the photo's power spectrum, which has
the motion's zeros in it, and to the kernel, which has its phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy import optimize

from motdiff.estimators.photo_spectrum import PhotoSpectrum
from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import centroid_px
from motdiff.tracing.path_otf import KernelLikeness, PathOtf, kernel_otf, power
from motdiff.tracing.quadratic import QuadraticPath, quadratic_of_psf
from motdiff.trajectory import Trajectory, bilinear_otf
from motdiff.types import FloatArray

_NODES = 48
# of independent values that a kernel's error counts as, and the error that it has in any case
_KERNEL_COUNT = 60
_KERNEL_ERROR = 0.02
_ROUNDS = 3  # of the scene's spectrum and the motion in turn
_STEPS = 25
_LIKE = 0.8  # MNC with the kernel: less like, it is another motion
_WORSE = 50.0  # most log likelihood that four numbers may lose on the kernel's hundreds
_SLOPE_STEP_PX = 0.02
_LARGEST_ERROR_PX = 2.0  # larger, the photo does not show this motion
_ERROR_SCALE = 4.0  # of true errors over those by the curvature


@dataclass(frozen=True)
class SimpleMotion:
    """Simple motion that explains a photo as well as its kernel does.

    Attributes
    ----------
    path : Trajectory
        Of unknown direction.
    psf : (k, k) float
        Its PSF in the kernel's frame.
    error_px : float, px
        Expected error, rms over time.
    """

    path: Trajectory
    psf: FloatArray
    error_px: float


def simple_motion(crops: FloatArray, kernel: FloatArray, *, sigma: float) -> SimpleMotion | None:
    """Fit a motion of constant acceleration; None where the kernel explains the crops better.

    Parameters
    ----------
    crops : (C, H, W) float, grey, linear light
    kernel : (k, k) float, odd k, sum 1
    sigma : float
        Standard deviation of the noise.
    """
    start = quadratic_of_psf(kernel)
    if _likeness(start, kernel) < _LIKE:
        return None
    fit = _Fit([PhotoSpectrum(crop, sigma=sigma) for crop in crops], kernel)
    values, cost = fit.climbed(start)
    motion = QuadraticPath(values[:2], values[2:4])
    path = motion.trajectory()
    if (
        cost > fit.kernel_cost + _WORSE
        or path.frame_size() > len(kernel)
        or _likeness(motion, kernel) < _LIKE
    ):
        return None
    error_px = fit.error_px(values)
    if error_px > _LARGEST_ERROR_PX:
        return None
    return SimpleMotion(path, path.psf(len(kernel)), error_px)


class _Fit:
    """Cost of motions beside spectra of crops and a kernel.

    A motion's numbers (6,) are ``a`` and ``b`` of :class:`QuadraticPath` and the kernel's shift.
    """

    def __init__(self, spectra: Sequence[PhotoSpectrum], kernel: FloatArray) -> None:
        nodes, weight = legendre.leggauss(_NODES)
        tau = nodes / 2
        self._weight = weight / 2
        self._shapes = np.stack([tau, tau**2 - 1 / 12, np.ones(_NODES)])
        self._centroid = centroid_px(kernel)[::-1]
        self._spectra = spectra
        self._otfs = [PathOtf(s.fy, s.fx, self._weight) for s in spectra]
        self._hats = [bilinear_otf(s.fx, s.fy[:, None]).astype(np.float32) for s in spectra]
        self._alike = KernelLikeness(kernel, spectra[0].fy, spectra[0].fx)
        self.kernel_cost = 0.5 * _KERNEL_COUNT * np.log(_KERNEL_ERROR)
        for spectrum in spectra:
            blur = spectrum.smeared(power(kernel_otf(kernel, spectrum.fy, spectrum.fx)))
            self.kernel_cost += spectrum.misfit(blur, spectrum.scene(blur))[0]

    def climbed(self, start: QuadraticPath) -> tuple[FloatArray, float]:
        """Climb to the numbers of a local optimum, and return its cost as well."""
        values = np.concatenate([start.a, start.b, self._centroid])
        for _ in range(_ROUNDS):
            scenes = self._scenes(values)
            optimum = optimize.minimize(
                self._cost,
                values,
                args=(scenes,),
                jac=True,
                method="L-BFGS-B",
                options={"maxiter": _STEPS},
            )
            values = np.asarray(optimum.x, dtype=np.float64)
        return values, self._cost(values, self._scenes(values))[0]

    def error_px(self, values: FloatArray) -> float:
        """Estimate a path's error, px rms over time, from the cost's curvature in its numbers."""
        scenes = self._scenes(values)
        above, below = (
            [self._cost(values + step, scenes)[1] for step in sign * np.eye(len(values))]
            for sign in (_SLOPE_STEP_PX, -_SLOPE_STEP_PX)
        )
        curvature = (np.array(above) - np.array(below)) / (2 * _SLOPE_STEP_PX)
        strengths, axes = np.linalg.eigh(0.5 * (curvature + curvature.T))
        covariance = (axes / np.maximum(strengths, 1e-3)) @ axes.T
        # mean squares of the shapes, which are orthogonal, on both axes
        squares = np.repeat(self._shapes[:2] ** 2 @ self._weight, 2)
        return float(_ERROR_SCALE * np.sqrt(squares @ np.diag(covariance)[:4]))

    def _points(self, values: FloatArray) -> FloatArray:
        return np.asarray(self._shapes.T @ values.reshape(3, 2))

    def _scenes(self, values: FloatArray) -> list[NDArray[np.float32]]:
        points = self._points(values)
        return [
            spectrum.scene(spectrum.smeared(power(otf.otf(points) * hat)))
            for spectrum, otf, hat in zip(self._spectra, self._otfs, self._hats, strict=True)
        ]

    def _cost(
        self, values: FloatArray, scenes: Sequence[NDArray[np.float32]]
    ) -> tuple[float, FloatArray]:
        """Negative log likelihood of spectra and kernel, and its slope (6,)."""
        points = self._points(values)
        cost = 0.0
        slope = np.zeros_like(points)
        for i, (spectrum, scene) in enumerate(zip(self._spectra, scenes, strict=True)):
            otf = self._otfs[i].otf(points) * self._hats[i]
            misfit, by_power = spectrum.misfit(spectrum.smeared(power(otf)), scene)
            cost += misfit
            by_otf = 2 * spectrum.smeared(by_power) * otf
            if i == 0:  # the kernel counts once
                cosine, by_cosine = self._alike(otf)
                error = 1 - cosine**2 + _KERNEL_ERROR
                cost += 0.5 * _KERNEL_COUNT * float(np.log(error))
                by_otf = by_otf - _KERNEL_COUNT * cosine / error * by_cosine
            slope += self._otfs[i].slope(np.asarray(by_otf * self._hats[i], dtype=np.complex64))
        return cost, (self._shapes @ slope).ravel()


def _likeness(motion: QuadraticPath, kernel: FloatArray) -> float:
    path = motion.trajectory()
    return mnc_subpixel(path.psf(path.frame_size(len(kernel))), kernel)
