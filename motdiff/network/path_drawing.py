"""Paths drawn for a kernel: ordered in time, as cameras move, with the kernel as their PSF.

The draws are samples of a diffusion model of motions
(:class:`motdiff.network.path_denoiser.PathDenoiser`), led to the kernel at every noise level by
its exact OTF. The model has seen motions alone, no photos: so a draw is one connected path, and
what a kernel leaves open, such as the order of strands that cross, differs between draws.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, special

from motdiff.network.path_denoiser import POINTS, PathDenoiser
from motdiff.tracing.path_otf import KernelLikeness, PathOtf, path_moments
from motdiff.trajectory import Trajectory, bilinear_otf
from motdiff.types import FloatArray

_NODES = 128
_SAMPLES = 241  # of a trajectory
_FRAME_PX = 64  # a period that holds most kernels
_LEVELS = 16
_LARGEST_SIGMA = 12.0
_SMALLEST_SIGMA = 0.03
_SPACING = 5.0  # of the noise levels: their roots of this order are equally far apart
_STEPS = 12  # of descent at each level
# The kernel's error is unknown: half so many times the log of what of it the path leaves, with an
# error of the floor in any case.
_KERNEL_COUNT = 300
_FINE_KERNEL_COUNT = 600
_FINE_SIGMA = 0.1  # below this noise level
_FLOOR = 0.01
_MOST_BLURRED_PX = 8.0
_LAST_SIGMA = 0.4
_LAST_STEPS = 60
# A draw's evidence is its likeness, as so many independent values, and its density by the model.
# Neither is exact: differences of the log are divided (docs/decisions/tracing.md).
_EVIDENCE_COUNT = 100
_EVIDENCE_SIGMAS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
_EVIDENCE_NOISES = 8
_TEMPERATURE = 10.0
_SAME_ORDER_PX = 1.0  # rms distance at equal times
# Log odds that the likeliest order is right, by its own and by the surprise: rare motions can be
# run through in many ways (332 kernels, docs/decisions/tracing.md).
_RIGHT = (0.41, -0.0608, 3.0)
_LEAST_CHANCE = 1e-3


@dataclass(frozen=True)
class PathOrder:
    """An order in time along a kernel.

    Attributes
    ----------
    path : Trajectory
        Its likeliest draw, of unknown direction.
    chance : float
        Of it among the orders drawn, which sum to 1.
    right : float
        Probability that the path is the motion, to 1 px of the kernel rms at equal times in either
        direction, if the kernel is good.
    """

    path: Trajectory
    chance: float
    right: float


@dataclass(frozen=True)
class DrawnPaths:
    """Paths drawn for a kernel.

    Attributes
    ----------
    coefficients : (K, 64, 2) float, px
        Of the orthonormal discrete cosine transform of 64 positions at equal times.
    likeness : (K,) float
        Correlation of the paths' PSFs with the kernel.
    surprise : (K,) float
        Negative log density of each by the model, but for a constant.
    """

    coefficients: FloatArray
    likeness: FloatArray
    surprise: FloatArray

    @property
    def probabilities(self) -> FloatArray:
        """Probability (K,) of each to be the motion, if one of them is."""
        error = 1 - self.likeness**2 + _FLOOR
        cost = 0.5 * _EVIDENCE_COUNT * np.log(error) + self.surprise
        odds = np.exp(-(cost - cost.min()) / _TEMPERATURE)
        return np.asarray(odds / odds.sum(), dtype=np.float64)

    def path(self, draw: int) -> Trajectory:
        """Trajectory of a draw, of unknown direction."""
        t = np.linspace(0, 1, _SAMPLES)
        return Trajectory.from_samples(_cosines(t) @ self.coefficients[draw], t=t)

    def orders(self) -> tuple[PathOrder, ...]:
        """Different orders in time, likeliest first.

        Draws are of one order where they lie within 1 px rms at equal times, in either direction.
        """
        alike = _distances_px(self.coefficients) <= _SAME_ORDER_PX
        probabilities = self.probabilities
        unassigned = np.ones(len(alike), dtype=bool)
        orders = []
        while unassigned.any():
            order_chance = np.where(unassigned, (alike & unassigned) @ probabilities, -1)
            members = alike[np.argmax(order_chance)] & unassigned
            likeliest = int(np.argmax(np.where(members, probabilities, -1)))
            chance = float(probabilities[members].sum())
            right = _chance_right(chance, float(self.surprise[likeliest]))
            orders.append(PathOrder(self.path(likeliest), chance, right))
            unassigned &= ~members
        return tuple(sorted(orders, key=lambda order: -order.chance))


def _chance_right(chance: float, surprise: float) -> float:
    by_chance, by_surprise, offset = _RIGHT
    chance_log_odds = special.logit(np.clip(chance, _LEAST_CHANCE, 1 - _LEAST_CHANCE))
    return float(special.expit(by_chance * chance_log_odds + by_surprise * surprise + offset))


def draw_paths(
    denoiser: PathDenoiser, kernel: ArrayLike, *, count: int, rng: np.random.Generator
) -> DrawnPaths:
    """Draw paths whose PSF is a kernel.

    Parameters
    ----------
    denoiser : PathDenoiser
        In eval mode, on the CPU.
    kernel : (k, k) array_like
        Non-negative, with some light; zero displacement at index ``k // 2``.
    count : int
        Number of draws.

    Raises
    ------
    ValueError
        If there is no draw to make, or the kernel is no finite, non-negative array with light.

    Notes
    -----
    Decoupled annealing (Zhang, Chu, Berner, Meng, Anandkumar, Song, "Improving diffusion inverse
    problem solving with decoupled noise annealing", CVPR 2025, algorithm 1): at each noise level
    the denoised path is led to the kernel, within what the level leaves open of each coefficient,
    and noise of the next level is added. Its Langevin steps are a descent here.
    """
    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")
    light = np.asarray(kernel, dtype=np.float64)
    if not (np.isfinite(light).all() and light.min() >= 0 and light.any()):
        raise ValueError("kernel: must be finite and non-negative, with some light")
    light = light / light.sum()
    middle, spread = path_moments(light)
    radius_px = float(np.sqrt(np.trace(spread)))
    roots = np.linspace(
        _LARGEST_SIGMA ** (1 / _SPACING), _SMALLEST_SIGMA ** (1 / _SPACING), _LEVELS
    )
    # coefficient 0 is the mean of all points, a shift: the model does not know it
    shifts = np.tile(middle * np.sqrt(POINTS) / radius_px, (count, 1, 1))
    shapes = np.zeros((count, POINTS - 1, 2))
    for sigma in roots**_SPACING:
        noisy = shapes + sigma * rng.standard_normal(shapes.shape)
        fit = _KernelFit(light, denoiser, radius_px, sigma=sigma)
        shifts, shapes = fit.led(shifts, noisy, steps=_STEPS)
    # the last paths are smoothed as if they were so noisy, and may then be as rough: what the
    # kernel does not ask for goes
    last = _KernelFit(light, denoiser, radius_px, sigma=_LAST_SIGMA, blur_px=0.0)
    shifts, shapes = last.led(shifts, shapes, steps=_LAST_STEPS)
    coefficients = np.concatenate([shifts, shapes], axis=1)
    likeness = np.array([last.likeness(draw) for draw in coefficients])
    surprise = _surprise(denoiser, shapes, radius_px, rng)
    return DrawnPaths(radius_px * coefficients, likeness, surprise)


def _surprise(
    denoiser: PathDenoiser, shapes: FloatArray, radius_px: float, rng: np.random.Generator
) -> FloatArray:
    """Negative log density (K,) of shapes (K, 63, 2) by the model, down to its least noise level.

    It is, but for a constant, the integral over the log of the noise level of the mean squared
    error of denoising, in variances of the noise (Kong, Brekelmans, Ver Steeg,
    "Information-theoretic diffusion", ICLR 2023, equation 9), over the same noise for all shapes.
    """
    sigmas = np.repeat(_EVIDENCE_SIGMAS, _EVIDENCE_NOISES)
    noise = sigmas[:, None, None, None] * rng.standard_normal((len(sigmas), 1, *shapes.shape[1:]))
    levels = np.repeat(sigmas, len(shapes))
    denoised = _denoised(
        denoiser, (shapes + noise).reshape(-1, *shapes.shape[1:]), levels, radius_px
    )
    errors = ((denoised.reshape(-1, *shapes.shape) - shapes) ** 2).sum(axis=(2, 3))
    step = np.log(_EVIDENCE_SIGMAS[1] / _EVIDENCE_SIGMAS[0])
    return np.asarray(step * (errors / sigmas[:, None] ** 2).sum(axis=0) / _EVIDENCE_NOISES)


def _denoised(
    denoiser: PathDenoiser, noisy: FloatArray, sigmas: FloatArray, radius_px: float
) -> FloatArray:
    """Denoise shapes (B, 63, 2) with noise of levels (B,)."""
    with torch.inference_mode():
        denoised = denoiser(
            torch.from_numpy(noisy).float(),
            torch.from_numpy(sigmas).float(),
            torch.full((len(noisy),), radius_px),
        )
    return np.asarray(denoised.double().numpy(), dtype=np.float64)


class _KernelFit:
    """Paths expected beneath noise, led to a kernel (k, k) with sum 1.

    Coefficients are over the path's rms radius. ``blur_px`` is the sigma of the Gaussian through
    which a path's PSF is compared with the kernel, by the noise level where it is not given.
    """

    def __init__(
        self,
        kernel: FloatArray,
        denoiser: PathDenoiser,
        radius_px: float,
        *,
        sigma: float,
        blur_px: float | None = None,
    ) -> None:
        variances = denoiser.variances.double().numpy()
        open_squares = sigma**2 * variances / (sigma**2 + variances)
        if blur_px is None:
            point_error_px = radius_px * float(np.sqrt(open_squares.sum() / POINTS))
            blur_px = min(point_error_px, _MOST_BLURRED_PX)
        band_cy_px = min(0.5, 0.05 + 0.45 / max(blur_px, 0.1))
        period_px = _FRAME_PX if len(kernel) <= _FRAME_PX else 2 * len(kernel)
        rows = np.sort(np.fft.fftfreq(period_px)).astype(np.float64)
        columns = np.fft.rfftfreq(period_px).astype(np.float64)
        fy, fx = rows[np.abs(rows) <= band_cy_px], columns[columns <= band_cy_px]
        self._denoiser = denoiser
        self._radius_px = radius_px
        self._sigma = sigma
        self._cosines = _cosines((np.arange(_NODES) + 0.5) / _NODES)
        self._otf = PathOtf(fy, fx, np.full(_NODES, 1 / _NODES))
        self._hat = bilinear_otf(fx, fy[:, None]).astype(np.float32)
        self._alike = KernelLikeness(kernel, fy, fx, blur_px=blur_px)
        self._count = _KERNEL_COUNT if sigma > _FINE_SIGMA else _FINE_KERNEL_COUNT
        self._open = np.sqrt(np.r_[POINTS / radius_px**2, open_squares])[:, None]

    def led(
        self, shifts: FloatArray, noisy: FloatArray, *, steps: int
    ) -> tuple[FloatArray, FloatArray]:
        """Shifts (K, 1, 2) and shapes (K, 63, 2), denoised and led to the kernel."""
        levels = np.full(len(noisy), self._sigma)
        expected = _denoised(self._denoiser, noisy, levels, self._radius_px)
        starts = np.concatenate([shifts, expected], axis=1)
        led = np.stack([self._climbed(start, steps=steps) for start in starts])
        return led[:, :1], led[:, 1:]

    def likeness(self, coefficients: FloatArray) -> float:
        """Correlation with the kernel of the PSF of a path's coefficients (64, 2)."""
        return self._alike(self._otf_of(coefficients))[0]

    def _climbed(self, start: FloatArray, *, steps: int) -> FloatArray:
        """Coefficients (64, 2) near the start, likelier by the kernel."""

        def cost(values: FloatArray) -> tuple[float, FloatArray]:
            change = values.reshape(start.shape)  # in standard deviations
            cosine, by_otf = self._alike(self._otf_of(start + self._open * change))
            error = 1 - cosine**2 + _FLOOR
            by_points = self._otf.slope(-self._count * cosine / error * by_otf * self._hat)
            slope = self._radius_px * self._open * (self._cosines.T @ by_points) + change
            misfit = self._count * np.log(error) + (change**2).sum()
            return 0.5 * float(misfit), slope.ravel()

        optimum = optimize.minimize(
            cost,
            np.zeros(start.size),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": steps},
        )
        return np.asarray(start + self._open * optimum.x.reshape(start.shape), dtype=np.float64)

    def _otf_of(self, coefficients: FloatArray) -> NDArray[np.complex64]:
        points = self._radius_px * (self._cosines @ coefficients)
        return np.asarray(self._otf.otf(points) * self._hat)


def _cosines(t: FloatArray) -> FloatArray:
    """Orthonormal cosines (N, 64) at the times ``t`` (N,), 0..1."""
    order = np.arange(POINTS)
    scale = np.sqrt(np.where(order == 0, 1.0, 2.0) / POINTS)
    return np.asarray(scale * np.cos(np.pi * order * t[:, None]))


def _distances_px(coefficients: FloatArray) -> FloatArray:
    """Rms distances (K, K), px, at equal times, of centred paths in the better direction."""
    forwards = coefficients[:, 1:].reshape(len(coefficients), -1)
    # a path run backwards: cosines of odd order change sign
    signs = np.where(np.arange(1, POINTS) % 2, -1.0, 1.0)[:, None]
    backwards = (coefficients[:, 1:] * signs).reshape(forwards.shape)
    squares = np.stack(
        [((forwards[:, None] - directed) ** 2).sum(axis=-1) for directed in (forwards, backwards)]
    )
    return np.asarray(np.sqrt(squares.min(axis=0) / POINTS))
