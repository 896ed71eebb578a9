r"""Bounds over all codes: of the smallest |H| and |P| from above, of the noise gain from below.

Each figure is the best of several arguments, in closed form or from one eigenvalue. A bound holds
for each number of open chips alone, and a problem's bound is the weakest over its range. Limits on
runs and single chips are ignored, so the bounds hold with them. A shutter with ramps is only
bounded by its light: its |H|^2 is no quadratic form in the code.

At one frequency ``|H|^2 = c' G_f c`` with the Gram matrix ``G_f = Re conj(B(f)) B(f)'`` of a
motion's chip basis. For weights ``a_f >= 0`` and ``G = sum a_f G_f`` every code c obeys

- ``min |H|^2 <= c' G c / sum a_f``, since a minimum is at most a mean;
- ``mean 1/|H|^2 >= (sum sqrt(w_f a_f))^2 / c' G c`` for quadrature weights w, by Cauchy and
  Schwarz.

A 0/1 code with k ones has ``c_i (sum_j c_j - k) = 0``, so for any v

    ``c' G c = c' A c <= k lambda_max(A)``,   ``A = G + (v 1' + 1 v') / 2 - k diag(v)``.

Nothing is asked of v: a bad choice makes the bound loose, never wrong. Here all its numbers are
equal.

The bounds by name:

random-code
    ``min |P|^2 <= k (n - k) / (n - 1)``: the mean of |P|^2 over the n-th roots of unity except 1.
    No convex relaxation does better, as it admits the mean of all codes with k ones, whose ``C``
    gives just this.
proven
    The largest minimum of all codes of so many chips, where one is proven: docs/optima.md.
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
Lovasz and Schrijver, "Cones of matrices and set-functions and 0-1 optimization", SIAM J. Optim.
1991: multiplying the constraint on the sum by each variable.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import BandSamples, band_samples, circle_samples
from cep.optics.exposure import chip_basis, chip_parts
from cep.optics.straight_motion import straight_axis, uniform_length_px
from cep.search.optima import proven_ceiling
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory
from motdiff.types import ComplexArray, FloatArray

Counts = NDArray[np.intp]
# of a basis, a Gram matrix and its eigenvalues, relative to the largest number that enters
ROUNDING = 1e-11
MANY_CHIPS = 256  # beyond, samples and eigenvalues are taken more sparingly
_MOST_NUMBERS = 2**22  # of a basis: 64 MB
_UP = 1 + 1e-12  # a bound must not be rounded below the truth
_RADII = 12  # inside which the band is left out: which is best depends on the motion
_RADII_OF_MANY = 3  # of a long code: each takes the eigenvalues of an n x n matrix
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
    no code has a minimum above 1.311 chips
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
    proven = np.array([proven_ceiling(chips, int(count)) for count in counts])
    if np.isfinite(proven).any():
        ceilings["proven"] = proven * _UP
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
