"""The relaxation: its value by closed forms and brute force, its solution by the duality gap."""

import numpy as np
import pytest
from bounded_problems import all_codes, arc

from cep.optics.exposure import chip_basis
from cep.search.bounds import gram, largest_forms
from lab.relaxed_bounds.dual_proofs import largest_form
from lab.relaxed_bounds.relaxation import relax


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


def test_relaxation_cannot_beat_the_random_code_on_the_circle():
    """The mean of c c' over all codes is a feasible C whose smallest tr(G C) is k (n - k) / (n -
    1)."""
    n = 14
    k = 6
    grid = np.arange(0, 4 * n + 1) / (8 * n)
    basis = np.exp(-2j * np.pi * np.outer(np.arange(n), grid))
    found = relax(np.stack([basis.real, basis.imag], 2), k)
    assert k / found.weights.sum() == pytest.approx(k * (n - k) / (n - 1), rel=1e-3)


@pytest.mark.parametrize(
    ("shares", "optimum"), [(None, 0.86936710), (np.full(30, 1 / 30), 0.73102327)]
)
def test_the_steps_reach_the_optimum_of_clarabel(shares, optimum):
    """The goal's optimum as Clarabel 0.11 found it, an interior-point solver."""
    relaxation = relax(np.random.default_rng(3).normal(size=(9, 30, 2)), 4, shares=shares)
    goal = relaxation.weights.sum()
    if shares is not None:
        goal = np.sqrt(shares * relaxation.weights).sum()
    assert optimum * (1 - 3e-3) <= goal <= optimum * (1 + 1e-6)
    assert np.trace(relaxation.products) == pytest.approx(4)
    assert np.linalg.eigvalsh(relaxation.products)[0] > -1e-6
