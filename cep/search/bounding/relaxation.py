"""Semidefinite relaxation of the search: its value bounds every code, and its solution suggests
codes.

The products ``C = c c'`` of all codes with k ones are relaxed to symmetric ``C >= 0`` with ``tr C
= k`` and ``C 1 = k diag C``, which imply the lifted ``[[1, c'], [c, C]] >= 0`` with ``c = diag
C``. The dual problem is solved,

    maximise ``g(a)`` over a >= 0 and v,  subject to  ``I - sum a_f G_f - (v 1' + 1 v') / 2 + k
    diag v >= 0``,

with ``g = sum a_f`` for the smallest |H|^2 (whose bound is k / g) and ``g = sum sqrt(w_f a_f)``
for the mean of 1/|H|^2 (whose bound is g^2 / k). Newton steps on its logarithmic barrier cost
little, as each G_f has two or four columns, and the barrier's inverse matrix is the relaxed C. The
result of a solver is only used as multipliers of a
:class:`cep.search.bounding.relaxation.DualProof`.

References
----------
Mo and Duarte, "Design of spectrally shaped binary sequences via randomized convex relaxation",
2018: lifting and randomised rounding. Benson, Ye and Zhang, "Solving large-scale sparse
semidefinite programs for combinatorial optimization", SIAM J. Optim. 2000: the dual barrier for
low-rank constraints.

At one frequency ``|H|^2 = c' G_f c`` with the Gram matrix ``G_f = Re conj(B(f)) B(f)'`` of the
chip basis. For weights ``a_f >= 0`` and ``G = sum a_f G_f`` every code c obeys

- ``min |H|^2 <= c' G c / sum a_f``, since a minimum is at most a mean;
- ``mean 1/|H|^2 >= (sum sqrt(w_f a_f))^2 / c' G c`` for quadrature weights w, by Cauchy and
  Schwarz.

A 0/1 code with k ones has ``c_i (sum_j c_j - k) = 0``, so for any v

    ``c' G c = c' A c <= k lambda_max(A)``,   ``A = G + (v 1' + 1 v') / 2 - k diag(v)``.

Nothing is asked of a and v: a bad solver makes the bound loose, never wrong.

References
----------
Lovasz and Schrijver, "Cones of matrices and set-functions and 0-1 optimization", SIAM J. Optim.
1991: multiplying the constraint on the sum by each variable.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cep.optics.band import BandSamples, band_samples, circle_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf
from motdiff.trajectory import Trajectory
from motdiff.types import ComplexArray, FloatArray

Solver = Callable[[FloatArray, int, "FloatArray | None"], "Relaxation"]
_GAP = 1e-4  # relative, where Newton stops; 0.02 dB
_GAP_OF_MEAN = 2e-3
_MOST_STEPS = 150
_COOLING = 0.15
_COOLING_OF_MEAN = 0.1
_BLOCK = 128  # frequencies whose products with all others are held at once
# of a basis, a Gram matrix and its eigenvalues, relative to the largest number that enters
_ROUNDING = 1e-11


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
        If no solver ends as "optimal"; the line has the status of each.
    """
    failures = []
    scale = float((columns**2).sum(axis=(0, 2)).mean())
    for solver in solvers or SOLVERS:
        relaxation = solver(columns / np.sqrt(scale), open_chips, shares)
        finite = (
            np.isfinite(relaxation.weights).all() and np.isfinite(relaxation.multipliers).all()
        )
        if relaxation.status == "optimal" and finite:
            return replace(relaxation, weights=relaxation.weights / scale)
        failures.append(f"{relaxation.solver}: {relaxation.status}")
    raise ValueError(f"relaxation: no solver found an optimum ({'; '.join(failures)})")


def rounded_codes(
    relaxation: Relaxation, count: int, *, rng: np.random.Generator
) -> NDArray[np.int8]:
    """Draw codes (count, n) whose first and second moments resemble the relaxed ones: Gaussian, k
    largest open.

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
    products = np.ones((chips, chips)) - open_chips * np.eye(
        chips
    )  # column i is what chip i's multiplier multiplies

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
        a = shares / _random_power(columns, open_chips) ** 2
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
        if gain < 0.3:
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
        # steps in a are relative
        while (
            merit(a * (1 + length * step[:m]), v + length * step[m:], heat)
            < before + 0.1 * length * gain
        ):
            length *= 0.5
            if length < 1e-9:
                break
        if length < 1e-9:
            break
        a = a * (1 + length * step[:m])
        v = v + length * step[m:]
    return Relaxation(
        open_chips,
        a,
        v,
        np.asarray(inverse * (open_chips / float(np.trace(inverse)))),
        status,
        "newton",
    )


def _random_power(columns: FloatArray, open_chips: int) -> FloatArray:
    """Mean of ``c' G_f c`` over all codes with k ones, (m,), kept away from 0."""
    chips = len(columns)
    pairs = open_chips * (open_chips - 1) / (chips * (chips - 1))
    chip_power = (columns**2).sum(axis=(0, 2))
    all_open = (columns.sum(axis=0) ** 2).sum(axis=1)
    power = (open_chips / chips - pairs) * chip_power + pairs * all_open
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
    size = np.sqrt(np.diag(hessian))
    gradient = np.concatenate([slope, -np.diag(transformed)])
    hessian /= size
    hessian /= size[:, None]
    hessian[np.diag_indices(size.size)] += 1e-12
    step = (
        linalg.solve(
            hessian, gradient / size, assume_a="pos", overwrite_a=True, check_finite=False
        )
        / size
    )
    return np.asarray(step, dtype=np.float64), float(gradient @ step)


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
        nothing = np.full(m, np.nan)
        return Relaxation(open_chips, nothing, np.full(chips, np.nan), np.eye(chips), status, name)
    dual = np.asarray(semidefinite.dual_value, dtype=np.float64)
    products = 0.5 * (dual + dual.T) * (open_chips / float(np.trace(dual)))
    return Relaxation(
        open_chips, np.maximum(a.value, 0.0), np.asarray(v.value), products, status, name
    )


def _clarabel(
    columns: FloatArray, open_chips: int, shares: FloatArray | None = None
) -> Relaxation:
    return cvxpy_solver(columns, open_chips, shares, name="CLARABEL")


def _scs(columns: FloatArray, open_chips: int, shares: FloatArray | None = None) -> Relaxation:
    return cvxpy_solver(columns, open_chips, shares, name="SCS")


SOLVERS: tuple[Solver, ...] = (newton_solver, _clarabel, _scs)


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
    both : tuple of bool
        For each motion, whether both directions count: ``G_f`` is then the mean of both.
    edges : tuple of (n + 1,) float or None
        For each motion, its chips' edges as fractions of the exposure, where they are not evenly
        spread.
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
    both: tuple[bool, ...]
    edges: tuple[FloatArray | None, ...]
    motion: NDArray[np.intp]
    frequencies: FloatArray
    weights: FloatArray
    multipliers: FloatArray
    bound: float

    def check(self) -> bool:
        """Whether the bound holds, recomputed from the motions: other code for the basis, Cholesky
        for the eigenvalue.

        A matrix whose Cholesky factor exists in floating point is positive definite up to
        rounding, which the bound has room for.
        """
        k = self.open_chips
        n = self.chips
        if not ((self.weights >= 0).all() and self.weights.any()):
            return False
        if any(
            reversible and edges is not None
            for reversible, edges in zip(self.both, self.edges, strict=True)
        ):
            return False  # the reversed path is no mirror image then
        total = np.zeros((n, n))
        for index, (motion, reversible, edges) in enumerate(
            zip(self.motions, self.both, self.edges, strict=True)
        ):
            of_motion = self.motion == index
            basis = _basis_again(motion, n, self.frequencies[of_motion], edges) * np.sqrt(
                self.weights[of_motion]
            )
            gram = basis.real @ basis.real.T + basis.imag @ basis.imag.T
            total += 0.5 * (gram + gram[::-1, ::-1]) if reversible else gram
        if self.quantity == "min":
            allowed = self.bound**2 * float(self.weights.sum()) / k
        else:
            allowed = self._power_of_means() / (10 ** (self.bound / 10) * k)
        test = allowed * np.eye(n) - form_matrix(total, self.multipliers, k)
        try:
            np.linalg.cholesky(test)
        except np.linalg.LinAlgError:
            return False
        return True

    def _power_of_means(self) -> float:
        """``(sum sqrt(w a))^2``, where the frequencies are the quadrature of the one motion; 0
        where they are not.
        """
        (motion,) = self.motions
        samples = circle_grid(self.chips) if motion is None else band_samples(motion)
        if not np.array_equal(np.stack([samples.fx, samples.fy], axis=1), self.frequencies):
            return 0.0
        if motion is None:
            ratio = np.sqrt(self.weights / samples.weight)
            if np.abs(circle_average(ratio, self.chips) - ratio).max() > 1e-11 * ratio.max():
                return 0.0
        return float(np.sqrt(samples.weight * self.weights).sum()) ** 2


def gram(basis: ComplexArray, weights: FloatArray) -> FloatArray:
    """``sum_f a_f Re conj(B_f) B_f'``, (n, n), of an (n, F) basis."""
    root = basis * np.sqrt(weights)
    return np.asarray(root.real @ root.real.T + root.imag @ root.imag.T, dtype=np.float64)


def form_matrix(matrix: FloatArray, multipliers: FloatArray, open_chips: int) -> FloatArray:
    """Add terms that vanish on codes: ``A = G + (v 1' + 1 v') / 2 - k diag(v)``."""
    return matrix + 0.5 * (multipliers[:, None] + multipliers) - open_chips * np.diag(multipliers)


def largest_form(matrix: FloatArray, multipliers: FloatArray, open_chips: int) -> float:
    """Upper bound of ``c' G c`` over 0/1 codes with k ones, from any multipliers v (n,)."""
    form = form_matrix(matrix, multipliers, open_chips)
    scale = float(np.linalg.norm(matrix) + np.linalg.norm(form))
    return open_chips * float(np.linalg.eigvalsh(form)[-1] + _ROUNDING * scale)


def largest_forms(matrix: FloatArray, counts: NDArray[np.intp]) -> FloatArray:
    """Upper bounds of ``c' G c`` for each number of ones, (K,), with the best equal multipliers
    ``v = x 1``.

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
    for _ in range(4):
        with np.errstate(divide="ignore", invalid="ignore"):
            x = 1 / (ones / (multipliers[..., None] - values)).sum(axis=-1)
            # below the top eigenvalue only a negative x keeps lambda the largest
            valid = np.isfinite(x) & ((multipliers > top) | ((x < 0) & (multipliers > second)))
            forms = (
                multipliers
                - x * counts
                + _ROUNDING * (np.abs(multipliers) + np.abs(x) * (counts + values.size) + abs(top))
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
    best = np.minimum(best, top + _ROUNDING * abs(top) * values.size)
    all_open = float(matrix.sum()) / values.size + _ROUNDING * float(np.abs(matrix).sum())
    return np.asarray(counts * np.where(counts == values.size, all_open, best), dtype=np.float64)


def circle_grid(chips: int) -> BandSamples:
    """Sample the unit circle for averages that :func:`circle_average` makes exact."""
    return circle_samples(chips, oversampling=16 if chips <= 256 else 8)


def circle_average(values: FloatArray, chips: int) -> FloatArray:
    """Cut an even function on the circle's samples to a trigonometric polynomial, (F,), not
    negative, of low degree.

    Its square times any |P|^2 is then averaged without error by the samples; so a bound of mean
    1/|P|^2 from it holds for the mean over the whole circle, and on every finer grid.
    """
    lags = np.fft.irfft(values)
    degree = (lags.size - chips) // 2 - 1
    lags[degree + 1 : lags.size - degree] = 0
    cut = np.fft.rfft(lags).real
    return np.asarray(cut - 1.000001 * min(float(cut.min()), 0.0), dtype=np.float64)


def _basis_again(
    motion: Trajectory | None, chips: int, frequencies: FloatArray, edges: FloatArray | None
) -> ComplexArray:
    if motion is None:
        return np.asarray(
            np.exp(-2j * np.pi * np.outer(np.arange(chips), frequencies[:, 0])) / chips
        )
    single = [ShutterCode("0" * chip + "1" + "0" * (chips - chip - 1)) for chip in range(chips)]
    return np.stack(
        [
            coded_otf(motion, code, frequencies[:, 0], frequencies[:, 1], edges=edges)
            for code in single
        ]
    )
