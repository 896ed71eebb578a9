"""Wiener error and noise gain of an MTF."""

from __future__ import annotations

import numpy as np

from cep.optics.band import BandSamples
from cep.optics.code import ShutterCode
from cep.optics.scene import PHOTO, Scene, inverse_scene
from motdiff.types import FloatArray

HOPELESS_DB = 100.0
"""Noise gains above this say that a sample met a zero, and how closely rounding let it: tables
print "> 100"."""


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


def wiener_mse(
    power: FloatArray, samples: BandSamples, noise: float, *, scene: Scene = PHOTO
) -> float:
    r"""Least mean square error of a linear restoration: band mean of ``S N / (S |H|^2 + N)``.

    Parameters
    ----------
    power : (F,) float
        |H|^2 at the samples.
    samples : BandSamples
    noise : float
        Variance N of the noise per pixel.
    scene : Scene
        Its spectrum is S.
    """
    # S N / (S |H|^2 + N) = 1 / (|H|^2 / N + 1 / S)
    per_noise = power[:, None] / noise + inverse_scene(samples, scene=scene)
    return float(samples.weight @ (samples.radius2_weight / per_noise).sum(axis=1))
