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
    barrier = _Barrier(columns / np.sqrt(scale), open_chips, shares)
    gap, cooling = (_GAP, _COOLING) if shares is None else (_GAP_OF_MEAN, _COOLING_OF_MEAN)
    a = barrier.start()
    v = np.zeros(barrier.chips)
    heat = barrier.goal(a) / barrier.walls
    for _ in range(_MOST_STEPS):
        inverse = np.linalg.inv(barrier.slack(a, v))
        inverse = 0.5 * (inverse + inverse.T)
        step, gain = barrier.newton_step(inverse, a, heat)
        if gain < _SMALL_GAIN:
            if heat * barrier.walls < gap * barrier.goal(a):
                relaxed = np.asarray(inverse * (open_chips / float(np.trace(inverse))))
                return Relaxation(a / scale, v, relaxed)
            heat *= cooling
            continue
        relative, dv = np.split(step, [a.size])
        length = 1.0
        if relative.min() < -0.9:
            length = min(1.0, 0.9 / float(-relative.min()))
        before = barrier.merit(a, v, heat)
        while length >= 1e-9:
            # steps in a are relative, so that one scale suits large and small weights
            further = (a * (1 + length * relative), v + length * dv)
            if barrier.merit(*further, heat) >= before + 0.1 * length * gain:  # Armijo's rule
                break
            length *= 0.5
        else:
            break
        a, v = further
    raise ValueError("relaxation: the steps ended short of the optimum")


class _Barrier:
    """Logarithmic barrier of the dual problem.

    Parameters
    ----------
    columns, open_chips, shares
        As of :func:`relax`.
    """

    def __init__(self, columns: FloatArray, open_chips: int, shares: FloatArray | None) -> None:
        self.chips, self.m, self.rank = columns.shape
        self.columns = columns
        self.flat = columns.reshape(self.chips, self.m * self.rank)
        self.open_chips = open_chips
        self.shares = shares
        # column i is what chip i's multiplier multiplies
        self.products = np.ones((self.chips, self.chips)) - open_chips * np.eye(self.chips)
        # a mean's goal, a root, is infinitely steep at 0: it keeps a above 0 by itself
        self.walls = self.chips + (self.m if shares is None else 0)

    def gram(self, a: FloatArray) -> FloatArray:
        """``sum a_f G_f``, (n, n)."""
        return np.asarray((self.flat * np.repeat(a, self.rank)) @ self.flat.T)

    def slack(self, a: FloatArray, v: FloatArray) -> FloatArray:
        """Matrix of the constraint, positive definite within it."""
        return np.asarray(
            np.eye(self.chips)
            - self.gram(a)
            - 0.5 * (v[:, None] + v)
            + self.open_chips * np.diag(v)
        )

    def goal(self, a: FloatArray) -> float:
        """Value of g."""
        if self.shares is None:
            return float(a.sum())
        return float(np.sqrt(self.shares * a).sum())

    def merit(self, a: FloatArray, v: FloatArray, heat: float) -> float:
        """Value of the goal and the barrier; -inf outside."""
        try:
            factor = np.linalg.cholesky(self.slack(a, v))
        except np.linalg.LinAlgError:
            return -np.inf
        wall = 0.0
        if self.shares is None:
            wall = float(np.log(a).sum())
        return self.goal(a) / heat + 2 * float(np.log(np.diag(factor)).sum()) + wall

    def start(self) -> FloatArray:
        """Weights well inside the constraint, with v = 0."""
        a = np.ones(self.m)
        if self.shares is not None:
            # for 1/x the best weights are w / x^2: start from x of a random code
            chip_power = (self.columns**2).sum(axis=(0, 2))
            all_open = (self.columns.sum(axis=0) ** 2).sum(axis=1)
            a = self.shares / mean_power(chip_power, all_open, self.chips, self.open_chips) ** 2
        # half of what the semidefinite limit allows
        a *= 0.5 / float(np.linalg.eigvalsh(self.gram(a))[-1])
        return a

    def newton_step(
        self, inverse: FloatArray, a: FloatArray, heat: float
    ) -> tuple[FloatArray, float]:
        """Newton's step in (da / a, dv), and its gain by the quadratic model.

        ``inverse`` is that of the slack.
        """
        through = inverse @ self.flat
        pairs = _pairs(self.flat, through, self.rank)
        mixed = (through * (self.products @ through)).reshape(self.chips, self.m, self.rank)
        mixed = mixed.sum(axis=2)
        transformed = inverse @ self.products
        chips = 0.5 * (inverse * (self.products @ transformed) + transformed * transformed.T)
        forms = (self.flat * through).sum(axis=0).reshape(self.m, self.rank).sum(axis=1)
        slope = -forms * a
        if self.shares is None:
            slope += a / heat + 1
            bend = np.ones(self.m)
        else:
            root = np.sqrt(self.shares * a)
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
