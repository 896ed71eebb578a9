"""Bounds from a relaxation's multipliers, for all numbers of open chips, and their check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import band_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis, coded_otf
from cep.optics.straight_motion import straight_axis
from cep.search.bounds import (
    ROUNDING,
    MotionBasis,
    circle_average,
    circle_grid,
    count_bounds,
    gram,
)
from cep.search.problem import SearchProblem
from lab.relaxed_bounds.relaxation import Relaxation, relax
from motdiff.trajectory import Trajectory
from motdiff.types import ComplexArray, FloatArray

Counts = NDArray[np.intp]
_START = 200  # frequencies of the relaxed minimum
_ADDED = 150  # the lowest ones that a round adds
_ROUNDS = 6  # the bound holds after any round; stop where one gains less
_SETTLED = 2e-3
_UNUSED = 1e-4  # weights below this share of the largest make room
_MOST_FREQUENCIES = 2600  # of a relaxed mean: Newton's matrix takes 54 MB, a step up to a second
_MOST_CHIPS = 256  # of a relaxation, whose steps invert n x n matrices
_STRAIGHT_OVERSAMPLING = 8
_LIGHTS = 6  # numbers of open chips that are relaxed, the weakest first
_NEARLY_AS_WEAK = 0.01  # of a relaxed minimum: a number so little weaker is not relaxed as well
_NEARLY_AS_WEAK_DB = 0.05


@dataclass(frozen=True)
class DualProof:
    """A bound over all codes of one number of open chips, with all data to recompute it.

    Attributes
    ----------
    quantity : {"min", "noise"}
        Upper bound of the smallest |H| over all motions and directions, or lower bound of 10 log10
        mean 1/|H|^2 on the one motion, the worse of its directions.
    chips, open_chips : int
        n and k.
    motions : tuple of Trajectory or None
        None is the unit circle of the code's polynomial over n; frequencies are then cycles per
        chip.
    reversible : tuple of bool
        For each motion, whether both directions count: ``G_f`` is then the mean of both.
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
    reversible: tuple[bool, ...]
    motion: NDArray[np.intp]
    frequencies: FloatArray
    weights: FloatArray
    multipliers: FloatArray
    bound: float

    def check(self) -> bool:
        """Whether the bound holds, recomputed from the motions by other means.

        Of each chip alone the OTF is computed, and Cholesky stands for the eigenvalue: a matrix
        whose factor exists in floating point is positive definite up to rounding, which the bound
        has room for.
        """
        k = self.open_chips
        if not ((self.weights >= 0).all() and self.weights.any()):
            return False
        total = np.zeros((self.chips, self.chips))
        for index, (motion, reversible) in enumerate(
            zip(self.motions, self.reversible, strict=True)
        ):
            of_motion = self.motion == index
            basis = _basis_again(motion, self.chips, self.frequencies[of_motion])
            matrix = gram(basis, self.weights[of_motion])
            if reversible:
                matrix = 0.5 * (matrix + matrix[::-1, ::-1])
            total += matrix
        if self.quantity == "min":
            allowed = self.bound**2 * float(self.weights.sum()) / k
        else:
            allowed = self._power_of_means() / (10 ** (self.bound / 10) * k)
        test = allowed * np.eye(self.chips) - form_matrix(total, self.multipliers, k)
        try:
            np.linalg.cholesky(test)
        except np.linalg.LinAlgError:
            return False
        return True

    def _power_of_means(self) -> float:
        """``(sum sqrt(w a))^2``; 0 where the frequencies are no quadrature of the one motion."""
        (motion,) = self.motions
        samples = circle_grid(self.chips) if motion is None else band_samples(motion)
        if not np.array_equal(np.stack([samples.fx, samples.fy], axis=1), self.frequencies):
            return 0.0
        if motion is None:
            ratio = np.sqrt(self.weights / samples.weight)
            if np.abs(circle_average(ratio, self.chips) - ratio).max() > 1e-11 * ratio.max():
                return 0.0
        return float(np.sqrt(samples.weight * self.weights).sum()) ** 2


def relaxed_bound(problem: SearchProblem) -> tuple[float, tuple[DualProof, ...]]:
    """Bound the objective of all codes of a problem, in seconds to a minute.

    Returns
    -------
    bound : float
        Upper bound of the smallest |H| for the objective "min-mtf", or lower bound of 10 log10
        mean 1/|H|^2 for "noise"; never weaker than that of :func:`cep.search.bounds.bound`.
    proofs : tuple of DualProof
        One for each number of open chips that the relaxation bounds better.

    Raises
    ------
    ValueError
        If the problem has another objective.
    """
    if problem.objective not in ("min-mtf", "noise"):
        raise ValueError(f"objective: must be min-mtf or noise, got {problem.objective!r}")
    by_count = count_bounds(problem)
    affordable = problem.chips <= _MOST_CHIPS
    if problem.objective == "noise":
        if by_count.noisiest is None or not affordable:
            return float(by_count.noise.min()), ()
        noise, proofs = tightened([by_count.noisiest], by_count.counts, by_count.noise, "noise")
        return float(noise.min()), tuple(proofs)
    # on the circle a relaxation gains nothing: docs/decisions/proofs.md
    if not (problem.scenarios and by_count.motions and affordable):
        return float(by_count.min_mtf.max()), ()
    lowest, proofs = tightened(by_count.motions, by_count.counts, by_count.min_mtf, "min")
    return float(lowest.max()), tuple(proofs)


def tightened(
    parts: Sequence[MotionBasis],
    counts: Counts,
    earlier: FloatArray,
    quantity: Literal["min", "noise"],
) -> tuple[FloatArray, list[DualProof]]:
    """Improve earlier bounds, (K,), one for each number of open chips, by the relaxation.

    The number of open chips with the weakest bound is relaxed, its multipliers are tried on all
    others, and so on until the weakest has been relaxed. Where the relaxation has no solution,
    the earlier bounds stay.

    Parameters
    ----------
    parts : sequence of MotionBasis
        For "noise" the first counts, on the samples of its quadrature.
    counts : (K,) int
    earlier : (K,) float
        Light-true |H|, or dB.
    quantity : {"min", "noise"}

    Returns
    -------
    bounds : (K,) float
    proofs : list of DualProof
        Of the improved bounds.
    """
    best = earlier.copy()
    proofs = dict[int, DualProof]()
    solved = set[int]()
    sign = 1.0
    prove = _minimum
    if quantity == "noise":  # a lower bound, in dB
        sign = -1.0
        prove = _mean
    settled = -np.inf
    for _ in range(_LIGHTS):
        index = int((sign * best).argmax())
        k = int(counts[index])
        # neighbours of a relaxed number are hardly weaker: relaxing them too gains little
        if index in solved or not 1 < k < len(parts[0].basis) or sign * best[index] < settled:
            break
        solved.add(index)
        try:
            proof, matrix, reached = prove(parts, k)
        except ValueError:  # the relaxation found no optimum
            break
        for row, count in enumerate(counts):
            form = max(largest_form(matrix, proof.multipliers, int(count)), 1e-300)
            # a hair for the rounding of the power, which the proof is checked with
            if quantity == "min":
                value = (form / reached) ** 0.5 * (1 + 1e-12)
            else:
                value = 10 * np.log10(reached / form) - 1e-9
            if sign * value < sign * best[row]:
                best[row] = value
                proofs[row] = replace(proof, open_chips=int(count), bound=float(value))
        margin = _NEARLY_AS_WEAK * best[index] if quantity == "min" else _NEARLY_AS_WEAK_DB
        settled = max(settled, sign * best[index] + margin)
    return best, [proofs[row] for row in sorted(proofs)]


def relaxed(
    parts: Sequence[MotionBasis], open_chips: int
) -> tuple[Relaxation, list[NDArray[np.intp]]]:
    """Relax the largest smallest |H| over all frequencies, by adding the worst ones to a few.

    Returns
    -------
    relaxation : Relaxation
    chosen : list of (m_p,) int
        Its frequencies: indices into the samples of each part, in order.

    Raises
    ------
    ValueError
        If no optimum is found on the first frequencies.
    """
    power = np.concatenate([motion_basis.random_power(open_chips) for motion_basis in parts])
    sizes = [motion_basis.samples.fx.size for motion_basis in parts]
    # those where a random code is darkest, and others everywhere
    spread = np.linspace(0, power.size - 1, min(_START // 2, power.size)).astype(np.intp)
    chosen = np.unique(np.concatenate([np.argsort(power)[: _START // 2], spread]))
    best: tuple[Relaxation, Counts] | None = None
    value_reached = 0.0
    for _ in range(_ROUNDS):
        try:
            relaxation = relax(_columns(parts, _split(chosen, sizes)), open_chips)
        except ValueError:
            if best is None:
                raise
            break
        value = relaxation.weights.sum()
        before = value_reached
        if value > before:
            best = relaxation, chosen
            value_reached = value
        if value < before * (1 + _SETTLED):
            break
        reached = np.concatenate(
            [_power(motion_basis, relaxation.products) for motion_basis in parts]
        )
        low = np.argsort(reached)[:_ADDED]
        low = low[reached[low] < open_chips / value * (1 - _SETTLED)]
        active = chosen[relaxation.weights > _UNUSED * relaxation.weights.max()]
        more = np.unique(np.concatenate([active, low]))
        if np.isin(low, chosen).all():
            break
        chosen = more
    assert best is not None
    return best[0], _split(best[1], sizes)


def _minimum(parts: Sequence[MotionBasis], open_chips: int) -> tuple[DualProof, FloatArray, float]:
    relaxation, chosen = relaxed(parts, open_chips)
    weights = np.maximum(relaxation.weights, 0.0)
    sizes = [index.size for index in chosen]
    matrix = np.zeros_like(relaxation.products)
    shares = np.split(weights, np.cumsum(sizes)[:-1])
    for motion_basis, index, share in zip(parts, chosen, shares, strict=True):
        matrix += replace(motion_basis, basis=motion_basis.basis[:, index]).gram(share)
    frequencies = [_frequencies(basis)[index] for basis, index in zip(parts, chosen, strict=True)]
    proof = DualProof(
        quantity="min",
        chips=len(matrix),
        open_chips=open_chips,
        motions=tuple(motion_basis.motion for motion_basis in parts),
        reversible=tuple(motion_basis.reversible for motion_basis in parts),
        motion=np.repeat(np.arange(len(parts)), sizes),
        frequencies=np.concatenate(frequencies),
        weights=weights,
        multipliers=relaxation.multipliers,
        bound=np.inf,
    )
    return proof, matrix, float(weights.sum())


def _mean(parts: Sequence[MotionBasis], open_chips: int) -> tuple[DualProof, FloatArray, float]:
    motion_basis = coarse = parts[0]
    motion = motion_basis.motion
    samples = motion_basis.samples
    chips = len(motion_basis.basis)
    if motion is not None and straight_axis(motion) is not None:
        # fewer frequencies, whose weights are then interpolated: any weights give a bound
        few = band_samples(motion, oversampling=_STRAIGHT_OVERSAMPLING)
        basis = chip_basis(motion, chips, few.fx, few.fy)
        coarse = replace(motion_basis, samples=few, basis=basis)
    shares = coarse.samples.weight
    if shares.size > _MOST_FREQUENCIES:
        raise ValueError(
            f"samples: {shares.size} frequencies are too many to relax, at most"
            f" {_MOST_FREQUENCIES}"
        )
    # the ends of a straight band may weigh nothing
    active = shares > 0
    columns = _columns([coarse], [np.flatnonzero(active)])
    relaxation = relax(columns, open_chips, shares=shares[active])
    ratio = np.zeros_like(shares)
    ratio[active] = np.sqrt(np.maximum(relaxation.weights, 0.0) / shares[active])
    if coarse is not motion_basis:
        radius = [np.hypot(s.fx, s.fy) for s in (samples, coarse.samples)]
        ratio = np.interp(radius[0], radius[1][active], ratio[active])
    elif motion is None:
        ratio = circle_average(ratio, chips)
    weights = samples.weight * ratio**2
    proof = DualProof(
        quantity="noise",
        chips=chips,
        open_chips=open_chips,
        motions=(motion,),
        reversible=(motion_basis.reversible,),
        motion=np.zeros(weights.size, dtype=np.intp),
        frequencies=_frequencies(motion_basis),
        weights=weights,
        multipliers=relaxation.multipliers,
        bound=-np.inf,
    )
    return proof, motion_basis.gram(weights), float(samples.weight @ ratio) ** 2


def form_matrix(matrix: FloatArray, multipliers: FloatArray, open_chips: int) -> FloatArray:
    """Add terms that vanish on codes: ``A = G + (v 1' + 1 v') / 2 - k diag(v)``."""
    return matrix + 0.5 * (multipliers[:, None] + multipliers) - open_chips * np.diag(multipliers)


def largest_form(matrix: FloatArray, multipliers: FloatArray, open_chips: int) -> float:
    """Upper bound of ``c' G c`` over 0/1 codes with k ones, from any multipliers v (n,)."""
    form = form_matrix(matrix, multipliers, open_chips)
    scale = float(np.linalg.norm(matrix) + np.linalg.norm(form))
    return open_chips * float(np.linalg.eigvalsh(form)[-1] + ROUNDING * scale)


def _frequencies(motion_basis: MotionBasis) -> FloatArray:
    return np.stack([motion_basis.samples.fx, motion_basis.samples.fy], axis=1)


def _columns(parts: Sequence[MotionBasis], chosen: Sequence[Counts]) -> FloatArray:
    """``G_f = sum_r columns[:, f, r] columns[:, f, r]'``, (n, m, 2 or for both directions 4)."""
    rank = 4 if any(motion_basis.reversible for motion_basis in parts) else 2
    blocks = []
    for motion_basis, index in zip(parts, chosen, strict=True):
        basis = motion_basis.basis[:, index]
        columns = np.stack([basis.real, basis.imag], axis=2)
        if motion_basis.reversible:
            columns = np.concatenate([columns, columns[::-1]], axis=2) / np.sqrt(2)
        blocks.append(np.pad(columns, ((0, 0), (0, 0), (0, rank - columns.shape[2]))))
    return np.concatenate(blocks, axis=1)


def _power(motion_basis: MotionBasis, products: FloatArray) -> FloatArray:
    """``tr(G_f C)`` on all samples, (F,)."""
    if motion_basis.reversible:
        products = 0.5 * (products + products[::-1, ::-1])
    return np.asarray(
        (motion_basis.basis.conj() * (products @ motion_basis.basis)).sum(axis=0).real,
        dtype=np.float64,
    )


def _split(chosen: Counts, sizes: Sequence[int]) -> list[Counts]:
    """Turn indices into all samples into indices into each part's."""
    starts = np.concatenate([[0], np.cumsum(sizes)])
    return [chosen[(chosen >= low) & (chosen < high)] - low for low, high in pairwise(starts)]


def _basis_again(motion: Trajectory | None, chips: int, frequencies: FloatArray) -> ComplexArray:
    if motion is None:
        return np.asarray(
            np.exp(-2j * np.pi * np.outer(np.arange(chips), frequencies[:, 0])) / chips
        )
    fx, fy = frequencies.T
    single = [ShutterCode("0" * chip + "1" + "0" * (chips - chip - 1)) for chip in range(chips)]
    return np.stack([coded_otf(motion, code, fx, fy) for code in single])
