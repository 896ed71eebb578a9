"""Likelihood of a blur by the power spectra of crops, whatever their scenes are (Whittle)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from motdiff.types import BoolArray, FloatArray

_Single = NDArray[np.float32]

_BAND_CY_PX = (0.015, 0.4)  # below, the window; above, noise
_LEAST_SIGMA = 1e-3  # of full scale: simulated photos have no noise
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


class PhotoSpectrum:
    """Power spectrum of a crop, and the likelihood of a blur's.

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
        self._noise = np.float32(max(sigma, _LEAST_SIGMA) ** 2)
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
