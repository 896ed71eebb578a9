r"""What no code can exceed.

For any probability measure mu on frequencies, a code's smallest |H|^2 is at most its mean over mu, which is ``c' G c``
with the Gram matrix ``G = Re int conj(B(f)) B(f)' dmu(f)`` of the chip basis. For a 0/1 code with k ones

- ``c' G c <= k lambda_max(G)``, since ``|c|^2 = k``;
- ``c' G c <= `` the sum of the k largest over i of ``G_ii +`` the k - 1 largest ``G_ij, j != i``.

Frequencies near zero pass any code, so mu leaves them out: mu is uniform on the band outside a radius, and the best of
several radii counts. Sums over samples are measures too, so no quadrature error enters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cep.band import band_samples, circle_samples
from cep.exposure import chip_basis
from cep.search.problem import SearchProblem

__all__ = ["Bound", "bound"]

FloatArray = NDArray[np.float64]
_RADII = 12


@dataclass(frozen=True)
class Bound:
    """Upper bounds over every code within a problem's light.

    Attributes
    ----------
    min_mtf : float
        Of the smallest |H|, worst scenario. Run limits are ignored, so it holds with them.
    min_chip : float
        Of the smallest |P| over the unit circle, chips.
    method : str
    """

    min_mtf: float
    min_chip: float
    method: str = "parseval-gram"


def bound(problem: SearchProblem) -> Bound:
    """Bound the smallest |H| of any code of ``problem``; the worst scenario's under either rule.

    References
    ----------
    Parseval on the unit circle: mean |P|^2 = k, hence min |P| <= sqrt(k).
    """
    low, high = problem.open_limits
    counts = range(low, high + 1)
    chip = min(float(np.sqrt(high)), max(_gram_bound(_circle_basis(problem.chips), counts)))
    # at zero frequency |H| is the duty
    mtf = min(high, chip) / problem.chips if not problem.scenarios else high / problem.chips
    for scenario in problem.scenarios:
        samples = band_samples(scenario.trajectory, oversampling=16)
        basis = chip_basis(scenario.trajectory, problem.chips, samples.fx, samples.fy)
        mtf = min(mtf, max(_gram_bound((basis, np.hypot(samples.fx, samples.fy), samples.weight), counts)))
    return Bound(mtf, chip)


def _circle_basis(chips: int) -> tuple[NDArray[np.complex128], FloatArray, FloatArray]:
    samples = circle_samples(chips, oversampling=16)
    return np.exp(-2j * np.pi * np.outer(np.arange(chips), samples.fx)), samples.fx, samples.weight


def _gram_bound(sampled: tuple[NDArray[np.complex128], FloatArray, FloatArray], counts: range) -> list[float]:
    """Bound of min |H| for each number of open chips."""
    basis, radius, weight = sampled
    best = np.full(len(counts), np.inf)
    for inner in np.linspace(0, 0.95 * radius.max(), _RADII):
        kept = radius >= inner
        share = weight[kept] / weight[kept].sum()
        part = basis[:, kept]
        gram = np.real((part.conj() * share) @ part.T)
        largest = float(np.linalg.eigvalsh(gram)[-1])
        diagonal = np.diag(gram).copy()
        others = np.sort(np.where(np.eye(len(gram), dtype=bool), -np.inf, gram), axis=1)[:, ::-1]
        for index, k in enumerate(counts):
            rows = diagonal + others[:, : k - 1].sum(axis=1)
            best[index] = min(best[index], k * largest, float(np.sort(rows)[::-1][:k].sum()))
    # rounding of the eigenvalue solver and of the sums
    return [float(np.sqrt(max(value, 0.0) * (1 + 1e-9) + 1e-15)) for value in best]
