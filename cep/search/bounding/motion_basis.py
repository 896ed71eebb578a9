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
        if self.both:
            # along the reversed path the chips' rows come in the opposite order
            return 0.5 * (matrix + matrix[::-1, ::-1])
        return matrix

    @cached_property
    def power(self) -> tuple[FloatArray, FloatArray]:
        """``sum_i |B_i|^2`` and ``|sum_i B_i|^2``, each (F,)."""
        return (np.abs(self.basis) ** 2).sum(axis=0), np.abs(self.basis.sum(axis=0)) ** 2

    def random_power(self, open_chips: int) -> FloatArray:
        """Mean of |H|^2 over all codes with k ones, (F,), kept away from 0."""
        chip_power, all_open = self.power
        n = len(self.basis)
        k = open_chips
        pairs = k * (k - 1) / (n * max(n - 1, 1))
        mean = (k / n - pairs) * chip_power + pairs * all_open
        return np.asarray(np.maximum(mean, 1e-4 * mean.mean()), dtype=np.float64)


def chip_ceilings(chips: int, counts: Counts) -> dict[str, FloatArray]:
    """Upper bounds of the smallest |P| on the unit circle for each number of ones, in chips, by
    name.
    """
    if chips == 1:
        return {"light": counts.astype(np.float64)}
    ceilings = {"random-code": np.sqrt(counts * (chips - counts) / (chips - 1)) * _UP}
    if chips <= _PROVEN_CHIPS:
        ceilings["degree-38"] = np.full(counts.size, 2.0)
    if chips <= _CLASSES_PAY:
        ceilings["roots-of-unity"] = _class_ceilings(chips)[counts] + 1e-12
    return ceilings


def mtf_ceilings(parts: list[MotionBasis], counts: Counts) -> dict[str, FloatArray]:
    """Upper bounds of the smallest |H| over all motions for each number of ones, light-true, by
    name.
    """
    ceilings = dict[str, FloatArray]()
    for motion_basis in parts:
        uniform = _uniform_ceilings(motion_basis, counts)
        if not uniform:
            largest = np.sort(np.abs(motion_basis.basis), axis=0)[::-1].cumsum(axis=0)
            uniform = {
                "one-frequency": largest.min(axis=1)[counts - 1] * _UP,
                **_gram_ceilings(motion_basis, counts),
            }
        for name, values in uniform.items():
            ceilings[name] = np.minimum(ceilings.get(name, np.inf), values)
    return ceilings


def noise_floors(motion_basis: MotionBasis, counts: Counts) -> dict[str, FloatArray]:
    """Lower bounds of 10 log10 mean 1/|H|^2 for each number of ones, light-true, by name."""
    weight = motion_basis.samples.weight
    floors = {
        "jensen": -10
        * np.log10(np.maximum(largest_forms(motion_basis.gram(weight), counts), 1e-300))
    }
    best = np.full(counts.size, -np.inf)
    counted = set[int]()
    while len(counted) < _TRIES:
        # weights that suit one count serve all: try where the bound is lowest until that is tried
        index = int(best.argmin()) if counted else counts.size - 1
        if index in counted:
            break
        counted.add(index)
        ratio = 1 / motion_basis.random_power(int(counts[index]))
        if motion_basis.motion is None:
            ratio = circle_average(ratio, len(motion_basis.basis))
        reached = 20 * np.log10(float(weight @ ratio)) - 1e-9
        best = np.maximum(
            best,
            reached - 10 * np.log10(largest_forms(motion_basis.gram(weight * ratio**2), counts)),
        )
    return {**floors, "jensen-weighted": best}


def _gram_ceilings(motion_basis: MotionBasis, counts: Counts) -> dict[str, FloatArray]:
    radius = np.hypot(motion_basis.samples.fx, motion_basis.samples.fy)
    chips = len(motion_basis.basis)
    eigen = np.full(counts.size, np.inf)
    rows = np.full(counts.size, np.inf)
    for inner in np.linspace(0, 0.95 * radius.max(), _RADII if chips <= 256 else 3):
        share = np.where(radius >= inner, motion_basis.samples.weight, 0.0)
        matrix = motion_basis.gram(share / share.sum())
        eigen = np.minimum(eigen, largest_forms(matrix, counts))
        off_diagonal = np.sort(np.where(np.eye(chips, dtype=bool), np.inf, matrix), axis=1)[
            :, ::-1
        ]
        off_diagonal[:, 0] = np.diag(matrix)
        # column k - 1: the most that each open chip can add beside k - 1 others; the k largest of
        # them
        largest = np.sort(off_diagonal.cumsum(axis=1), axis=0)[::-1].cumsum(axis=0).diagonal()
        rows = np.minimum(rows, largest[counts - 1] + 1e-12 * np.abs(matrix).sum())
    return {
        "gram": np.sqrt(np.maximum(eigen, 0.0)) * _UP,
        "gram-rows": np.sqrt(np.maximum(rows, 0.0)) * _UP,
    }


def _uniform_ceilings(motion_basis: MotionBasis, counts: Counts) -> dict[str, FloatArray]:
    """Find closed forms where a straight uniform motion's band covers the whole circle of |P|."""
    if (
        motion_basis.motion is None
        or motion_basis.edges is not None
        or uniform_length_px(motion_basis.motion) is None
    ):
        return {}
    chips = len(motion_basis.basis)
    path = motion_basis.motion.xy[-1] - motion_basis.motion.xy[0]
    reach = 0.5 * float(np.abs(path).sum()) / chips  # cycles per chip in the band's corner
    if reach < 0.5 or chips == 1:
        return {}
    # |P| repeats: each n-th root of unity is seen wherever in the band the chip's sinc is smallest
    frequency = np.arange(1, chips)[:, None] / chips + np.arange(
        -np.ceil(reach) - 1, np.ceil(reach) + 1
    )
    gain = np.where(np.abs(frequency) <= reach * _UP, np.abs(np.sinc(frequency)), np.inf).min(
        axis=1
    )
    power = counts * (chips - counts) / np.sum(1 / np.maximum(gain, 1e-9) ** 2)
    ceilings = {
        name: values / chips
        for name, values in chip_ceilings(chips, counts).items()
        if name != "random-code"
    }
    ceilings["weighted-parseval"] = np.sqrt(power) / chips * _UP
    if reach >= 1:  # the chip's own zero
        ceilings["one-frequency"] = np.full(counts.size, 1e-15)
    return ceilings


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
            _all_counts(sizes[half_of_classes], roots[half_of_classes])
            for half_of_classes in (slice(0, half), slice(half, classes))
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
