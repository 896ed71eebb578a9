"""Figures of several draws: known values, and the share of true draws that the rule must cover."""

import numpy as np
import pytest

from lab.evaluation.draws import measure_draws
from lab.evaluation.floors import gaussian
from motdiff.trajectory import Trajectory


def line(degrees, length=24.0):
    angle = np.deg2rad(degrees)
    return Trajectory.from_samples([[0, 0], [length * np.cos(angle), length * np.sin(angle)]]).psf(
        64
    )


def test_one_guess_drawn_eight_times_covers_nothing_but_itself():
    guess = line(20.0)
    same = measure_draws([guess] * 8, guess)
    assert (same.best, same.alike) == pytest.approx((1, 1))
    assert same.covered
    other = measure_draws([guess] * 8, line(35.0))
    assert other.alike == pytest.approx(1)
    assert other.best < 0.8
    assert not other.covered


def test_the_best_draw_is_the_nearest_one():
    truth = line(50.0)
    found = measure_draws([line(0.0), line(48.0), gaussian(4.0)], truth)
    assert found.best == pytest.approx(measure_draws([line(48.0)] * 2, truth).best)
    assert found.best > 0.9
    assert (
        found.covered
    )  # every draw is farther from its nearest than the truth from the second one


@pytest.mark.parametrize(("spread", "low", "high"), [(1.0, 0.72, 0.92), (0.1, 0.0, 0.55)])
def test_draws_of_the_right_distribution_cover_k_of_k_plus_1(spread, low, high):
    """Truth and four draws from one distribution: 4 of 5 are covered; fewer where the draws are
    too alike."""
    rng = np.random.default_rng(0)
    covered = [
        measure_draws(
            [line(90 + spread * a) for a in rng.uniform(-60, 60, 4)],
            line(90 + rng.uniform(-60, 60)),
        ).covered
        for _ in range(100)
    ]
    assert low < np.mean(covered) < high


def test_one_draw_is_refused():
    with pytest.raises(ValueError, match=r"^draws: must be at least 2, got 1"):
        measure_draws([line(0.0)], line(0.0))
