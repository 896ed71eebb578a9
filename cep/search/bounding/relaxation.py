"""Semidefinite relaxation of the search: its value bounds all codes, its solution suggests some.

The products ``C = c c'`` of all codes with k ones are relaxed to symmetric ``C >= 0`` with ``tr C
= k`` and ``C 1 = k diag C``, which imply the lifted ``[[1, c'], [c, C]] >= 0`` with ``c = diag
C``. The dual problem is solved,

    maximise ``g(a)`` over a >= 0 and v,  subject to  ``I - sum a_f G_f - (v 1' + 1 v') / 2 + k
    diag v >= 0``,

with ``g = sum a_f`` for the smallest |H|^2 (whose bound is k / g) and ``g = sum sqrt(w_f a_f)``
for the mean of 1/|H|^2 (whose bound is g^2 / k). Newton steps on its logarithmic barrier cost
little, as each G_f has two or four columns, and the barrier's inverse matrix is the relaxed C. The
result of a solver is only used as multipliers of a
:class:`cep.search.bounding.dual_proofs.DualProof`.

References
----------
Mo and Duarte, "Design of spectrally shaped binary sequences via randomized convex relaxation",
2018: lifting and randomised rounding. Benson, Ye and Zhang, "Solving large-scale sparse
semidefinite programs for combinatorial optimization", SIAM J. Optim. 2000: the dual barrier for
low-rank constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cep.search.bounding.motion_basis import mean_power
from motdiff.types import FloatArray

Solver = Callable[[FloatArray, int, "FloatArray | None"], "Relaxation"]
_GAP = 1e-4  # relative, where Newton stops; 0.0004 dB of the bound, which holds at any gap
_GAP_OF_MEAN = 2e-3  # the same of a mean, whose steps are the dearer ones; 0.02 dB
_MOST_STEPS = 150  # after which the next solver is tried
_COOLING = 0.15  # of the barrier's heat once a step gains little
_COOLING_OF_MEAN = 0.1
_SMALL_GAIN = 0.3  # of a step by the quadratic model: below it the path's centre is near enough
_BLOCK = 128  # frequencies whose products with all others are held at once


@dataclass(frozen=True)
class Relaxation:
    """Solution of the relaxation on some frequencies.

    Attributes
    ----------
    open_chips : int
    weights : (m,) float
        a of the dual problem.
    multipliers : (n,) float
        v of the dual problem.
    products : (n, n) float
        C, trace ``open_chips``.
    status : str
        "optimal", or another status of the solver.
    solver : str
    """

    open_chips: int
    weights: FloatArray
    multipliers: FloatArray
    products: FloatArray
    status: str
    solver: str


def relax(
    columns: FloatArray,
    open_chips: int,
    *,
    shares: FloatArray | None = None,
    solvers: Sequence[Solver] | None = None,
) -> Relaxation:
    """Solve the relaxation, by the first solver that ends as exactly "optimal".

    Parameters
    ----------
    columns : (n, m, r) float
        ``G_f = sum_r columns[:, f, r] columns[:, f, r]'``, of any common scale.
    open_chips : int
        k, 1 < k < n.
    shares : (m,) float, optional
        Quadrature weights: bound the mean of 1/|H|^2. Without them, the smallest |H|.
    solvers : sequence of callables, optional
        Newton's, then Clarabel and SCS.

    Raises
    ------
    ValueError
        If no solver ends as "optimal"; the line has the status of each.
    """
    failures = []
    # solvers' tolerances suit matrices with entries of about 1
    scale = float((columns**2).sum(axis=(0, 2)).mean())
    for solver in solvers or SOLVERS:
        relaxation = solver(columns / np.sqrt(scale), open_chips, shares)
        finite = np.isfinite([*relaxation.weights, *relaxation.multipliers]).all()
        if relaxation.status == "optimal" and finite:
            return replace(relaxation, weights=relaxation.weights / scale)
        failures.append(f"{relaxation.solver}: {relaxation.status}")
    raise ValueError(f"relaxation: no solver found an optimum ({'; '.join(failures)})")


def rounded_codes(
    relaxation: Relaxation, count: int, *, rng: np.random.Generator
) -> NDArray[np.int8]:
    """Draw codes (count, n) whose first and second moments resemble the relaxed ones.

    The k largest of a Gaussian vector with these moments are open.

    References
    ----------
    Goemans and Williamson, "Improved approximation algorithms for maximum cut", JACM 1995.
    """
    mean = np.diag(relaxation.products)
    values, vectors = np.linalg.eigh(relaxation.products - np.outer(mean, mean))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    samples = mean + rng.standard_normal((count, mean.size)) @ root.T
    codes = np.zeros((count, mean.size), dtype=np.int8)
    np.put_along_axis(codes, np.argsort(-samples, axis=1)[:, : relaxation.open_chips], 1, axis=1)
    return codes


def newton_solver(
    columns: FloatArray, open_chips: int, shares: FloatArray | None = None
) -> Relaxation:
    """Follow the barrier's central path by damped Newton steps."""
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
    status = "stalled"
    for _ in range(_MOST_STEPS):
        inverse = np.linalg.inv(slack(a, v))
        inverse = 0.5 * (inverse + inverse.T)
        step, gain = _newton_step(flat, rank, inverse, products, a, shares, heat)
        if gain < _SMALL_GAIN:
            if heat * walls < gap * goal(a):
                status = "optimal"
                break
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
    products = np.asarray(inverse * (open_chips / float(np.trace(inverse))))
    return Relaxation(open_chips, a, v, products, status, "newton")


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


def cvxpy_solver(
    columns: FloatArray, open_chips: int, shares: FloatArray | None = None, *, name: str
) -> Relaxation:
    """Solve the same problem with one of cvxpy's solvers."""
    import cvxpy

    chips, m, _ = columns.shape
    a = cvxpy.Variable(m, nonneg=True)
    v = cvxpy.Variable(chips)
    forms = np.einsum("ifr,jfr->ijf", columns, columns).reshape(chips * chips, m)
    ones = np.ones((1, chips))
    spread = cvxpy.reshape(v, (chips, 1), order="C") @ ones
    gram = cvxpy.reshape(forms @ a, (chips, chips), order="C")
    semidefinite = (
        np.eye(chips) - gram - 0.5 * (spread + spread.T) + open_chips * cvxpy.diag(v) >> 0
    )
    goal = cvxpy.sum(a) if shares is None else np.sqrt(shares) @ cvxpy.sqrt(a)
    problem = cvxpy.Problem(cvxpy.Maximize(goal), [semidefinite])
    try:
        problem.solve(solver=name)
        status = str(problem.status)
    except cvxpy.error.SolverError:
        status = "failed"
    if a.value is None or v.value is None or semidefinite.dual_value is None:
        # relax() refuses what is not finite, whatever the status
        weights, multipliers = np.full(m, np.nan), np.full(chips, np.nan)
        return Relaxation(open_chips, weights, multipliers, np.eye(chips), status, name)
    dual = np.asarray(semidefinite.dual_value, dtype=np.float64)
    products = 0.5 * (dual + dual.T) * (open_chips / float(np.trace(dual)))
    weights = np.maximum(a.value, 0.0)
    return Relaxation(open_chips, weights, np.asarray(v.value), products, status, name)


# 0.04 s by Newton's, 0.3 to 1 s by the others: docs/decisions/proofs.md
SOLVERS: tuple[Solver, ...] = (
    newton_solver,
    partial(cvxpy_solver, name="CLARABEL"),
    partial(cvxpy_solver, name="SCS"),
)
