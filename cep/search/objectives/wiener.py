"""Objective of the restored photo: mean square error of the Wiener filter under a camera's noise.

References
----------
Wiener, "Extrapolation, Interpolation, and Smoothing of Stationary Time Series", 1949; Field,
"Relations between the statistics of natural images", J. Opt. Soc. Am. A 4, 1987: a power law.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cep.search.objectives.criterion import NO_TERM, Columns, Criterion, Spectrum

if TYPE_CHECKING:
    from motdiff.types import FloatArray


class WienerError(Criterion):
    """Expected error, ``10 log10 mean 1 / (|H|^2 / N + 1 / S)`` for noise N and scene S."""

    name = "mse"
    help = "expected error of the restored photo"
    cites = ("wiener1949", "field1987")
    needs = ("camera",)
    most_moves = 2**22  # four times as many gain the best code less than 0.03 dB
    averages = True

    def figure(self, spectrum: Spectrum) -> FloatArray:
        """Return the mean over the band and, on straight motion, over the radii across it."""
        signal = spectrum.power / spectrum.noise.astype(spectrum.power.dtype)[:, None]
        priors = spectrum.priors
        shares = spectrum.shares
        errors = sum(shares[:, q] / (signal + priors[:, q]) for q in range(shares.shape[1]))
        figure: FloatArray = (errors @ spectrum.weight).astype(float)
        return figure

    def terms(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """Return the terms ``share / (|H|^2 / N + 1 / S)``, Q of them at each frequency."""
        import numpy as np

        share = (columns.shares * columns.weight[:, None]).T
        counts = share > 0
        scale = np.zeros(share.shape)
        offset = np.full(share.shape, NO_TERM)
        scale[counts] = 1 / (share[counts] * columns.chips**2)
        offset[counts] = columns.priors.T[counts] / share[counts]
        return scale, offset

    def light(self, _open_chips: FloatArray, noise: FloatArray) -> FloatArray:
        """Return ``1 / N``."""
        return 1 / noise
