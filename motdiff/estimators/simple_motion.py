"""Simple motions fitted to a photo: straight, bent or accelerated, four numbers in all.

A kernel of a thousand pixels is known to within the errors of a blind search; a motion of four
numbers is known to a fraction of a pixel. It is fitted to the photo's power spectrum, which has
the motion's zeros in it whatever the scene is, and to the kernel, which has its phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy import fft, ndimage, optimize

from motdiff.metrics import mnc_subpixel
from motdiff.photo_noise import LEAST_SIGMA
from motdiff.psf_frame import centroid_px
from motdiff.tracing.path_otf import KernelLikeness, PathOtf, kernel_otf, power
from motdiff.tracing.quadratic import QuadraticPath, quadratic_of_psf
from motdiff.trajectory import Trajectory, bilinear_otf
from motdiff.types import BoolArray, FloatArray

_Single = NDArray[np.float32]

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

# likelihood of a blur
_BAND_CY_PX = (0.015, 0.4)  # below, the window; above, noise
# A scene's power scatters about any smooth law by more than a periodogram's exponential, as edges
# and patterns do: the exponential's mean has an inverse gamma distribution of this shape.
_TAIL = 3.0
_BROAD = 8.0  # bins: sigma over which the scene's law may bend; dips of a kernel are narrower
_NEIGHBOURS = 2.2  # periodogram values, correlated by the window, that count as one
_FALL = -2.36  # exponent of a photograph's power spectrum
_SCENE_STEPS = 6
_BEND_STEPS = 2
_LARGEST_RATIO = 6.0  # of power over its expectation, in the local means
_LEAST_SHARE = 2e-3  # of the scene in the light, where the local mean is taken


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

    def _scenes(self, values: FloatArray) -> list[_Single]:
        points = self._points(values)
        return [
            spectrum.scene(spectrum.smeared(power(otf.otf(points) * hat)))
            for spectrum, otf, hat in zip(self._spectra, self._otfs, self._hats, strict=True)
        ]

    def _cost(self, values: FloatArray, scenes: Sequence[_Single]) -> tuple[float, FloatArray]:
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


class PhotoSpectrum:
    """Power spectrum of a crop, and the likelihood of a blur's (Whittle).

    The model of the periodogram is ``W * (S |H|^2) + sigma^2`` with the scene's spectrum S and the
    smear W of the window. S is a power law with curvature and two harmonics of orientation, bent
    by broad local means: all of it is fitted, so that only the kernel's dips decide.

    Parameters
    ----------
    crop : (H, W) float, grey, linear light
    sigma : float
        Standard deviation of the noise.

    Attributes
    ----------
    fy, fx : (R,) and (C,) float, cycles/px
        Frequencies of the grid, rows increasing, columns from 0.

    References
    ----------
    Whittle, "Estimation and information in stationary time series", 1953.
    """

    def __init__(self, crop: FloatArray, *, sigma: float) -> None:
        height, width = crop.shape
        window = np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[1:-1]
        window /= np.sqrt(np.mean(window**2))
        centred = (crop - np.average(crop, weights=window)) * window
        power = np.abs(fft.rfft2(centred)) ** 2 / crop.size
        low, high = _BAND_CY_PX
        fy, fx = fft.fftfreq(height), fft.rfftfreq(width)
        rows = np.flatnonzero(np.abs(fy) < high + 1.5 / height)  # and a rim for the smear
        rows = rows[np.argsort(fy[rows])]
        columns = np.flatnonzero(fx < high + 1.5 / width)
        self.fy: FloatArray = fy[rows]
        self.fx: FloatArray = fx[columns]
        radius = np.hypot(self.fy[:, None], self.fx)
        self._in_band: BoolArray = (
            (radius > low)
            & (radius < high)
            & ((self.fx > 0) | (self.fy[:, None] > 0))  # each pair of conjugates once
        )
        self._power = np.where(self._in_band, power[np.ix_(rows, columns)], 0).astype(np.float32)
        self._noise = np.float32(max(sigma, LEAST_SIGMA) ** 2)
        log_radius = np.log(np.maximum(radius, low / 2))
        angle_rad = np.arctan2(self.fy[:, None], self.fx)
        laws = [np.ones_like(radius), log_radius, log_radius**2]
        laws += [wave(order * angle_rad) for order in (2, 4) for wave in (np.cos, np.sin)]
        self._laws = np.stack(laws, axis=-1).astype(np.float32)

    def smeared(self, power: FloatArray | _Single) -> _Single:
        """Smear (R, C) values as a Hann window does a power spectrum; its own transpose."""
        down = power * np.float32(2 / 3)
        down[1:] += power[:-1] / 6
        down[:-1] += power[1:] / 6
        across = down * np.float32(2 / 3)
        across[:, 1:] += down[:, :-1] / 6
        across[:, :-1] += down[:, 1:] / 6
        return np.asarray(across, dtype=np.float32)

    def scene(self, blur: _Single) -> _Single:
        """Fit the scene's power spectrum (R, C) beside a smeared blur ``|H|^2`` (R, C)."""
        laws, power, inside = (
            self._laws[self._in_band],
            self._power[self._in_band],
            blur[self._in_band],
        )
        law = np.zeros(laws.shape[1], dtype=np.float32)
        law[1] = _FALL
        law[0] = np.log(np.median(power) / np.median(np.exp(laws @ law) * inside + 1e-12))
        for _ in range(_SCENE_STEPS):  # Fisher's scoring
            light = np.exp(laws @ law) * inside
            expected = light + self._noise
            share = light / expected
            ratio = power / expected
            curvature = (laws * share[:, None] ** 2).T @ laws * (_TAIL / (_TAIL + 2))
            pull = (laws * share[:, None]).T @ ((_TAIL + 1) * ratio / (_TAIL + ratio) - 1)
            step = np.linalg.solve(curvature + 1e-3 * np.eye(len(law)), pull)
            law += np.clip(step, -1, 1).astype(np.float32)
        scene = np.exp(self._laws @ law)
        for _ in range(_BEND_STEPS):
            expected = scene * blur + self._noise
            share = np.where(self._in_band, scene * blur / expected, 0)
            ratio = np.minimum(self._power / expected, _LARGEST_RATIO) * share
            scene = (
                scene * (self._local(ratio) + _LEAST_SHARE) / (self._local(share) + _LEAST_SHARE)
            )
        return np.asarray(scene, dtype=np.float32)

    def misfit(self, blur: _Single, scene: _Single) -> tuple[float, _Single]:
        """Negative log likelihood, and its slope (R, C), of a smeared blur ``|H|^2`` (R, C)."""
        expected = scene * blur + self._noise
        ratio = self._power / expected
        losses = (_TAIL + 1) * np.log1p(ratio / _TAIL) + np.log(expected)
        slope = (1 - (_TAIL + 1) * ratio / (_TAIL + ratio)) / expected * scene
        return (
            float(losses[self._in_band].sum(dtype=np.float64)) / _NEIGHBOURS,
            np.where(self._in_band, slope, 0).astype(np.float32) / np.float32(_NEIGHBOURS),
        )

    def _local(self, values: FloatArray | _Single) -> FloatArray:
        """Gaussian means of (R, C) values, of whose other half plane the points are mirrored."""
        plane = np.concatenate([values[::-1, :0:-1], values], axis=1)
        means = ndimage.gaussian_filter(plane, _BROAD, truncate=2.5)
        return np.asarray(means[:, values.shape[1] - 1 :])
