"""Relaxed bounds: above (or below) every code by brute force, from any multipliers."""

from dataclasses import replace

import numpy as np
import pytest
from bounded_problems import PROBLEMS, accelerated, all_codes, best_of_all
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.response import ShutterResponse
from cep.search.bounds import bound, gram, largest_forms
from cep.search.problem import SearchProblem
from lab.relaxed_bounds import dual_proofs
from lab.relaxed_bounds.dual_proofs import form_matrix, largest_form, relaxed_bound


@pytest.mark.parametrize("name", PROBLEMS)
def test_no_code_passes_a_relaxed_bound(name, monkeypatch):
    # a mean over the whole band of a curve takes too long here
    monkeypatch.setattr(dual_proofs, "_MOST_FREQUENCIES", 300)
    problem = PROBLEMS[name]
    lowest, noise = best_of_all(problem)
    quick = bound(problem)
    ceiling, proofs = relaxed_bound(replace(problem, objective="min-mtf"))
    assert lowest <= ceiling * (1 + 1e-9) + 1e-12
    assert ceiling <= quick.min_mtf
    assert all(proof.check() for proof in proofs)
    floor, proofs = relaxed_bound(replace(problem, objective="noise"))
    assert noise >= floor >= quick.noise
    assert all(proof.check() for proof in proofs)


def test_through_ramps_the_light_alone_bounds():
    slow = ShutterResponse(chip_ns=1000, rise_ns=600, fall_ns=900)
    problem = SearchProblem.along(accelerated(), chips=7, open_range=(3, 3), response=slow)
    assert relaxed_bound(problem) == (bound(problem).min_mtf, ())


def test_other_objectives_are_refused():
    with pytest.raises(ValueError, match=r"^objective: must be min-mtf or noise, got 'flatness'"):
        relaxed_bound(SearchProblem(chips=5, objective="flatness"))


def test_without_an_optimum_the_quick_bound_stays(monkeypatch):
    def stalled(*_arguments, **_options):
        raise ValueError("relaxation: the steps ended short of the optimum")

    monkeypatch.setattr(dual_proofs, "relax", stalled)
    problem = replace(PROBLEMS["straight, short"], objective="min-mtf")
    assert relaxed_bound(problem) == (bound(problem).min_mtf, ())


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
    _, (proof,) = relaxed_bound(replace(minimum, objective="min-mtf"))
    assert proof.check()
    assert not tampered(proof, bound=0.99 * proof.bound)
    assert not tampered(proof, weights=-proof.weights)
    assert not tampered(proof, weights=0 * proof.weights)
    assert not tampered(proof, multipliers=proof.multipliers[::-1] + 0.1)
    _, (proof,) = relaxed_bound(replace(noise, objective="noise"))
    assert proof.check()
    assert not tampered(proof, bound=proof.bound + 0.05)
    # other frequencies, or weights that the samples do not average exactly, prove nothing about
    # the circle
    assert not tampered(proof, frequencies=0.9 * proof.frequencies)
    rough = proof.weights * (1 + 0.3 * (-1.0) ** np.arange(proof.weights.size))
    assert not tampered(proof, weights=rough, bound=proof.bound - 3)
