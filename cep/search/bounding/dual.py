r"""Proofs that no code exceeds a bound: one eigenvalue of a matrix that anybody can write down again.

At one frequency ``|H|^2 = c' G_f c`` with the Gram matrix ``G_f = Re conj(B(f)) B(f)'`` of the chip basis. For weights
``a_f >= 0`` and ``G = sum a_f G_f`` every code c obeys

- ``min |H|^2 <= c' G c / sum a_f``, since a minimum is at most a mean;
- ``mean 1/|H|^2 >= (sum sqrt(w_f a_f))^2 / c' G c`` for quadrature weights w, by Cauchy and Schwarz.

A 0/1 code with k ones has ``c_i (sum_j c_j - k) = 0``, so for any v

    ``c' G c = c' A c <= k lambda_max(A)``,   ``A = G + (v 1' + 1 v') / 2 - k diag(v)``.

Nothing is asked of a and v: a bad solver makes the bound loose, never wrong.

References
----------
Lovasz and Schrijver, "Cones of matrices and set-functions and 0-1 optimization", SIAM J. Optim. 1991: multiplying the
constraint on the sum by each variable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cep.band import BandSamples, band_samples, circle_samples
from cep.code import ShutterCode
from cep.exposure import coded_otf
from motdiff.trajectory import Trajectory

__all__ = ["DualProof", "circle_average", "circle_grid", "form_matrix", "gram", "largest_form", "largest_forms"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_ROUNDING = 1e-11  # of a basis, a Gram matrix and its eigenvalues, relative to the largest number that enters


@dataclass(frozen=True)
class DualProof:
    """A bound over all codes of one light, with all that is needed to find it again.

    Attributes
    ----------
    quantity : {"min", "noise"}
        Upper bound of the smallest |H| over all motions and directions, or lower bound of 10 log10 mean 1/|H|^2 on
        the one motion, the worse of its directions.
    chips, open_chips : int
        n and k.
    motions : tuple of Trajectory or None
        None is the unit circle of the code's polynomial over n; frequencies are then cycles per chip.
    both : tuple of bool
        For each motion, whether both directions count: ``G_f`` is then the mean of both.
    edges : tuple of (n + 1,) float or None
        For each motion, its chips' edges as fractions of the exposure, where they are not evenly spread.
    motion : (m,) int
        Which of them a frequency belongs to.
    frequencies : (m, 2) float, cycles/px
    weights : (m,) float
        a, not negative.
    multipliers : (n,) float
        v.
    bound : float
        Light-true |H|, or dB.
    """

    quantity: Literal["min", "noise"]
    chips: int
    open_chips: int
    motions: tuple[Trajectory | None, ...]
    both: tuple[bool, ...]
    edges: tuple[FloatArray | None, ...]
    motion: NDArray[np.intp]
    frequencies: FloatArray
    weights: FloatArray
    multipliers: FloatArray
    bound: float

    def check(self) -> bool:
        """Whether the bound holds, found again from the motions: other code for the basis, Cholesky for the eigenvalue.

        A matrix whose Cholesky factor exists in floating point is positive definite up to rounding, which the bound has
        room for.
        """
        k, n = self.open_chips, self.chips
        if not ((self.weights >= 0).all() and self.weights.any()):
            return False
        if any(both and edges is not None for both, edges in zip(self.both, self.edges, strict=True)):
            return False  # the reversed path is no mirror image then
        total = np.zeros((n, n))
        for index, (motion, both, edges) in enumerate(zip(self.motions, self.both, self.edges, strict=True)):
            mine = self.motion == index
            basis = _basis_again(motion, n, self.frequencies[mine], edges) * np.sqrt(self.weights[mine])
            part = basis.real @ basis.real.T + basis.imag @ basis.imag.T
            total += 0.5 * (part + part[::-1, ::-1]) if both else part
        if self.quantity == "min":
            allowed = self.bound**2 * float(self.weights.sum()) / k
        else:
            allowed = self._power_of_means() / (10 ** (self.bound / 10) * k)
        test = allowed * np.eye(n) - form_matrix(total, self.multipliers, k)
        try:
            np.linalg.cholesky(test)
        except np.linalg.LinAlgError:
            return False
        return True

    def _power_of_means(self) -> float:
        """``(sum sqrt(w a))^2``, where the frequencies are the quadrature of the one motion; 0 where they are not."""
        (motion,) = self.motions
        samples = circle_grid(self.chips) if motion is None else band_samples(motion)
        if not np.array_equal(np.stack([samples.fx, samples.fy], axis=1), self.frequencies):
            return 0.0
        if motion is None:
            ratio = np.sqrt(self.weights / samples.weight)
            if np.abs(circle_average(ratio, self.chips) - ratio).max() > 1e-11 * ratio.max():
                return 0.0
        return float(np.sqrt(samples.weight * self.weights).sum()) ** 2


def gram(basis: ComplexArray, weights: FloatArray) -> FloatArray:
    """``sum_f a_f Re conj(B_f) B_f'``, (n, n), of an (n, F) basis."""
    root = basis * np.sqrt(weights)
    return np.asarray(root.real @ root.real.T + root.imag @ root.imag.T, dtype=np.float64)


def form_matrix(matrix: FloatArray, multipliers: FloatArray, open_chips: int) -> FloatArray:
    """Add what vanishes on codes: ``A = G + (v 1' + 1 v') / 2 - k diag(v)``."""
    return matrix + 0.5 * (multipliers[:, None] + multipliers) - open_chips * np.diag(multipliers)


def largest_form(matrix: FloatArray, multipliers: FloatArray, open_chips: int) -> float:
    """Upper bound of ``c' G c`` over 0/1 codes with k ones, from any multipliers v (n,)."""
    form = form_matrix(matrix, multipliers, open_chips)
    scale = float(np.linalg.norm(matrix) + np.linalg.norm(form))
    return open_chips * float(np.linalg.eigvalsh(form)[-1] + _ROUNDING * scale)


def largest_forms(matrix: FloatArray, counts: NDArray[np.intp]) -> FloatArray:
    """Upper bounds of ``c' G c`` for each number of ones, (K,), with the best equal multipliers ``v = x 1``.

    With v = x 1 the matrix is ``G + x 1 1' - x k I``. Its largest eigenvalue lambda - x k has
    ``1 / x = sum_i z_i^2 / (lambda - lambda_i)``, z the eigenvectors' sums: one decomposition serves all x and all k.
    """
    values, vectors = np.linalg.eigh(matrix)
    ones = vectors.sum(axis=0) ** 2
    top, spread = values[-1], max(float(np.ptp(values)), 1e-3 * float(np.abs(values).max()), 1e-300)
    second = values[-2] if len(values) > 1 else top - spread
    above = top + spread * len(values) * np.logspace(-12, 1.5, 160)
    between = second + (top - second) * np.linspace(0.005, 0.995, 100)
    tried = np.concatenate([between, above])[:, None]
    best = np.full(counts.size, np.inf)
    for _ in range(4):
        with np.errstate(divide="ignore", invalid="ignore"):
            x = 1 / (ones / (tried[..., None] - values)).sum(axis=-1)
            # below the top eigenvalue only a negative x keeps lambda the largest
            valid = np.isfinite(x) & ((tried > top) | ((x < 0) & (tried > second)))
            found = tried - x * counts + _ROUNDING * (np.abs(tried) + np.abs(x) * (counts + values.size) + abs(top))
        found = np.where(valid, found, np.inf)
        pick = found.argmin(axis=0)
        best = np.minimum(best, found[pick, np.arange(counts.size)])
        columns = np.minimum(np.arange(counts.size), tried.shape[1] - 1)
        low = tried[np.maximum(pick - 1, 0), columns]
        high = tried[np.minimum(pick + 1, len(tried) - 1), columns]
        tried = low + (high - low) * np.linspace(0, 1, 24)[:, None]
    # the ends that the search only approaches: x = 0, and x without end, where only all chips open are left
    best = np.minimum(best, top + _ROUNDING * abs(top) * values.size)
    all_open = float(matrix.sum()) / values.size + _ROUNDING * float(np.abs(matrix).sum())
    return np.asarray(counts * np.where(counts == values.size, all_open, best), dtype=np.float64)


def circle_grid(chips: int) -> BandSamples:
    """Sample the unit circle for averages that :func:`circle_average` makes exact."""
    return circle_samples(chips, oversampling=16 if chips <= 256 else 8)


def circle_average(values: FloatArray, chips: int) -> FloatArray:
    """Cut an even function on the circle's samples to a trigonometric polynomial, (F,), not negative, of low degree.

    Its square times any |P|^2 is then averaged without error by the samples; so a bound of mean 1/|P|^2 from it holds
    for the mean over the whole circle, and on every finer grid.
    """
    lags = np.fft.irfft(values)
    degree = (lags.size - chips) // 2 - 1
    lags[degree + 1 : lags.size - degree] = 0
    cut = np.fft.rfft(lags).real
    return np.asarray(cut - 1.000001 * min(float(cut.min()), 0.0), dtype=np.float64)


def _basis_again(
    motion: Trajectory | None, chips: int, frequencies: FloatArray, edges: FloatArray | None
) -> ComplexArray:
    if motion is None:
        return np.asarray(np.exp(-2j * np.pi * np.outer(np.arange(chips), frequencies[:, 0])) / chips)
    single = [ShutterCode("".join("1" if i == chip else "0" for i in range(chips))) for chip in range(chips)]
    return np.stack([coded_otf(motion, code, frequencies[:, 0], frequencies[:, 1], edges=edges) for code in single])
