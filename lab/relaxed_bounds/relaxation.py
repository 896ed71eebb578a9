"""Semidefinite relaxation of the search, whose value bounds all codes.

The products ``C = c c'`` of all codes with k ones are relaxed to symmetric ``C >= 0`` with ``tr C
= k`` and ``C 1 = k diag C``, which imply the lifted ``[[1, c'], [c, C]] >= 0`` with ``c = diag
C``. The dual problem is solved,

    maximise ``g(a)`` over a >= 0 and v,  subject to  ``I - sum a_f G_f - (v 1' + 1 v') / 2 + k
    diag v >= 0``,

with ``g = sum a_f`` for the smallest |H|^2 (whose bound is k / g) and ``g = sum sqrt(w_f a_f)``
for the mean of 1/|H|^2 (whose bound is g^2 / k). Newton steps on its logarithmic barrier cost
little, as each G_f has two or four columns, and the barrier's inverse matrix is the relaxed C. The
result is only used as multipliers of a :class:`lab.relaxed_bounds.dual_proofs.DualProof`.

References
----------
Mo and Duarte, "Design of spectrally shaped binary sequences via randomized convex relaxation",
2018: lifting. Benson, Ye and Zhang, "Solving large-scale sparse
semidefinite programs for combinatorial optimization", SIAM J. Optim. 2000: the dual barrier for
low-rank constraints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from cep.search.bounds import mean_power
from motdiff.types import FloatArray

_GAP = 1e-4  # relative, where Newton stops; 0.0004 dB of the bound, which holds at any gap
_GAP_OF_MEAN = 2e-3  # the same of a mean, whose steps are the dearer ones; 0.02 dB
_MOST_STEPS = 150
_COOLING = 0.15  # of the barrier's heat once a step gains little
_COOLING_OF_MEAN = 0.1
_SMALL_GAIN = 0.3  # of a step by the quadratic model: below it the path's centre is near enough
_BLOCK = 128  # frequencies whose products with all others are held at once


@dataclass(frozen=True)
class Relaxation:
    """Solution of the relaxation on some frequencies.

    Attributes
    ----------
    weights : (m,) float
        a of the dual problem.
    multipliers : (n,) float
        v of the dual problem.
    products : (n, n) float
        C, of trace k.
    """

    weights: FloatArray
    multipliers: FloatArray
    products: FloatArray


def relax(columns: FloatArray, open_chips: int, *, shares: FloatArray | None = None) -> Relaxation:
    """Solve the relaxation: follow the barrier's central path by damped Newton steps.

    Parameters
    ----------
    columns : (n, m, r) float
        ``G_f = sum_r columns[:, f, r] columns[:, f, r]'``, of any common scale.
    open_chips : int
        k, 1 < k < n.
    shares : (m,) float, optional
        Quadrature weights: bound the mean of 1/|H|^2. Without them, the smallest |H|.

    Raises
    ------
    ValueError
        If the steps end short of the optimum.
    """
    # the first step suits matrices with entries of about 1
    scale = float((columns**2).sum(axis=(0, 2)).mean())
    columns = columns / np.sqrt(scale)
    chips, m, rank = columns.shape
    flat = columns.reshape(chips, m * rank)
    # column i is what chip i's multiplier multiplies
    products = np.ones((chips, chips)) - open_chips * np.eye(chips)

    def slack(a: FloatArray, v: FloatArray) -> FloatArray:
        gram = (flat * np.repeat(a, rank)) @ flat.T
        return np.asarray(np.eye(chips) - gram - 0.5 * (v[:, None] + v) + open_chips * np.diag(v))

    def goal(a: FloatArray) -> float:
        if shares is None:
            return float(a.sum())
        return float(np.sqrt(shares * a).sum())

    def merit(a: FloatArray, v: FloatArray, heat: float) -> float:
        try:
            factor = np.linalg.cholesky(slack(a, v))
        except np.linalg.LinAlgError:
            return -np.inf
        wall = 0.0
        if shares is None:  # the other goal's root, infinitely steep at 0, keeps a above 0
            wall = float(np.log(a).sum())
        return goal(a) / heat + 2 * float(np.log(np.diag(factor)).sum()) + wall

    a = np.ones(m)
    gap = _GAP
    cooling = _COOLING
    walls = chips + m
    if shares is not None:
        # for 1/x the best weights are w / x^2: start from x of a random code
        chip_power = (columns**2).sum(axis=(0, 2))
        all_open = (columns.sum(axis=0) ** 2).sum(axis=1)
        a = shares / mean_power(chip_power, all_open, chips, open_chips) ** 2
        gap = _GAP_OF_MEAN
        cooling = _COOLING_OF_MEAN
        walls = chips
    # half of what the semidefinite limit allows: well inside
    a *= 0.5 / float(np.linalg.eigvalsh((flat * np.repeat(a, rank)) @ flat.T)[-1])
    v = np.zeros(chips)
    heat = goal(a) / walls
    for _ in range(_MOST_STEPS):
        inverse = np.linalg.inv(slack(a, v))
        inverse = 0.5 * (inverse + inverse.T)
        step, gain = _newton_step(flat, rank, inverse, products, a, shares, heat)
        if gain < _SMALL_GAIN:
            if heat * walls < gap * goal(a):
                relaxed = np.asarray(inverse * (open_chips / float(np.trace(inverse))))
                return Relaxation(a / scale, v, relaxed)
            heat *= cooling
            continue
        down = step[:m] < 0
        length = 1.0
        if down.any() and step[:m].min() < -0.9:
            length = min(1.0, 0.9 / float(-step[:m][down].min()))
        before = merit(a, v, heat)
        while length >= 1e-9:
            # steps in a are relative, so that one scale suits large and small weights
            further = (a * (1 + length * step[:m]), v + length * step[m:])
            if merit(*further, heat) >= before + 0.1 * length * gain:  # Armijo's rule
                break
            length *= 0.5
        else:
            break
        a, v = further
    raise ValueError("relaxation: the steps ended short of the optimum")


def _newton_step(
    flat: FloatArray,
    rank: int,
    inverse: FloatArray,
    products: FloatArray,
    a: FloatArray,
    shares: FloatArray | None,
    heat: float,
) -> tuple[FloatArray, float]:
    """Newton's step in (da / a, dv), and its gain by the quadratic model."""
    m = a.size
    through = inverse @ flat
    pairs = _pairs(flat, through, rank)
    mixed = (through * (products @ through)).reshape(len(inverse), m, rank).sum(axis=2)
    transformed = inverse @ products
    chips = 0.5 * (inverse * (products @ transformed) + transformed * transformed.T)
    slope = -(flat * through).sum(axis=0).reshape(m, rank).sum(axis=1) * a
    if shares is None:
        slope += a / heat + 1
        bend = np.ones(m)
    else:
        root = np.sqrt(shares * a)
        slope += 0.5 * root / heat
        bend = 0.25 * root / heat
    hessian = np.block(
        [[pairs * np.outer(a, a) + np.diag(bend), (mixed * a).T], [mixed * a, chips]]
    )
    # weights and multipliers differ by many powers of ten: scaled to a diagonal of ones
    size = np.sqrt(np.diag(hessian))
    gradient = np.concatenate([slope, -np.diag(transformed)])
    hessian /= size
    hessian /= size[:, None]
    hessian[np.diag_indices(size.size)] += 1e-12
    step = linalg.solve(
        hessian, gradient / size, assume_a="pos", overwrite_a=True, check_finite=False
    )
    step = np.asarray(step / size, dtype=np.float64)
    return step, float(gradient @ step)


def _pairs(flat: FloatArray, through: FloatArray, rank: int) -> FloatArray:
    """``tr(W G_f W G_g)`` for all pairs, (m, m), a block of rows at a time."""
    m = flat.shape[1] // rank
    out = np.zeros((m, m))
    right = [np.ascontiguousarray(through[:, r::rank]) for r in range(rank)]
    for start in range(0, m, _BLOCK):
        rows = slice(start, start + _BLOCK)
        for first in range(rank):
            factors = flat[:, first::rank][:, rows].T
            for columns in right:
                block = factors @ columns
                block *= block
                out[rows] += block
    return out
