r"""Quick bounds, in closed form or from one eigenvalue: of |P| on the circle, |H| along a motion,
and noise.

======================
=============================================================================================
random-code            ``min |P|^2 <= k (n - k) / (n - 1)``: the mean of |P|^2 over the n-th roots
of unity except 1.
                       No convex relaxation does better, as it admits the mean of all codes with k
                       ones, whose ``C`` gives just this.
degree-38              every code of at most 38 chips has ``min |P| <= 2`` roots-of-unity
the best that the counts of open chips in residue classes allow, for few chips light
the value at zero frequency: the open time
one-frequency          ``|H(f)| <=`` the sum of the k largest |B_i(f)|
weighted-parseval      straight uniform motion: random-code with the chip's sinc gram
one eigenvalue of the Gram matrix averaged over the band outside a radius gram-rows
the k largest row sums of that matrix, each of its diagonal and k - 1 largest others
jensen                 ``mean 1/|H|^2 >= 1 / mean |H|^2``
jensen-weighted        the same with weights that suit the mean of all codes; see
:mod:`cep.search.bounding.relaxation` ======================
=============================================================================================

References
----------
Hare and Jankauskas, "On Newman and Littlewood polynomials with prescribed number of zeros inside
the unit disk", arXiv 1910.13994: the smallest degree with min |P| > 2 is 38.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import BandSamples, uniform_length_px
from cep.search.bounding.relaxation import circle_average, gram, largest_forms
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

Counts = NDArray[np.intp]
_UP = 1 + 1e-12  # rounding
_RADII = 12
_PROVEN_CHIPS = 38
_CLASSES = (8, 10, 12)  # beyond 24 chips the classes never beat the other bounds: measured
_CLASSES_PAY = 24
_TRIES = 6


@dataclass(frozen=True)
class MotionBasis:
    """Chip basis of a motion on samples of its band.

    Attributes
    ----------
    motion : Trajectory or None
        None is the unit circle, chip by chip 1/n.
    both : bool
        Whether both directions count.
    samples : BandSamples
    basis : (n, F) complex
    edges : (n + 1,) float, optional
        Chip edges as fractions of the exposure, where they are not evenly spread.
    """

    motion: Trajectory | None
    both: bool
    samples: BandSamples
    basis: NDArray[np.complex128]
    edges: FloatArray | None = None

    def gram(self, weights: FloatArray) -> FloatArray:
        """``sum_f a_f G_f``, the mean of both directions where both count."""
        matrix = gram(self.basis, weights)
        return 0.5 * (matrix + matrix[::-1, ::-1]) if self.both else matrix

    @cached_property
    def power(self) -> tuple[FloatArray, FloatArray]:
        """``sum_i |B_i|^2`` and ``|sum_i B_i|^2``, each (F,)."""
        return (np.abs(self.basis) ** 2).sum(axis=0), np.abs(self.basis.sum(axis=0)) ** 2

    def random_power(self, open_chips: int) -> FloatArray:
        """Mean of |H|^2 over all codes with k ones, (F,), kept away from 0."""
        own, all_open = self.power
        n = len(self.basis)
        k = open_chips
        pairs = k * (k - 1) / (n * max(n - 1, 1))
        mean = (k / n - pairs) * own + pairs * all_open
        return np.asarray(np.maximum(mean, 1e-4 * mean.mean()), dtype=np.float64)


def chip_ceilings(chips: int, counts: Counts) -> dict[str, FloatArray]:
    """Upper bounds of the smallest |P| on the unit circle for each number of ones, in chips, by
    name.
    """
    if chips == 1:
        return {"light": counts.astype(np.float64)}
    found = {"random-code": np.sqrt(counts * (chips - counts) / (chips - 1)) * _UP}
    if chips <= _PROVEN_CHIPS:
        found["degree-38"] = np.full(counts.size, 2.0)
    if chips <= _CLASSES_PAY:
        found["roots-of-unity"] = _class_ceilings(chips)[counts] + 1e-12
    return found


def mtf_ceilings(parts: list[MotionBasis], counts: Counts) -> dict[str, FloatArray]:
    """Upper bounds of the smallest |H| over all motions for each number of ones, light-true, by
    name.
    """
    found = dict[str, FloatArray]()
    for part in parts:
        closed = _uniform_ceilings(part, counts)
        if not closed:
            largest = np.sort(np.abs(part.basis), axis=0)[::-1].cumsum(axis=0)
            closed = {
                "one-frequency": largest.min(axis=1)[counts - 1] * _UP,
                **_gram_ceilings(part, counts),
            }
        for name, values in closed.items():
            found[name] = np.minimum(found.get(name, np.inf), values)
    return found


def noise_floors(part: MotionBasis, counts: Counts) -> dict[str, FloatArray]:
    """Lower bounds of 10 log10 mean 1/|H|^2 for each number of ones, light-true, by name."""
    weight = part.samples.weight
    found = {
        "jensen": -10 * np.log10(np.maximum(largest_forms(part.gram(weight), counts), 1e-300))
    }
    best = np.full(counts.size, -np.inf)
    tried = set[int]()
    while len(tried) < _TRIES:
        # weights that suit one count serve all: try where the bound is lowest until that is tried
        index = int(best.argmin()) if tried else counts.size - 1
        if index in tried:
            break
        tried.add(index)
        ratio = 1 / part.random_power(int(counts[index]))
        if part.motion is None:
            ratio = circle_average(ratio, len(part.basis))
        reached = 20 * np.log10(float(weight @ ratio)) - 1e-9
        best = np.maximum(
            best, reached - 10 * np.log10(largest_forms(part.gram(weight * ratio**2), counts))
        )
    return {**found, "jensen-weighted": best}


def _gram_ceilings(part: MotionBasis, counts: Counts) -> dict[str, FloatArray]:
    radius = np.hypot(part.samples.fx, part.samples.fy)
    chips = len(part.basis)
    eigen = np.full(counts.size, np.inf)
    rows = np.full(counts.size, np.inf)
    for inner in np.linspace(0, 0.95 * radius.max(), _RADII if chips <= 256 else 3):
        share = np.where(radius >= inner, part.samples.weight, 0.0)
        matrix = part.gram(share / share.sum())
        eigen = np.minimum(eigen, largest_forms(matrix, counts))
        others = np.sort(np.where(np.eye(chips, dtype=bool), np.inf, matrix), axis=1)[:, ::-1]
        others[:, 0] = np.diag(matrix)
        # column k - 1: the most that each open chip can add beside k - 1 others; the k largest of
        # them
        most = np.sort(others.cumsum(axis=1), axis=0)[::-1].cumsum(axis=0).diagonal()
        rows = np.minimum(rows, most[counts - 1] + 1e-12 * np.abs(matrix).sum())
    return {
        "gram": np.sqrt(np.maximum(eigen, 0.0)) * _UP,
        "gram-rows": np.sqrt(np.maximum(rows, 0.0)) * _UP,
    }


def _uniform_ceilings(part: MotionBasis, counts: Counts) -> dict[str, FloatArray]:
    """Find closed forms where a straight uniform motion's band covers the whole circle of |P|."""
    if part.motion is None or part.edges is not None or uniform_length_px(part.motion) is None:
        return {}
    chips = len(part.basis)
    path = part.motion.xy[-1] - part.motion.xy[0]
    reach = 0.5 * float(np.abs(path).sum()) / chips  # cycles per chip in the band's corner
    if reach < 0.5 or chips == 1:
        return {}
    # |P| repeats: each n-th root of unity is seen wherever in the band the chip's sinc is smallest
    seen = np.arange(1, chips)[:, None] / chips + np.arange(
        -np.ceil(reach) - 1, np.ceil(reach) + 1
    )
    gain = np.where(np.abs(seen) <= reach * _UP, np.abs(np.sinc(seen)), np.inf).min(axis=1)
    power = counts * (chips - counts) / np.sum(1 / np.maximum(gain, 1e-9) ** 2)
    found = {
        name: values / chips
        for name, values in chip_ceilings(chips, counts).items()
        if name != "random-code"
    }
    found["weighted-parseval"] = np.sqrt(power) / chips * _UP
    if reach >= 1:  # the chip's own zero
        found["one-frequency"] = np.full(counts.size, 1e-15)
    return found


@lru_cache(maxsize=64)
def _class_ceilings(chips: int) -> FloatArray:
    """Best smallest |P| at the m-th roots of unity, any counts of open chips in the classes mod m,
    by k = 0..n.
    """
    best = np.full(chips + 1, np.inf)
    for classes in {min(m, chips) for m in _CLASSES}:
        roots = np.exp(
            -2j * np.pi * np.outer(np.arange(classes), np.arange(classes // 2 + 1)) / classes
        )
        sizes = [len(range(first, chips, classes)) for first in range(classes)]
        half = classes // 2
        (ones_a, values_a), (ones_b, values_b) = (
            _all_counts(sizes[part], roots[part])
            for part in (slice(0, half), slice(half, classes))
        )
        reached = np.zeros(chips + 1)
        for ones, value in zip(ones_a, values_a, strict=True):
            np.maximum.at(reached, ones + ones_b, np.abs(value + values_b).min(axis=1))
        best = np.minimum(best, reached)
    return best


def _all_counts(
    sizes: list[int], roots: NDArray[np.complex128]
) -> tuple[Counts, NDArray[np.complex128]]:
    grid = np.indices([size + 1 for size in sizes]).reshape(len(sizes), -1).T
    return grid.sum(axis=1), grid @ roots
