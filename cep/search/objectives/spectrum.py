"""Objectives of the modulus of the OTF alone: its minimum, its flatness, its noise gain.

H is light-true, so lost light raises the cost everywhere but in the flatness.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cep.search.objectives.criterion import (
    FLATNESS,
    LEAST_X,
    NO_TERM,
    STEEP,
    Columns,
    Criterion,
    Spectrum,
)

if TYPE_CHECKING:
    from motdiff.types import FloatArray


class MinMtf(Criterion):
    """Smallest modulus over the band, ``-20 log10 min |H|``."""

    name = "min-mtf"
    help = "smallest MTF"
    cites = ("raskar2006",)
    hot_db = 0.8
    continuum = True
    kind = STEEP

    def figure(self, spectrum: Spectrum) -> FloatArray:
        """Return ``1 / min |H|^2``."""
        lowest: FloatArray = spectrum.power.min(axis=1).astype(float)
        return 1 / lowest

    def terms(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """Return the terms of ``sum 1 / |H|^8``, whose fourth root is close to ``1 / min |H|^2``.

        The sum is smooth and the loops can stop early within it, as within a mean.
        """
        flat = columns.weight[None] * 0.0  # no weights: the smallest term alone counts
        return flat + columns.chips**-2, flat + LEAST_X


class Flatness(Criterion):
    """Variance of the modulus over the band, ``10 log10 (var |H| / duty^2)``."""

    name = "flatness"
    help = "variance of the MTF"
    cites = ("raskar2006", "jeon2017")
    kind = FLATNESS

    def figure(self, spectrum: Spectrum) -> FloatArray:
        """Return ``(mean |H|^2 - mean^2 |H|) / duty^2``."""
        import numpy as np

        mean_power = (spectrum.power @ spectrum.weight).astype(float)
        mean = (np.sqrt(spectrum.power) @ spectrum.weight).astype(float)
        # the difference of two means of equal size may round to zero or below
        return np.asarray(np.maximum(mean_power - mean**2, 1e-12) / spectrum.duty**2)

    def terms(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """Return the weights of both means; the loops form the variance and need no offset."""
        weight = columns.weight[None]
        return weight, weight * 0.0 + NO_TERM

    def light(self, open_chips: FloatArray, _noise: FloatArray) -> FloatArray:
        """Return ``1 / open_chips^2``."""
        factor = open_chips * 0.0 + 1.0
        factor[1:] = 1.0 / open_chips[1:] ** 2
        return factor


class NoiseGain(Criterion):
    """Noise gain of the inverse filter, ``10 log10 mean 1 / |H|^2``."""

    name = "noise"
    help = "noise gain of the inverse filter"
    cites = ("agrawal2009capture",)
    hot_db = 0.3
    averages = True

    def figure(self, spectrum: Spectrum) -> FloatArray:
        """Return ``mean 1 / |H|^2``."""
        mean: FloatArray = ((1 / spectrum.power) @ spectrum.weight).astype(float)
        return mean

    def terms(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """Return the terms of the mean."""
        scale = 1 / (columns.weight[None] * columns.chips**2)
        return scale, scale * 0.0 + LEAST_X
