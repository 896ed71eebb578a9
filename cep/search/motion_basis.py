r"""Chip basis of a motion on its band, and quadratic forms of codes in it.

At one frequency ``|H|^2 = c' G_f c`` with the Gram matrix ``G_f = Re conj(B(f)) B(f)'`` of the
chip basis. A 0/1 code with k ones has ``c_i (sum_j c_j - k) = 0``, so for any v

    ``c' G c = c' A c <= k lambda_max(A)``,   ``A = G + (v 1' + 1 v') / 2 - k diag(v)``.

Nothing is asked of v: a bad choice makes the bound loose, never wrong. Here all its numbers are
equal.

References
----------
Lovasz and Schrijver, "Cones of matrices and set-functions and 0-1 optimization", SIAM J. Optim.
1991: multiplying the constraint on the sum by each variable.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import BandSamples, circle_samples
from motdiff.trajectory import Trajectory
from motdiff.types import ComplexArray, FloatArray

# of a basis, a Gram matrix and its eigenvalues, relative to the largest number that enters
ROUNDING = 1e-11
MANY_CHIPS = 256  # beyond, samples and eigenvalues are taken more sparingly


@dataclass(frozen=True)
class MotionBasis:
    """Chip basis B of a motion on samples of its band.

    Attributes
    ----------
    motion : Trajectory or None
        None is the unit circle, chip by chip 1/n.
    reversible : bool
        Whether both directions count.
    samples : BandSamples
    basis : (n, F) complex
    """

    motion: Trajectory | None
    reversible: bool
    samples: BandSamples
    basis: NDArray[np.complex128]

    def gram(self, weights: FloatArray) -> FloatArray:
        """``sum_f a_f G_f``, the mean of both directions where both count."""
        matrix = gram(self.basis, weights)
        if self.reversible:
            # along the reversed path the chips' rows come in the opposite order
            return 0.5 * (matrix + matrix[::-1, ::-1])
        return matrix

    @cached_property
    def power(self) -> tuple[FloatArray, FloatArray]:
        """``sum_i |B_i|^2`` and ``|sum_i B_i|^2``, each (F,)."""
        return (np.abs(self.basis) ** 2).sum(axis=0), np.abs(self.basis.sum(axis=0)) ** 2

    def random_power(self, open_chips: int) -> FloatArray:
        """Mean of |H|^2 over all codes with k ones, (F,), kept away from 0."""
        return mean_power(*self.power, len(self.basis), open_chips)


def mean_power(
    chip_power: FloatArray, all_open: FloatArray, chips: int, open_chips: int
) -> FloatArray:
    """Mean of |H|^2 over all codes with k ones, kept away from 0."""
    # a pair of chips is open in this share of the codes, a single one in k / n of them
    pairs = open_chips * (open_chips - 1) / (chips * max(chips - 1, 1))
    mean = (open_chips / chips - pairs) * chip_power + pairs * all_open
    return np.asarray(np.maximum(mean, 1e-4 * mean.mean()), dtype=np.float64)


def gram(basis: ComplexArray, weights: FloatArray) -> FloatArray:
    """``sum_f a_f Re conj(B_f) B_f'``, (n, n), of an (n, F) basis."""
    root = basis * np.sqrt(weights)
    return np.asarray(root.real @ root.real.T + root.imag @ root.imag.T, dtype=np.float64)


def largest_forms(matrix: FloatArray, counts: NDArray[np.intp]) -> FloatArray:
    """Upper bounds of ``c' G c`` for each number of ones, (K,), with the best ``v = x 1``.

    With v = x 1 the matrix is ``G + x 1 1' - x k I``. Its largest eigenvalue lambda - x k has ``1
    / x = sum_i z_i^2 / (lambda - lambda_i)``, z the eigenvectors' sums: one decomposition serves
    all x and all k.
    """
    values, vectors = np.linalg.eigh(matrix)
    ones = vectors.sum(axis=0) ** 2
    top = values[-1]
    spread = max(float(np.ptp(values)), 1e-3 * float(np.abs(values).max()), 1e-300)
    second = values[-2] if len(values) > 1 else top - spread
    above = top + spread * len(values) * np.logspace(-12, 1.5, 160)
    between = second + (top - second) * np.linspace(0.005, 0.995, 100)
    multipliers = np.concatenate([between, above])[:, None]
    best = np.full(counts.size, np.inf)
    # any lambda gives a valid bound: a grid of them, then finer ones about the best
    for _ in range(4):
        with np.errstate(divide="ignore", invalid="ignore"):
            x = 1 / (ones / (multipliers[..., None] - values)).sum(axis=-1)
            # below the top eigenvalue only a negative x keeps lambda the largest
            valid = np.isfinite(x) & ((multipliers > top) | ((x < 0) & (multipliers > second)))
            forms = (
                multipliers
                - x * counts
                + ROUNDING * (np.abs(multipliers) + np.abs(x) * (counts + values.size) + abs(top))
            )
        forms = np.where(valid, forms, np.inf)
        pick = forms.argmin(axis=0)
        best = np.minimum(best, forms[pick, np.arange(counts.size)])
        columns = np.minimum(np.arange(counts.size), multipliers.shape[1] - 1)
        low = multipliers[np.maximum(pick - 1, 0), columns]
        high = multipliers[np.minimum(pick + 1, len(multipliers) - 1), columns]
        multipliers = low + (high - low) * np.linspace(0, 1, 24)[:, None]
    # the ends that the search only approaches: x = 0, and x without end, where only all chips open
    # are left
    best = np.minimum(best, top + ROUNDING * abs(top) * values.size)
    all_open = float(matrix.sum()) / values.size + ROUNDING * float(np.abs(matrix).sum())
    return np.asarray(counts * np.where(counts == values.size, all_open, best), dtype=np.float64)


def circle_grid(chips: int) -> BandSamples:
    """Sample the unit circle for averages that :func:`circle_average` makes exact."""
    return circle_samples(chips, oversampling=16 if chips <= MANY_CHIPS else 8)


def circle_average(values: FloatArray, chips: int) -> FloatArray:
    """Cut an even function on the circle's samples to low degree, (F,), not negative.

    Its square times any |P|^2 is then averaged without error by the samples; so a bound of mean
    1/|P|^2 from it holds for the mean over the whole circle, and on every finer grid.
    """
    lags = np.fft.irfft(values)
    degree = (lags.size - chips) // 2 - 1
    lags[degree + 1 : lags.size - degree] = 0
    cut = np.fft.rfft(lags).real
    return np.asarray(cut - 1.000001 * min(float(cut.min()), 0.0), dtype=np.float64)
