"""Proofs from a relaxation: choice of frequencies, and bounds from its multipliers for all numbers
of open chips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import band_samples, straight_axis
from cep.optics.exposure import chip_basis
from cep.search.bounding.motion_basis import MotionBasis
from cep.search.bounding.relaxation import (
    DualProof,
    Relaxation,
    Solver,
    circle_average,
    largest_form,
    relax,
)
from motdiff.types import FloatArray

Counts = NDArray[np.intp]
_START = 200  # frequencies of the relaxed minimum
_ADDED = 150
_ROUNDS = 6  # the bound holds after any round; stop where one gains less
_SETTLED = 2e-3
_UNUSED = 1e-4  # weights below this share of the largest make room
_MOST_FREQUENCIES = (
    2600  # of a relaxed mean: Newton's matrix takes 54 MB and up to a second a step
)
_STRAIGHT_OVERSAMPLING = 8
_LIGHTS = 6  # numbers of open chips that are relaxed, the weakest first


def tightened(
    parts: Sequence[MotionBasis],
    counts: Counts,
    earlier: FloatArray,
    quantity: Literal["min", "noise"],
    *,
    solvers: Sequence[Solver] | None = None,
) -> tuple[FloatArray, list[DualProof]]:
    """Improve earlier bounds, (K,), one for each number of open chips, where the relaxation does.

    The number of open chips with the weakest bound is relaxed, its multipliers are tried on all
    others, and so on until the weakest has been relaxed. Where no solver finds an optimum, the
    earlier bounds stay.

    Parameters
    ----------
    parts : sequence of MotionBasis
        For "noise" the first counts, on the samples of its quadrature.
    counts : (K,) int
    earlier : (K,) float
        Light-true |H|, or dB.
    quantity : {"min", "noise"}
    solvers : sequence of callables, optional

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
    relaxed_proof = _minimum
    if quantity == "noise":  # a lower bound, in dB
        sign = -1.0
        relaxed_proof = _mean
    settled = -np.inf
    for _ in range(_LIGHTS):
        index = int((sign * best).argmax())
        k = int(counts[index])
        # neighbours of a relaxed number are hardly weaker: relaxing them too gains little
        if index in solved or not 1 < k < len(parts[0].basis) or sign * best[index] < settled:
            break
        solved.add(index)
        try:
            proof, matrix, reached = relaxed_proof(parts, k, solvers)
        except ValueError:  # no solver found an optimum
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
        margin = 0.01 * best[index] if quantity == "min" else 0.05
        settled = max(settled, sign * best[index] + margin)
    return best, [proofs[row] for row in sorted(proofs)]


def relaxed(
    parts: Sequence[MotionBasis], open_chips: int, *, solvers: Sequence[Solver] | None = None
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
        If no solver finds an optimum on the first frequencies.
    """
    power = np.concatenate([motion_basis.random_power(open_chips) for motion_basis in parts])
    sizes = [motion_basis.samples.fx.size for motion_basis in parts]
    spread = np.linspace(0, power.size - 1, min(_START // 2, power.size)).astype(np.intp)
    chosen = np.unique(np.concatenate([np.argsort(power)[: _START // 2], spread]))
    best: tuple[Relaxation, Counts] | None = None
    for _ in range(_ROUNDS):
        try:
            relaxation = relax(_columns(parts, _split(chosen, sizes)), open_chips, solvers=solvers)
        except ValueError:
            if best is None:
                raise
            break
        value = relaxation.weights.sum()
        before = 0.0
        if best is not None:
            before = best[0].weights.sum()
        if value > before:
            best = relaxation, chosen
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


def _minimum(
    parts: Sequence[MotionBasis], open_chips: int, solvers: Sequence[Solver] | None
) -> tuple[DualProof, FloatArray, float]:
    relaxation, chosen = relaxed(parts, open_chips, solvers=solvers)
    weights = np.maximum(relaxation.weights, 0.0)
    bounds = np.cumsum([index.size for index in chosen])
    matrix = np.zeros_like(relaxation.products)
    for motion_basis, index, share in zip(
        parts, chosen, np.split(weights, bounds[:-1]), strict=True
    ):
        matrix += replace(motion_basis, basis=motion_basis.basis[:, index]).gram(share)
    frequencies = [
        np.stack([p.samples.fx[i], p.samples.fy[i]], axis=1)
        for p, i in zip(parts, chosen, strict=True)
    ]
    proof = DualProof(
        quantity="min",
        chips=len(matrix),
        open_chips=open_chips,
        motions=tuple(motion_basis.motion for motion_basis in parts),
        both=tuple(motion_basis.both for motion_basis in parts),
        edges=tuple(motion_basis.edges for motion_basis in parts),
        motion=np.repeat(np.arange(len(parts)), [index.size for index in chosen]),
        frequencies=np.concatenate(frequencies),
        weights=weights,
        multipliers=relaxation.multipliers,
        bound=np.inf,
    )
    return proof, matrix, float(weights.sum())


def _mean(
    parts: Sequence[MotionBasis], open_chips: int, solvers: Sequence[Solver] | None
) -> tuple[DualProof, FloatArray, float]:
    motion_basis = parts[0]
    coarse = parts[0]
    samples = motion_basis.samples
    chips = len(motion_basis.basis)
    if motion_basis.motion is not None and straight_axis(motion_basis.motion) is not None:
        few = band_samples(motion_basis.motion, oversampling=_STRAIGHT_OVERSAMPLING)
        basis = chip_basis(motion_basis.motion, chips, few.fx, few.fy, edges=motion_basis.edges)
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
    relaxation = relax(columns, open_chips, shares=shares[active], solvers=solvers)
    ratio = np.sqrt(np.maximum(relaxation.weights, 0.0) / shares[active])
    if coarse is not motion_basis:
        radius = [np.hypot(s.fx, s.fy) for s in (samples, coarse.samples)]
        ratio = np.interp(radius[0], radius[1][active], ratio)
    elif motion_basis.motion is None:
        ratio = circle_average(ratio, chips)
    full = ratio
    if coarse is motion_basis:
        full = np.zeros_like(samples.weight)
        full[active] = ratio
    weights = samples.weight * full**2
    proof = DualProof(
        quantity="noise",
        chips=chips,
        open_chips=open_chips,
        motions=(motion_basis.motion,),
        both=(motion_basis.both,),
        edges=(motion_basis.edges,),
        motion=np.zeros(weights.size, dtype=np.intp),
        frequencies=np.stack([samples.fx, samples.fy], axis=1),
        weights=weights,
        multipliers=relaxation.multipliers,
        bound=-np.inf,
    )
    return proof, motion_basis.gram(weights), float(samples.weight @ full) ** 2


def _columns(parts: Sequence[MotionBasis], chosen: Sequence[Counts]) -> FloatArray:
    """``G_f = sum_r columns[:, f, r] columns[:, f, r]'``, (n, m, 2), or 4 where both directions
    count.
    """
    rank = 4 if any(motion_basis.both for motion_basis in parts) else 2
    blocks = []
    for motion_basis, index in zip(parts, chosen, strict=True):
        basis = motion_basis.basis[:, index]
        columns = np.stack([basis.real, basis.imag], axis=2)
        if motion_basis.both:
            columns = np.concatenate([columns, columns[::-1]], axis=2) / np.sqrt(2)
        blocks.append(np.pad(columns, ((0, 0), (0, 0), (0, rank - columns.shape[2]))))
    return np.concatenate(blocks, axis=1)


def _power(motion_basis: MotionBasis, products: FloatArray) -> FloatArray:
    """``tr(G_f C)`` on all samples, (F,)."""
    if motion_basis.both:
        products = 0.5 * (products + products[::-1, ::-1])
    return np.asarray(
        (motion_basis.basis.conj() * (products @ motion_basis.basis)).sum(axis=0).real,
        dtype=np.float64,
    )


def _split(chosen: Counts, sizes: Sequence[int]) -> list[Counts]:
    """Turn indices into all samples into indices into each part's."""
    starts = np.concatenate([[0], np.cumsum(sizes)])
    return [chosen[(chosen >= low) & (chosen < high)] - low for low, high in pairwise(starts)]
