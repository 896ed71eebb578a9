"""Bounds: above (or below) every code by brute force, from any multipliers, whatever a solver
says."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.band import band_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis
from cep.optics.response import ShutterResponse
from cep.proofs.certify.minimum import min_chip
from cep.proofs.measure import measure
from cep.search.bounding import relaxation
from cep.search.bounding.bounds import bound, relaxed_minimum
from cep.search.bounding.dual_proofs import tightened
from cep.search.bounding.motion_basis import (
    circle_average,
    form_matrix,
    gram,
    largest_form,
    largest_forms,
)
from cep.search.bounding.quick_bounds import chip_ceilings
from cep.search.bounding.relaxation import (
    Relaxation,
    cvxpy_solver,
    newton_solver,
    relax,
    rounded_codes,
)
from cep.search.problem import SearchProblem
from cep.search.scenarios import Scenario
from motdiff.trajectory import Trajectory

BOTH_GOALS = (("min-mtf", 1.0), ("noise", 1.0))


def arc(length_px=6.0, samples=16):
    angle = np.linspace(0, 2.2, samples) ** 1.4
    return Trajectory.from_samples(
        length_px / 3 * np.stack([np.cos(angle), np.sin(1.7 * angle)], 1)
    )


def accelerated(length_px=9.0, samples=12):
    x = length_px * np.linspace(0, 1, samples) ** 2
    return Trajectory.from_samples(np.stack([x, 0.5 * x], 1))


def all_codes(chips, counts):
    chosen = [pick for k in counts for pick in combinations(range(chips), k)]
    codes = np.zeros((len(chosen), chips))
    for row, pick in zip(codes, chosen, strict=True):
        row[list(pick)] = 1
    return codes


def best_of_all(problem):
    """Largest smallest |H| on the continuum and least noise over all codes, worst scenario and
    direction."""
    low, high = problem.open_limits
    codes = all_codes(problem.chips, range(low, high + 1))
    paths = [(s.trajectory, s.edges) for s in problem.scenarios]
    paths += [(path.reversed(), edges) for path, edges in paths if problem.both_directions(path)]
    lowest = np.full(len(codes), np.inf)
    noise = np.full(len(codes), -np.inf)
    for path, edges in paths or [(None, None)]:
        if path is None:
            size = 512 * problem.chips
            power = np.abs(np.fft.rfft(codes, size)) ** 2 / problem.chips**2
            weight = np.full(size // 2 + 1, 2 / size)
            weight[[0, -1]] /= 2
        else:
            samples = band_samples(path)
            weight = samples.weight
            power = (
                np.abs(
                    codes @ chip_basis(path, problem.chips, samples.fx, samples.fy, edges=edges)
                )
                ** 2
            )
        lowest = np.minimum(lowest, np.sqrt(power.min(axis=1)))
        noise = np.maximum(noise, 10 * np.log10(1 / np.maximum(power, 1e-30) @ weight))
    best = 0.0
    for index in np.argsort(-lowest):
        if lowest[index] <= best:
            break
        # the continuum only lowers what the samples say
        code = ShutterCode.from_array(codes[index])
        exact = (
            problem.measure(code, budget=0).min_mtf if paths else min_chip(code) / problem.chips
        )
        best = max(best, exact)
    return best, noise.min()


PROBLEMS = {
    "circle": SearchProblem(chips=10, open_range=(5, 5), objective=BOTH_GOALS),
    "circle dark": SearchProblem(chips=11, open_range=(3, 3), objective=BOTH_GOALS),
    "circle free": SearchProblem(chips=9, objective=BOTH_GOALS),
    "straight": SearchProblem.along(
        Trajectory.straight(9.0), chips=8, open_range=(3, 5), objective=BOTH_GOALS
    ),
    "straight, short": SearchProblem.along(
        Trajectory.straight(2.0), chips=8, open_range=(4, 4), objective=BOTH_GOALS
    ),
    "straight, long": SearchProblem.along(
        Trajectory.straight(11.0, angle_rad=0.6), chips=8, open_range=(5, 5), objective=BOTH_GOALS
    ),
    "accelerated, known": SearchProblem.along(
        accelerated(), chips=8, open_range=(4, 4), direction="forward", objective=BOTH_GOALS
    ),
    "accelerated, unknown": SearchProblem.along(
        accelerated(), chips=8, objective=BOTH_GOALS, direction="unknown"
    ),
    "curved, known": SearchProblem.along(
        arc(), chips=8, open_range=(4, 4), direction="forward", objective=BOTH_GOALS
    ),
    "curved, unknown": SearchProblem.along(
        arc(), chips=6, objective=BOTH_GOALS, direction="unknown"
    ),
    "late chips": SearchProblem(
        chips=7,
        open_range=(3, 4),
        scenarios=(Scenario(accelerated(5.0), edges=np.linspace(0, 1, 8) ** 1.2 * 1.1),),
        direction="unknown",
        objective=BOTH_GOALS,
    ),
    "two motions": SearchProblem(
        chips=7,
        open_range=(3, 5),
        scenarios=(Scenario(accelerated(6.0)), Scenario(Trajectory.straight(4.0))),
        objective=BOTH_GOALS,
    ),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_no_code_passes_a_bound(name, monkeypatch):
    problem = PROBLEMS[name]
    # a mean over the whole band of a curve takes too long here
    monkeypatch.setattr("cep.search.bounding.dual_proofs._MOST_FREQUENCIES", 300)
    lowest, noise = best_of_all(problem)
    quick, deep = (bound(problem, effort=effort) for effort in ("quick", "sdp"))
    for found in (quick, deep):
        assert lowest <= found.min_mtf * (1 + 1e-9) + 1e-12
        assert noise >= found.noise
        assert found.min_mtf <= 1.5 * problem.open_limits[1] / problem.chips
        assert set(found.method) == {"min_mtf", "min_chip", "noise"}
        assert all(proof.check() for proof in found.proofs)
    assert deep.min_mtf <= quick.min_mtf
    assert deep.noise >= quick.noise
    assert deep.min_chip == quick.min_chip


def test_relaxed_noise_along_a_curve_holds_and_pays():
    """Few frequencies instead of the full band: the same proof on a coarser quadrature."""
    path = arc()
    n = 8
    k = 4
    axis = np.linspace(-0.5, 0.5, 11)
    fx, fy = (grid.ravel() for grid in np.meshgrid(axis, axis))
    basis = chip_basis(path, n, fx, fy)
    weight = np.full(fx.size, 1 / fx.size)
    found = relax(np.stack([basis.real, basis.imag], 2), k, shares=weight)
    floor = np.sqrt(weight * found.weights).sum() ** 2 / largest_form(
        gram(basis, found.weights), found.multipliers, k
    )
    truth = (1 / np.abs(all_codes(n, [k]) @ basis) ** 2 @ weight).min()
    jensen = 1 / largest_forms(gram(basis, weight), np.array([k]))[0]
    assert jensen < floor <= truth


@given(
    st.integers(2, 40).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, n))),
    st.integers(0, 99),
)
@settings(deadline=None)  # the counts in classes are tabulated at the first use
def test_closed_forms_hold_for_random_codes(size, seed):
    chips, k = size
    bits = np.zeros(chips)
    bits[np.random.default_rng(seed).permutation(chips)[:k]] = 1
    reached = min_chip(ShutterCode.from_array(bits))
    for values in chip_ceilings(chips, np.array([k])).values():
        assert reached <= values[0] + 1e-9


def test_known_minima_and_theorem():
    """Barker-13 (k = 9) has 1.362373; the first code above 2 has 39 chips, so 38 are bounded by 2
    and 39 are not."""
    barker = SearchProblem(chips=13, open_range=(9, 9))
    assert 1.362373 <= bound(barker).min_chip <= 2
    assert bound(SearchProblem(chips=38)).min_chip == 2
    assert bound(SearchProblem(chips=38)).method["min_chip"] == "degree-38"
    assert bound(SearchProblem(chips=39)).min_chip > 2.018
    assert bound(SearchProblem(chips=52, open_range=(26, 26))).min_chip == pytest.approx(
        np.sqrt(26 * 26 / 51)
    )
    assert bound(SearchProblem(chips=1)).min_chip == 1
    # 4 of 8: the counts of even and odd places alone say more than Parseval
    assert bound(SearchProblem(chips=8, open_range=(4, 4))).method["min_chip"] == "roots-of-unity"


def test_relaxation_cannot_beat_the_random_code_on_the_circle():
    """The mean of c c' over all codes is a feasible C whose smallest tr(G C) is k (n - k) / (n -
    1)."""
    n = 14
    k = 6
    grid = np.arange(0, 4 * n + 1) / (8 * n)
    basis = np.exp(-2j * np.pi * np.outer(np.arange(n), grid))
    found = relax(np.stack([basis.real, basis.imag], 2), k)
    assert k / found.weights.sum() == pytest.approx(k * (n - k) / (n - 1), rel=1e-3)


@given(st.integers(0, 10_000), st.integers(2, 9), st.floats(-3, 3), st.data())
@settings(max_examples=60, deadline=None)
def test_any_multipliers_bound_every_code(seed, chips, size, data):
    """The heart of it: weights and multipliers drawn at random never prove a falsehood."""
    k = data.draw(st.integers(1, chips))
    rng = np.random.default_rng(seed)
    basis = rng.normal(size=(chips, 12)) + 1j * rng.normal(size=(chips, 12))
    weights = rng.exponential(size=12) * (rng.random(12) < 0.6)
    matrix = gram(basis, weights)
    v = 10**size * rng.normal(size=chips)
    codes = all_codes(chips, [k])
    power = np.abs(codes @ basis) ** 2
    forms = power @ weights
    assert np.allclose(
        np.einsum("ri,ij,rj->r", codes, form_matrix(matrix, v, k), codes),
        forms,
        atol=1e-9 * 10**size,
    )
    assert forms.max() <= largest_form(matrix, v, k)
    assert forms.max() <= largest_forms(matrix, np.array([k]))[0] * (1 + 1e-9) + 1e-12
    if weights.any():
        assert power.min(axis=1).max() <= largest_form(matrix, v, k) / weights.sum()
        shares = rng.dirichlet(np.ones(12))
        floor = np.sqrt(shares * weights).sum() ** 2 / largest_form(matrix, v, k)
        assert (1 / power @ shares).min() >= floor * (1 - 1e-9)


@given(st.integers(0, 1000), st.integers(2, 20), st.integers(1, 20))
@settings(max_examples=25, deadline=None)
def test_equal_multipliers_are_the_best_equal_ones(seed, chips, k):
    rng = np.random.default_rng(seed)
    k = min(k, chips)
    basis = rng.normal(size=(chips, 30)) + 1j * rng.normal(size=(chips, 30)) + 3 * rng.normal()
    matrix = gram(basis, np.full(30, 1 / 30))
    tried = np.concatenate([[0.0], np.logspace(-4, 3, 60), -np.logspace(-4, 2, 40)])
    best = min(largest_form(matrix, x * np.ones(chips), k) for x in tried)
    assert largest_forms(matrix, np.array([k]))[0] <= best * (1 + 1e-6)


def tampered(proof, **changes):
    return replace(proof, **changes).check()


def test_a_proof_is_checked_not_believed():
    minimum = PROBLEMS["straight, short"]
    noise = PROBLEMS["circle"]
    (proof,) = bound(replace(minimum, objective="min-mtf"), effort="sdp").proofs
    assert proof.check()
    assert not tampered(proof, bound=0.99 * proof.bound)
    assert not tampered(proof, weights=-proof.weights)
    assert not tampered(proof, weights=0 * proof.weights)
    assert not tampered(proof, multipliers=proof.multipliers[::-1] + 0.1)
    (proof,) = bound(replace(noise, objective="noise"), effort="sdp").proofs
    assert proof.check()
    assert not tampered(proof, bound=proof.bound + 0.05)
    # other frequencies, or weights that the samples do not average exactly, prove nothing about
    # the circle
    assert not tampered(proof, frequencies=0.9 * proof.frequencies)
    rough = proof.weights * (1 + 0.3 * (-1.0) ** np.arange(proof.weights.size))
    assert not tampered(proof, weights=rough, bound=proof.bound - 3)


def test_circle_average_keeps_what_a_finer_grid_sees():
    n = 7
    size = 64
    kept = circle_average(np.abs(np.sin(np.arange(size // 2 + 1))), n)
    lags = np.fft.irfft(kept)
    assert kept.min() >= 0
    assert np.abs(lags[(size - n) // 2 : size // 2]).max() < 1e-12


@pytest.mark.parametrize("shares", [None, np.full(30, 1 / 30)])
def test_newton_agrees_with_clarabel(shares):
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(9, 30, 2))
    ours = newton_solver(columns, 4, shares)
    theirs = cvxpy_solver(columns, 4, shares, name="CLARABEL")
    goal = [
        found.weights.sum() if shares is None else np.sqrt(shares * found.weights).sum()
        for found in (ours, theirs)
    ]
    assert ours.status == theirs.status == "optimal"
    assert goal[0] == pytest.approx(goal[1], rel=3e-3)
    assert goal[0] <= goal[1] * (1 + 1e-6)
    for found in (ours, theirs):
        assert np.trace(found.products) == pytest.approx(4)
        assert np.linalg.eigvalsh(found.products)[0] > -1e-6
    assert np.abs(theirs.products.sum(1) - 4 * np.diag(theirs.products)).max() < 1e-4


def saying(status, calls, *, nan=False):
    def solver(columns, open_chips, shares):
        calls.append(status)
        m = columns.shape[1]
        chips = len(columns)
        weights = np.full(m, np.nan if nan else 1e-9)
        return Relaxation(open_chips, weights, np.zeros(chips), np.eye(chips), status, status)

    return solver


def test_only_optimal_counts():
    columns = np.random.default_rng(0).normal(size=(6, 20, 2))
    calls = []
    found = relax(columns, 3, solvers=[saying("optimal_inaccurate", calls), newton_solver])
    assert (found.solver, calls) == ("newton", ["optimal_inaccurate"])
    assert (
        relax(columns, 3, solvers=[saying("optimal", calls, nan=True), newton_solver]).solver
        == "newton"
    )
    with pytest.raises(
        ValueError, match=r"relaxation: no solver.*infeasible: infeasible; user_limit: user_limit"
    ):
        relax(columns, 3, solvers=[saying("infeasible", []), saying("user_limit", [])])


def test_without_a_solver_the_quick_bound_stays(monkeypatch):
    problem = PROBLEMS["straight, short"]
    monkeypatch.setattr(relaxation, "SOLVERS", (saying("stalled", []),))
    deep = bound(problem, effort="sdp")
    quick = bound(problem)
    assert (deep.min_mtf, deep.noise, deep.method, deep.proofs) == (
        quick.min_mtf,
        quick.noise,
        quick.method,
        (),
    )


def test_a_lying_solver_only_loosens():
    from cep.search.bounding.bounds import _motions

    problem = PROBLEMS["accelerated, known"]
    counts = np.array([4])
    known = np.array([np.inf])
    lowest, _ = best_of_all(problem)
    rng = np.random.default_rng(0)

    def liar(columns, open_chips, shares):
        chips, m, _ = columns.shape
        weights = rng.exponential(size=m)
        v = rng.normal(size=chips)
        return Relaxation(open_chips, weights, v, np.eye(chips), "optimal", "liar")

    parts = _motions(problem)[0]
    values, (proof,) = tightened(parts, counts, known, "min", solvers=[liar])
    assert lowest <= values[0]
    assert proof.check()
    honest, _ = tightened(parts, counts, known, "min")
    assert honest[0] < values[0]


def test_rounded_codes_have_the_light_and_do_better_than_chance():
    problem = SearchProblem.along(accelerated(), chips=16, open_range=(8, 8), direction="forward")
    found = relaxed_minimum(problem, 8)
    codes = rounded_codes(found, 200, rng=np.random.default_rng(0))
    assert codes.shape == (200, 16)
    assert codes.dtype == np.int8
    assert (codes.sum(axis=1) == 8).all()
    assert np.array_equal(codes, rounded_codes(found, 200, rng=np.random.default_rng(0)))
    drawn = problem.random_codes(200, rng=np.random.default_rng(1))

    def typical(some):
        return np.median(
            [measure(accelerated(), ShutterCode.from_array(c), budget=0).min_mtf for c in some]
        )

    assert typical(codes) > typical(drawn)


def test_a_shutter_with_ramps_is_bounded_by_its_light():
    slow = ShutterResponse(chip_ns=1000, rise_ns=600, fall_ns=900)
    problem = SearchProblem.along(
        accelerated(), chips=7, open_range=(3, 3), direction="forward", response=slow
    )
    metrics = [
        problem.measure(ShutterCode.from_array(code), budget=0) for code in all_codes(7, [3])
    ]
    for effort in ("quick", "sdp"):
        found = bound(problem, effort=effort)
        assert max(m.min_mtf for m in metrics) <= found.min_mtf
        assert min(m.noise_gain_db for m in metrics) >= found.noise
        assert found.method["min_mtf"] == found.method["noise"] == "light"
    with pytest.raises(ValueError, match=r"response: .*follows at once"):
        relaxed_minimum(problem, 3)


@pytest.mark.parametrize("opened", [1, 3, 6, 7])
def test_every_pulse_has_one_tail(opened):
    lingering = ShutterResponse(chip_ns=1000, on_bias_ns=300, fall_ns=400)
    problem = SearchProblem.along(
        Trajectory.straight(3.0),
        chips=7,
        open_range=(opened, opened),
        response=lingering,
        objective="noise",
    )
    most = lingering.open_time(all_codes(7, [opened])).max()
    assert bound(problem).noise == pytest.approx(-20 * np.log10(most), abs=1e-9)


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match='effort: must be "quick" or "sdp"'):
        bound(SearchProblem(chips=5), effort="deep")
    with pytest.raises(ValueError, match=r"open_chips: must be within 2..4"):
        relaxed_minimum(SearchProblem(chips=5), 5)
