r"""Bounds over all codes: of the smallest |H| and |P| from above, of the noise gain from below.

Each figure is the best of several arguments, in closed form or from one eigenvalue. A bound holds
for each number of open chips alone, and a problem's bound is the weakest over its range. Limits on
runs and single chips are ignored, so the bounds hold with them. A shutter with ramps is only
bounded by its light: its |H|^2 is no quadratic form in the code.

With the Gram matrices ``G_f`` of :mod:`cep.search.motion_basis`, for weights ``a_f >= 0``
and ``G = sum a_f G_f``, every code c obeys

- ``min |H|^2 <= c' G c / sum a_f``, since a minimum is at most a mean;
- ``mean 1/|H|^2 >= (sum sqrt(w_f a_f))^2 / c' G c`` for quadrature weights w, by Cauchy and
  Schwarz.

The bounds by name:

random-code
    ``min |P|^2 <= k (n - k) / (n - 1)``: the mean of |P|^2 over the n-th roots of unity except 1.
    No convex relaxation does better, as it admits the mean of all codes with k ones, whose ``C``
    gives just this.
degree-38
    Every code of at most 38 chips has ``min |P| <= 2``.
roots-of-unity
    The best that the counts of open chips in residue classes allow, for few chips.
light
    The value at zero frequency: the open time.
one-frequency
    ``|H(f)| <=`` the sum of the k largest |B_i(f)|.
weighted-parseval
    Straight uniform motion: random-code with the chip's sinc.
gram
    One eigenvalue of the Gram matrix averaged over the band outside a radius.
gram-rows
    The k largest row sums of that matrix, each of its diagonal and k - 1 largest others.
jensen
    ``mean 1/|H|^2 >= 1 / mean |H|^2``.
jensen-weighted
    The same with weights that suit the mean of all codes.

References
----------
Hare and Jankauskas, "On Newman and Littlewood polynomials with prescribed number of zeros inside
the unit disk", arXiv 1910.13994: the smallest degree with min |P| > 2 is 38.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import BandSamples, band_samples, straight_axis, uniform_length_px
from cep.optics.exposure import chip_basis, chip_parts
from cep.search.motion_basis import (
    MANY_CHIPS,
    MotionBasis,
    circle_average,
    circle_grid,
    largest_forms,
)
from cep.search.problem import SearchProblem
from motdiff.types import FloatArray

Counts = NDArray[np.intp]
_MOST_NUMBERS = 2**22  # of a basis: 64 MB
_UP = 1 + 1e-12  # a bound must not be rounded below the truth
_RADII = 12  # inside which the band is left out: which is best depends on the motion
_RADII_OF_MANY = 3  # of a long code: each takes the eigenvalues of an n x n matrix
_PROVEN_CHIPS = 38
_CLASSES = (8, 10, 12)  # beyond 24 chips the classes never beat the other bounds: measured
_CLASSES_PAY = 24
_TRIES = 6  # numbers of open chips whose weights are tried


@dataclass(frozen=True)
class Bound:
    """Bounds over every code within a problem's light.

    Attributes
    ----------
    min_mtf : float
        No code's smallest |H| exceeds it, worst scenario and direction under either rule;
        light-true. On the unit circle it is ``min_chip / chips``.
    min_chip : float
        No code's smallest |P| over the unit circle exceeds it, chips.
    noise : float
        No code's ``10 log10 mean 1/|H|^2`` lies below it, worst scenario and direction;
        light-true. The mean is that of :func:`cep.proofs.measure.measure`; on the unit circle it
        is the one over the whole circle.
    method : dict of str to str
        The argument with the best bound for each of the three.
    """

    min_mtf: float
    min_chip: float
    noise: float
    method: dict[str, str]


@dataclass(frozen=True)
class CountBounds:
    """Bounds of the codes of each number of open chips.

    Attributes
    ----------
    counts : (K,) int
        Numbers of open chips.
    min_mtf, min_chip, noise : (K,) float
        As of :class:`Bound`.
    method : dict of str to str
        The argument with the best bound at the count where each of the three is weakest.
    motions : list of MotionBasis
        Those that bound the minimum; none through ramps.
    noisiest : MotionBasis or None
        The motion that bounds the noise, on the samples of its quadrature; None where the light
        alone does.
    """

    counts: Counts
    min_mtf: FloatArray
    min_chip: FloatArray
    noise: FloatArray
    method: dict[str, str]
    motions: list[MotionBasis]
    noisiest: MotionBasis | None


def bound(problem: SearchProblem) -> Bound:
    """Bound the figures of all codes of ``problem``, in milliseconds to a second.

    Examples
    --------
    >>> limits = bound(SearchProblem.along(chips=16, open_range=(8, 8)))
    >>> print(f"no code has a minimum above {limits.min_chip:.3f} chips")
    no code has a minimum above 2.000 chips
    """
    by_count = count_bounds(problem)
    # a code may have any of these numbers of open chips: what holds for all is the weakest bound
    return Bound(
        min_mtf=float(by_count.min_mtf.max()),
        min_chip=float(by_count.min_chip.max()),
        noise=float(by_count.noise.min()),
        method=by_count.method,
    )


def count_bounds(problem: SearchProblem) -> CountBounds:
    """Bound the figures of the codes of each number of open chips within a problem's light."""
    low, high = problem.open_limits
    counts = np.arange(low, high + 1)
    chip_name, chip = _best(chip_ceilings(problem.chips, counts))
    motions, noisy_motions = _motions(problem)
    light = _light(problem, counts)
    mtf_name = chip_name
    mtf = chip / problem.chips
    if problem.scenarios:
        mtf_name, mtf = _best({"light": light, **_mtf_ceilings(motions, counts)})
    noise_name = "light"
    noise = -20 * np.log10(light)
    noisiest: MotionBasis | None = None
    for motion_basis in noisy_motions:
        # the worst scenario counts, and each of them bounds it
        name, floors = _best(_noise_floors(motion_basis, counts), upper=False)
        if floors.min() > noise.min():
            noise_name = name
            noise = floors
            noisiest = motion_basis
    names = {"min_mtf": mtf_name, "min_chip": chip_name, "noise": noise_name}
    return CountBounds(counts, mtf, chip, noise, names, motions, noisiest)


def chip_ceilings(chips: int, counts: Counts) -> dict[str, FloatArray]:
    """Upper bounds of the smallest |P|, in chips, for each number of ones, by name."""
    if chips == 1:
        return {"light": counts.astype(np.float64)}
    ceilings = {"random-code": np.sqrt(counts * (chips - counts) / (chips - 1)) * _UP}
    if chips <= _PROVEN_CHIPS:
        ceilings["degree-38"] = np.full(counts.size, 2.0)
    if chips <= _CLASSES_PAY:
        ceilings["roots-of-unity"] = _class_ceilings(chips)[counts] + 1e-12
    return ceilings


def _best(limits: dict[str, FloatArray], *, upper: bool = True) -> tuple[str, FloatArray]:
    """Best bound for each number of open chips, and the name of the weakest one's argument."""
    sign = 1.0 if upper else -1.0  # lower bounds are upper ones of the negated figure
    values = sign * np.stack(list(limits.values()))
    best = values.min(axis=0)
    weakest = int(best.argmax())
    return list(limits)[int(values[:, weakest].argmin())], sign * best


def _motions(problem: SearchProblem) -> tuple[list[MotionBasis], list[MotionBasis]]:
    """Bases of all motions: for minima on any frequencies, for means on the quadrature's."""
    chips = problem.chips
    if not problem.scenarios:
        samples = circle_grid(chips)
        # light-true, as along a motion: P over n
        basis = np.exp(-2j * np.pi * np.outer(np.arange(chips), samples.fx)) / chips
        circle = [MotionBasis(None, False, samples, basis)]
        return circle, circle
    for_minima = []
    for_means = []
    # through ramps |H|^2 is no quadratic form
    if problem.response is not None and not problem.response.instant:
        return [], []
    for motion in (scenario.trajectory for scenario in problem.scenarios):
        reversible = problem.both_directions(motion)
        samples = band_samples(motion)
        affordable = chips * samples.fx.size <= _MOST_NUMBERS
        if affordable:
            basis = chip_basis(motion, chips, samples.fx, samples.fy)
            for_means.append(MotionBasis(motion, reversible, samples, basis))
        if affordable and straight_axis(motion) is None:
            for_minima.append(for_means[-1])
            continue
        # a straight motion has few frequencies, so more are cheap; too many are thinned out
        samples = _thinned(band_samples(motion, oversampling=8), _MOST_NUMBERS // chips)
        basis = chip_basis(motion, chips, samples.fx, samples.fy)
        for_minima.append(MotionBasis(motion, reversible, samples, basis))
    return for_minima, for_means


def _light(problem: SearchProblem, counts: NDArray[np.intp]) -> FloatArray:
    """Most light that so many open chips let through, (K,), in the darkest scenario; 1 is all."""
    if not problem.scenarios:
        return np.asarray(counts / problem.chips, dtype=np.float64)
    ceiling = np.full(counts.size, np.inf)
    for scenario in problem.scenarios:
        basis, _, tail = chip_parts(
            scenario.trajectory, problem.chips, 0.0, 0.0, response=problem.response
        )
        # what opening takes away is left out: it only lowers the light; and each pulse has one
        # tail
        pulses = np.minimum(counts, problem.chips - counts + 1)
        chips, tails = (np.sort(column.real)[::-1].cumsum() for column in (basis, tail))
        ceiling = np.minimum(ceiling, chips[counts - 1] + tails[pulses - 1])
    return np.asarray(ceiling * (1 + 1e-12), dtype=np.float64)


def _thinned(samples: BandSamples, size: int) -> BandSamples:
    stride = slice(None, None, -(-samples.fx.size // size))
    return BandSamples(**{name: column[stride] for name, column in vars(samples).items()})


def _mtf_ceilings(parts: list[MotionBasis], counts: Counts) -> dict[str, FloatArray]:
    """Upper bounds of the smallest |H| over all motions for each number of ones, by name."""
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


def _noise_floors(motion_basis: MotionBasis, counts: Counts) -> dict[str, FloatArray]:
    """Lower bounds of 10 log10 mean 1/|H|^2 for each number of ones, by name."""
    weight = motion_basis.samples.weight
    mean_ceilings = largest_forms(motion_basis.gram(weight), counts)
    jensen = -10 * np.log10(np.maximum(mean_ceilings, 1e-300))
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
    return {"jensen": jensen, "jensen-weighted": best}


def _gram_ceilings(motion_basis: MotionBasis, counts: Counts) -> dict[str, FloatArray]:
    radius = np.hypot(motion_basis.samples.fx, motion_basis.samples.fy)
    chips = len(motion_basis.basis)
    eigen = np.full(counts.size, np.inf)
    rows = np.full(counts.size, np.inf)
    radii = _RADII if chips <= MANY_CHIPS else _RADII_OF_MANY
    for inner in np.linspace(0, 0.95 * radius.max(), radii):
        share = np.where(radius >= inner, motion_basis.samples.weight, 0.0)
        matrix = motion_basis.gram(share / share.sum())
        eigen = np.minimum(eigen, largest_forms(matrix, counts))
        # the diagonal, infinite for the sort, comes first
        ordered = np.sort(np.where(np.eye(chips, dtype=bool), np.inf, matrix), axis=1)[:, ::-1]
        ordered[:, 0] = np.diag(matrix)
        # column k - 1: the most that each open chip can add beside k - 1 others; the k largest of
        # them
        largest = np.sort(ordered.cumsum(axis=1), axis=0)[::-1].cumsum(axis=0).diagonal()
        rows = np.minimum(rows, largest[counts - 1] + 1e-12 * np.abs(matrix).sum())
    return {
        "gram": np.sqrt(np.maximum(eigen, 0.0)) * _UP,
        "gram-rows": np.sqrt(np.maximum(rows, 0.0)) * _UP,
    }


def _uniform_ceilings(motion_basis: MotionBasis, counts: Counts) -> dict[str, FloatArray]:
    """Find closed forms where a straight uniform motion's band covers the whole circle of |P|."""
    motion = motion_basis.motion
    if motion is None or uniform_length_px(motion) is None:
        return {}
    chips = len(motion_basis.basis)
    path = motion.xy[-1] - motion.xy[0]
    reach = 0.5 * float(np.abs(path).sum()) / chips  # cycles per chip in the band's corner
    if reach < 0.5 or chips == 1:
        return {}
    # |P| repeats: each n-th root of unity is seen wherever in the band the chip's sinc is smallest
    periods = np.arange(-np.ceil(reach) - 1, np.ceil(reach) + 1)
    frequency = np.arange(1, chips)[:, None] / chips + periods
    in_reach = np.abs(frequency) <= reach * _UP
    gain = np.where(in_reach, np.abs(np.sinc(frequency)), np.inf).min(axis=1)
    power = counts * (chips - counts) / np.sum(1 / np.maximum(gain, 1e-9) ** 2)
    ceilings = {name: values / chips for name, values in chip_ceilings(chips, counts).items()}
    del ceilings["random-code"]  # the next one is never higher
    ceilings["weighted-parseval"] = np.sqrt(power) / chips * _UP
    if reach >= 1:  # the chip's own zero
        ceilings["one-frequency"] = np.full(counts.size, 1e-15)
    return ceilings


@lru_cache(maxsize=64)
def _class_ceilings(chips: int) -> FloatArray:
    """Largest possible min |P| at the m-th roots of unity, for k = 0..n open chips.

    There P depends on the numbers of open chips in the residue classes mod m alone.
    """
    best = np.full(chips + 1, np.inf)
    for classes in {min(m, chips) for m in _CLASSES}:
        roots = np.exp(
            -2j * np.pi * np.outer(np.arange(classes), np.arange(classes // 2 + 1)) / classes
        )
        sizes = [len(range(first, chips, classes)) for first in range(classes)]
        # the counts of each half of the classes are listed, and every two joined
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
