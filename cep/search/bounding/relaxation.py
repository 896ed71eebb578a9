r"""A semidefinite relaxation of the search: its value bounds every code, and its solution suggests codes.

The products ``C = c c'`` of all codes with k ones are relaxed to symmetric ``C >= 0`` with ``tr C = k`` and
``C 1 = k diag C``, which imply the lifted ``[[1, c'], [c, C]] >= 0`` with ``c = diag C``. The dual problem is solved,

    maximise ``g(a)`` over a >= 0 and v,  subject to  ``I - sum a_f G_f - (v 1' + 1 v') / 2 + k diag v >= 0``,

with ``g = sum a_f`` for the smallest |H|^2 (whose bound is k / g) and ``g = sum sqrt(w_f a_f)`` for the mean of
1/|H|^2 (whose bound is g^2 / k). Newton steps on its logarithmic barrier cost little, as each G_f has two or four
columns, and the barrier's inverse matrix is the relaxed C. What a solver returns is only ever used as multipliers of a
:class:`cep.search.bounding.dual.DualProof`.

References
----------
Mo and Duarte, "Design of spectrally shaped binary sequences via randomized convex relaxation", 2018: lifting and
randomised rounding. Benson, Ye and Zhang, "Solving large-scale sparse semidefinite programs for combinatorial
optimization", SIAM J. Optim. 2000: the dual barrier for low-rank constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

__all__ = ["SOLVERS", "Relaxation", "cvxpy_solver", "newton_solver", "relax", "rounded_codes"]

FloatArray = NDArray[np.float64]
Solver = Callable[[FloatArray, int, "FloatArray | None"], "Relaxation"]
_GAP, _GAP_OF_MEAN = 1e-4, 2e-3  # relative, where Newton stops; 0.02 dB
_MOST_STEPS = 150
_COOLING, _COOLING_OF_MEAN = 0.15, 0.1
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
        "optimal", or what the solver said instead.
    solver : str
    """

    open_chips: int
    weights: FloatArray
    multipliers: FloatArray
    products: FloatArray
    status: str
    solver: str


def relax(
    columns: FloatArray, open_chips: int, *, shares: FloatArray | None = None, solvers: Sequence[Solver] | None = None
) -> Relaxation:
    """Solve the relaxation; the next solver is tried where one does not end as exactly "optimal".

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
        If no solver ends as "optimal"; the line says what each said.
    """
    said = []
    scale = float((columns**2).sum(axis=(0, 2)).mean())
    for solver in solvers or SOLVERS:
        found = solver(columns / np.sqrt(scale), open_chips, shares)
        finite = np.isfinite(found.weights).all() and np.isfinite(found.multipliers).all()
        if found.status == "optimal" and finite:
            return replace(found, weights=found.weights / scale)
        said.append(f"{found.solver}: {found.status}")
    raise ValueError(f"relaxation: no solver found an optimum ({'; '.join(said)})")


def rounded_codes(relaxation: Relaxation, count: int, *, rng: np.random.Generator) -> NDArray[np.int8]:
    """Draw codes (count, n) whose first and second moments resemble the relaxed ones: Gaussian, k largest open.

    References
    ----------
    Goemans and Williamson, "Improved approximation algorithms for maximum cut", JACM 1995.
    """
    mean = np.diag(relaxation.products)
    values, vectors = np.linalg.eigh(relaxation.products - np.outer(mean, mean))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = mean + rng.standard_normal((count, mean.size)) @ root.T
    codes = np.zeros((count, mean.size), dtype=np.int8)
    np.put_along_axis(codes, np.argsort(-drawn, axis=1)[:, : relaxation.open_chips], 1, axis=1)
    return codes


def newton_solver(columns: FloatArray, open_chips: int, shares: FloatArray | None = None) -> Relaxation:
    """Follow the barrier's central path by damped Newton steps."""
    chips, m, rank = columns.shape
    flat = columns.reshape(chips, m * rank)
    products = np.ones((chips, chips)) - open_chips * np.eye(chips)  # column i is what chip i's multiplier multiplies

    def slack(a: FloatArray, v: FloatArray) -> FloatArray:
        used = (flat * np.repeat(a, rank)) @ flat.T
        return np.asarray(np.eye(chips) - used - 0.5 * (v[:, None] + v) + open_chips * np.diag(v))

    def goal(a: FloatArray) -> float:
        return float(a.sum() if shares is None else np.sqrt(shares * a).sum())

    def merit(a: FloatArray, v: FloatArray, heat: float) -> float:
        try:
            factor = np.linalg.cholesky(slack(a, v))
        except np.linalg.LinAlgError:
            return -np.inf
        wall = 0.0 if shares is not None else float(np.log(a).sum())
        return goal(a) / heat + 2 * float(np.log(np.diag(factor)).sum()) + wall

    # for 1/x the best weights are w / x^2: start from x of a random code
    a = np.ones(m) if shares is None else shares / _random_power(columns, open_chips) ** 2
    a *= 0.5 / float(np.linalg.eigvalsh((flat * np.repeat(a, rank)) @ flat.T)[-1])
    v = np.zeros(chips)
    gap, cooling = (_GAP, _COOLING) if shares is None else (_GAP_OF_MEAN, _COOLING_OF_MEAN)
    walls = chips + (m if shares is None else 0)
    heat = goal(a) / walls
    status = "stalled"
    for _ in range(_MOST_STEPS):
        inverse = np.linalg.inv(slack(a, v))
        inverse = 0.5 * (inverse + inverse.T)
        step, gain = _newton_step(flat, rank, inverse, products, a, shares, heat)
        if gain < 0.3:
            if heat * walls < gap * goal(a):
                status = "optimal"
                break
            heat *= cooling
            continue
        down = step[:m] < 0
        length = min(1.0, 0.9 / float(-step[:m][down].min())) if down.any() and step[:m].min() < -0.9 else 1.0
        before = merit(a, v, heat)
        # steps in a are relative
        while merit(a * (1 + length * step[:m]), v + length * step[m:], heat) < before + 0.1 * length * gain:
            length *= 0.5
            if length < 1e-9:
                break
        if length < 1e-9:
            break
        a, v = a * (1 + length * step[:m]), v + length * step[m:]
    return Relaxation(open_chips, a, v, np.asarray(inverse * (open_chips / float(np.trace(inverse)))), status, "newton")


def _random_power(columns: FloatArray, open_chips: int) -> FloatArray:
    """Mean of ``c' G_f c`` over all codes with k ones, (m,), kept away from 0."""
    chips = len(columns)
    pairs = open_chips * (open_chips - 1) / (chips * (chips - 1))
    own, all_open = (columns**2).sum(axis=(0, 2)), (columns.sum(axis=0) ** 2).sum(axis=1)
    power = (open_chips / chips - pairs) * own + pairs * all_open
    return np.asarray(np.maximum(power, 1e-4 * power.mean()), dtype=np.float64)


def _newton_step(
    flat: FloatArray,
    rank: int,
    inverse: FloatArray,
    products: FloatArray,
    a: FloatArray,
    shares: FloatArray | None,
    heat: float,
) -> tuple[FloatArray, float]:
    """Newton's step in (da / a, dv), and by how much the quadratic model says that it pays."""
    m = a.size
    through = inverse @ flat
    pairs = _pairs(flat, through, rank)
    mixed = (through * (products @ through)).reshape(len(inverse), m, rank).sum(axis=2)
    turned = inverse @ products
    chips = 0.5 * (inverse * (products @ turned) + turned * turned.T)
    slope = -(flat * through).sum(axis=0).reshape(m, rank).sum(axis=1) * a
    if shares is None:
        slope += a / heat + 1
        bend = np.ones(m)
    else:
        root = np.sqrt(shares * a)
        slope += 0.5 * root / heat
        bend = 0.25 * root / heat
    hessian = np.block([[pairs * np.outer(a, a) + np.diag(bend), (mixed * a).T], [mixed * a, chips]])
    size = np.sqrt(np.diag(hessian))
    gradient = np.concatenate([slope, -np.diag(turned)])
    hessian /= size
    hessian /= size[:, None]
    hessian[np.diag_indices(size.size)] += 1e-12
    step = linalg.solve(hessian, gradient / size, assume_a="pos", overwrite_a=True, check_finite=False) / size
    return np.asarray(step, dtype=np.float64), float(gradient @ step)


def _pairs(flat: FloatArray, through: FloatArray, rank: int) -> FloatArray:
    """``tr(W G_f W G_g)`` for all pairs, (m, m), a block of rows at a time."""
    m = flat.shape[1] // rank
    out = np.zeros((m, m))
    right = [np.ascontiguousarray(through[:, r::rank]) for r in range(rank)]
    for start in range(0, m, _BLOCK):
        rows = slice(start, start + _BLOCK)
        for first in range(rank):
            left = flat[:, first::rank][:, rows].T
            for columns in right:
                block = left @ columns
                block *= block
                out[rows] += block
    return out


def cvxpy_solver(columns: FloatArray, open_chips: int, shares: FloatArray | None = None, *, name: str) -> Relaxation:
    """Solve the same problem with one of cvxpy's solvers."""
    import cvxpy

    chips, m, _ = columns.shape
    a, v = cvxpy.Variable(m, nonneg=True), cvxpy.Variable(chips)
    forms = np.einsum("ifr,jfr->ijf", columns, columns).reshape(chips * chips, m)
    ones = np.ones((1, chips))
    spread = cvxpy.reshape(v, (chips, 1), order="C") @ ones
    used = cvxpy.reshape(forms @ a, (chips, chips), order="C")
    semidefinite = np.eye(chips) - used - 0.5 * (spread + spread.T) + open_chips * cvxpy.diag(v) >> 0
    goal = cvxpy.sum(a) if shares is None else np.sqrt(shares) @ cvxpy.sqrt(a)
    problem = cvxpy.Problem(cvxpy.Maximize(goal), [semidefinite])
    try:
        problem.solve(solver=name)
        status = str(problem.status)
    except cvxpy.error.SolverError:
        status = "failed"
    if a.value is None or v.value is None or semidefinite.dual_value is None:
        nothing = np.full(m, np.nan)
        return Relaxation(open_chips, nothing, np.full(chips, np.nan), np.eye(chips), status, name)
    dual = np.asarray(semidefinite.dual_value, dtype=np.float64)
    products = 0.5 * (dual + dual.T) * (open_chips / float(np.trace(dual)))
    return Relaxation(open_chips, np.maximum(a.value, 0.0), np.asarray(v.value), products, status, name)


def _clarabel(columns: FloatArray, open_chips: int, shares: FloatArray | None = None) -> Relaxation:
    return cvxpy_solver(columns, open_chips, shares, name="CLARABEL")


def _scs(columns: FloatArray, open_chips: int, shares: FloatArray | None = None) -> Relaxation:
    return cvxpy_solver(columns, open_chips, shares, name="SCS")


SOLVERS: tuple[Solver, ...] = (newton_solver, _clarabel, _scs)
