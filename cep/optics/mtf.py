"""Reference scene, noise of its photos, and the Wiener error and noise gain of an MTF."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.band import BandSamples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from motdiff.types import FloatArray

# The reference scene has the 1/f^2 spectrum of natural images (Field 1987).
SCENE_MEAN = 0.25  # linear light of an all-open exposure: sRGB mid-tone 0.54
SCENE_STD = 0.2
HOPELESS_DB = 100.0
"""Noise gains above this say that a sample met a zero, and how closely rounding let it: tables
print "> 100"."""

_LOWEST_CY_PX = 1 / 256  # the 1/f^2 law stops here, or its variance would be infinite


def chip_noise_db(code: ShutterCode) -> float:
    """Noise gain ``10 log10 mean 1/|P|^2`` over the unit circle, on 512 points a chip.

    A zero on the circle makes it infinite; a grid near one gives a finite figure that proves
    nothing: see :func:`min_chip`.
    """
    size = 512 * code.chips
    power = np.abs(np.fft.rfft(code.array, size)) ** 2  # half of the circle: P is real
    weight = np.full(power.size, 2.0)
    weight[[0, -1]] = 1.0  # frequencies that are their own mirror
    with np.errstate(divide="ignore"):
        return float(10 * np.log10(weight @ (1 / power) / size))


def noise_variance(
    camera: Camera, duty: ArrayLike, *, integration_s: ArrayLike = 0.0
) -> FloatArray:
    """Variance per pixel of photos of the reference scene, open for (...) ``duty``.

    Dark current counts for ``integration_s``, as :meth:`cep.optics.camera.Camera.noise_variance`
    has it.
    """
    return camera.noise_variance(
        SCENE_MEAN * np.asarray(duty, dtype=np.float64), integration_s=integration_s
    )


@lru_cache(maxsize=1)
def scene_strength() -> float:
    """Return A of the scene's spectrum ``A / (f^2 + f0^2)``, which integrates to its variance."""
    # the inner integral of 1 / (f^2 + f0^2) has a closed form; u = asinh(fx / f0) makes the outer
    # one smooth
    u = np.linspace(0, np.arcsinh(0.5 / _LOWEST_CY_PX), 2001)
    radius = np.sqrt((_LOWEST_CY_PX * np.sinh(u)) ** 2 + _LOWEST_CY_PX**2)
    return SCENE_STD**2 / float(4 * np.trapezoid(np.arctan(0.5 / radius), u))


def inverse_scene(samples: BandSamples) -> FloatArray:
    """1 / S, (F, Q): the reference scene's inverse power spectrum at the samples."""
    return np.asarray((samples.radius2 + _LOWEST_CY_PX**2) / scene_strength(), dtype=np.float64)


def wiener_mse(power: FloatArray, samples: BandSamples, noise: float) -> float:
    r"""Least mean square error of a linear restoration: band mean of ``S N / (S |H|^2 + N)``.

    Parameters
    ----------
    power : (F,) float
        |H|^2 at the samples.
    samples : BandSamples
    noise : float
        Variance N of the noise per pixel.
    """
    # S N / (S |H|^2 + N) = 1 / (|H|^2 / N + 1 / S)
    per_noise = power[:, None] / noise + inverse_scene(samples)
    return float(samples.weight @ (samples.radius2_weight / per_noise).sum(axis=1))
