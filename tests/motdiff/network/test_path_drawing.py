"""Paths drawn for kernels: they have the kernel as their PSF, in order, wherever it lies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motdiff.metrics import mnc_subpixel, timed_distance_px
from motdiff.network.path_drawing import DrawnPaths, draw_paths
from motdiff.trajectory import Trajectory
from motdiff.weights import load_path_denoiser


def loop():
    """A path that crosses itself once, slower in the loop."""
    t = np.linspace(0, 1, 401)
    tau = 2 * t - 1
    return Trajectory.from_samples(
        np.stack([9 * tau**3 - 3 * tau, 8 * (1 - tau**2) + 3 * tau], axis=-1), t=t
    )


def bend():
    """A path that bends, and is three times as quick at its end; it crosses itself nowhere."""
    t = np.linspace(0, 1, 401)
    along = (t + t**2) / 2 - 0.4
    return Trajectory.from_samples(np.stack([20 * along, 14 * along**2 + 6 * along**3], -1), t=t)


def timed_px(path, truth):
    return min(timed_distance_px(either, truth) for either in (path, path.reversed()))


@pytest.fixture(scope="module")
def denoiser():
    return load_path_denoiser()


def drawn(denoiser, kernel, *, count=4, seed=0):
    return draw_paths(denoiser, kernel, count=count, rng=np.random.default_rng(seed))


def test_draws_have_the_kernel_as_their_psf(denoiser):
    psf = loop().psf(64)
    draws = drawn(denoiser, psf)
    assert draws.likeness.min() > 0.96
    for number, likeness in enumerate(draws.likeness):
        assert mnc_subpixel(draws.path(number).psf(64), psf) == pytest.approx(likeness, abs=0.015)


def test_a_motion_that_crosses_itself_nowhere_is_drawn_in_order_and_in_time(denoiser):
    order = drawn(denoiser, bend().psf(64), count=8).orders()[0]
    assert order.right > 0.5
    assert timed_px(order.path, bend()) < 0.7  # of 20 px


def test_draws_differ_and_repeat_with_their_seed(denoiser):
    psf = loop().psf(64)
    first, again, other = (drawn(denoiser, psf, count=2, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.coefficients, again.coefficients)
    assert not np.allclose(first.coefficients[0], first.coefficients[1], atol=1e-3)
    assert not np.allclose(first.coefficients, other.coefficients, atol=1e-3)


def test_a_kernel_anywhere_in_its_frame_has_the_same_path_moved(denoiser):
    psf = bend().psf(64)
    middle, aside = (
        drawn(denoiser, kernel).orders()[0].path
        for kernel in (psf, np.roll(psf, (4, -3), axis=(0, 1)))
    )
    moved = Trajectory.from_samples(middle.xy + np.array([-3.0, 4.0]), t=middle.t)
    assert timed_px(aside, moved) < 1


@pytest.mark.parametrize("kernel", [np.ones((1, 1)), np.eye(3), np.ones((9, 9))])
def test_any_kernel_has_a_path(denoiser, kernel):
    draws = drawn(denoiser, kernel, count=1)
    assert np.isfinite(draws.coefficients).all()
    assert 0 < draws.likeness[0] <= 1 + 1e-6


def test_a_kernel_larger_than_the_usual_frame_has_a_path(denoiser):
    line = Trajectory.straight(80.0, angle_rad=0.3)
    draws = drawn(denoiser, line.psf(129), count=2)
    assert draws.likeness.min() > 0.85  # a coarser frame takes it for a path of 150 px
    assert draws.path(0).extent_px == pytest.approx(line.extent_px, rel=0.1)


@pytest.mark.parametrize(
    ("kernel", "count", "message"),
    [
        (np.ones((5, 5)), 0, "count: must be at least 1, got 0"),
        (np.zeros((5, 5)), 1, "kernel: must be finite"),
        (np.full((5, 5), np.nan), 1, "kernel: must be finite"),
        (-np.ones((5, 5)), 1, "kernel: must be finite"),
    ],
)
def test_what_cannot_be_drawn_is_refused(denoiser, kernel, count, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        drawn(denoiser, kernel, count=count)


def several(paths, surprise):
    """Draws of cosine coefficients (64, 2), px, all as alike to the kernel."""
    return DrawnPaths(
        np.array(paths, dtype=float), np.full(len(paths), 0.9), np.array(surprise, dtype=float)
    )


def straight(length_px=10.0, bend_px=0.0):
    coefficients = np.zeros((64, 2))
    coefficients[1] = [length_px, 0]
    coefficients[2] = [0, bend_px]
    return coefficients


def test_draws_that_surprise_less_or_are_more_alike_are_likelier():
    expected, rare = several([straight(), straight(bend_px=30)], [20, 60]).probabilities
    assert expected > rare
    draws = DrawnPaths(np.stack([straight(), straight()]), np.array([0.99, 0.9]), np.zeros(2))
    assert draws.probabilities[0] > 0.5
    assert draws.probabilities.sum() == pytest.approx(1)


def test_draws_of_one_order_are_counted_together_and_shown_by_the_likeliest():
    draws = several(
        [straight(), straight(bend_px=30), straight(10.5), straight(9.7)], [40, 30, 31, 35]
    )
    order, rival = draws.orders()
    expected = draws.probabilities
    assert order.chance == pytest.approx(1 - expected[1])
    assert rival.chance == pytest.approx(expected[1])
    np.testing.assert_allclose(order.path.xy, draws.path(2).xy)
    np.testing.assert_allclose(rival.path.xy, draws.path(1).xy)


def test_a_path_and_its_reverse_are_one_order():
    backwards = straight(bend_px=5) * np.where(np.arange(64) % 2, -1, 1)[:, None]
    draws = several([straight(bend_px=5), backwards], [30, 33])
    assert [order.chance for order in draws.orders()] == pytest.approx([1.0])
    np.testing.assert_allclose(draws.path(1).xy, draws.path(0).xy[::-1], atol=1e-9)


def test_an_order_is_surer_the_less_it_surprises_and_the_fewer_rivals_it_has():
    simple, rare, rivalled = (
        several(paths, surprise).orders()[0].right
        for paths, surprise in (
            ([straight()], [20]),
            ([straight()], [90]),
            ([straight(), straight(bend_px=30)], [20, 21]),
        )
    )
    assert 0 < rare < rivalled < simple < 1


@given(st.lists(st.floats(-40, 40), min_size=1, max_size=9))
def test_chances_of_orders_sum_to_one(bends):
    draws = several([straight(bend_px=bend) for bend in bends], np.full(len(bends), 30))
    chances = [order.chance for order in draws.orders()]
    assert sum(chances) == pytest.approx(1)
    assert chances == sorted(chances, reverse=True)
