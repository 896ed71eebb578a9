"""Candidates: rounds of changes, of which the best survive, and the errors of their knots."""

import numpy as np
import pytest
import torch

from motdiff.estimators.coded.candidates import (
    CandidatePath,
    Evolution,
    expected_deviation_px,
    motion_of_paths,
)
from motdiff.estimators.coded.misfit import PathQuadratic, Unknowns

UNKNOWNS = Unknowns(3, 1)


def bent(*sizes_px):
    """Candidates that differ by the bend in the middle of their paths."""
    x = torch.zeros(len(sizes_px), UNKNOWNS.size)
    x[:, 2] = torch.tensor(sizes_px)
    return x


def evolved(change, *, rounds=8, patience=2):
    """Candidates, costs, the number of changes, and the shares that were spent."""
    parents, shares = [], []

    def changed(x):
        parents.append(x)
        new = change(x)
        return new, new[:, 2]

    evolution = Evolution(rounds=rounds, patience=patience, improved=0.9, population=3)
    start = bent(90.0, 80.0, 70.0)
    x, costs = evolution.run(UNKNOWNS, start, start[:, 2], changed=changed, spend=shares.append)
    return x, costs, len(parents), shares


def test_the_best_of_parents_and_children_survive():
    x, costs, count, shares = evolved(lambda x: x * 0.5, rounds=1)
    assert costs.tolist() == [35.0, 40.0, 45.0]
    assert x[:, 2].tolist() == costs.tolist()
    assert (count, shares) == (1, [1.0])


@pytest.mark.parametrize("factor", [0.95, 1.5], ids=["a small fall", "no fall"])
def test_it_ends_after_rounds_without_improvement(factor):
    _, costs, count, shares = evolved(lambda x: x * factor)
    assert count == 2
    assert costs[0] <= 70
    assert sum(shares) == pytest.approx(1)


def test_improvement_goes_on_to_the_last_round():
    _, _, count, shares = evolved(lambda x: x * 0.5, rounds=4)
    assert count == len(shares) == 4
    assert sum(shares) == pytest.approx(1)


def test_the_expected_error_of_knots_is_what_their_measurements_leave_about_their_mean():
    sigma_px = np.array([0.1, 0.4, 0.2])  # of each coordinate of each knot
    term = PathQuadratic(UNKNOWNS, np.diag(1 / sigma_px**2))
    draws_px = np.random.default_rng(0).normal(0, sigma_px[:, None], (100_000, 3, 2))
    draws_px -= draws_px.mean(axis=1, keepdims=True)  # a shift of the whole path is no error
    rms_px = np.sqrt((draws_px**2).sum(axis=2).mean(axis=0))
    found_px = expected_deviation_px(UNKNOWNS, [term], bent(0.0))
    assert found_px == pytest.approx(rms_px, rel=0.01)


@pytest.mark.parametrize(
    ("probability", "weights"), [(0.6, [0.6, 0.3, 0.1]), (0.2, [0.2, 0.2, 0.2])]
)
def test_other_paths_share_what_the_best_leaves_and_none_is_likelier(probability, weights):
    paths = [
        CandidatePath(np.array([[0.0, 0.0], [length_px, 1.0]]), 1.0, 1.0, np.zeros(2))
        for length_px in (5.0, 6.0, 7.0)
    ]
    motion = motion_of_paths(
        "coded",
        paths,
        probability=probability,
        shares=[6.0, 2.0],
        deviation_px=np.zeros(2),
        details={},
    )
    assert motion.weights == pytest.approx(np.array(weights) / sum(weights))
