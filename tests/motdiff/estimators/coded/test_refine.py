"""A path that is roughly known, refined by photos of its motion; the kernels of the photos are
given."""

import numpy as np
import pytest

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.refine import refined_paths
from motdiff.estimators.coded.starts import orders
from motdiff.metrics import timed_distance_px
from motdiff.trajectory import Trajectory

CODES = ("1010000111000001010000110011110111010111001001100111", "1" * 26 + "0" * 26)


def loop_path() -> Trajectory:
    """A figure of eight, open at one end: four orders draw its PSF."""
    turn = np.linspace(-0.3 * np.pi, 1.3 * np.pi, 200)
    return Trajectory.from_samples(np.stack([8 * np.sin(turn), 5 * np.sin(2 * turn)], axis=1))


class Given:
    """Hands out kernels that are known, one a photo; none where the input is to be refused."""

    def __init__(self, kernels=()) -> None:
        self.kernels = list(kernels)

    def estimate(self, photo: np.ndarray) -> MotionEstimate:
        return MotionEstimate("given", (Trajectory.straight(9),), (1.0,), self.kernels.pop(0), 0.9)


def bent(path: Trajectory, error: float) -> Trajectory:
    """The path with a smooth error of so many px rms."""
    t = np.linspace(0, 1, 201)
    wave = np.stack([np.sin(2 * np.pi * t), np.cos(3 * np.pi * t + 0.4)], axis=1)
    wave -= wave.mean(axis=0)
    wave *= error / np.sqrt((wave**2).sum(axis=1).mean())
    return Trajectory.from_samples(path.at(t) + wave, t=t, direction=path.direction)


@pytest.fixture(scope="module")
def taken(shots):
    return shots(loop_path(), CODES, read_sigma=0.005)


def refined(taken, paths, photos=2, **options):
    kernels = Given([psf / psf.sum() for psf in taken.psfs[:photos]])
    return refined_paths(
        paths, taken.photos[:photos], taken.codes[:photos], kernels=kernels, **options
    )


@pytest.mark.parametrize("error", [0.5, 1.5])
def test_two_photos_take_most_of_the_error_away(taken, error) -> None:
    found = refined(taken, [bent(loop_path(), error)])[0]
    assert timed_distance_px(found.trajectory, loop_path()) < 0.25 * error
    assert found.misfit < 1.1 < found.given_misfit
    assert found.deviation_px < 0.3


def test_the_true_path_stays_where_it_is(taken) -> None:
    found = refined(taken, [loop_path()])[0]
    assert timed_distance_px(found.trajectory, loop_path()) < 0.15
    assert found.given_misfit - found.misfit < 0.05


def test_one_photo_and_an_exact_kernel(taken) -> None:
    given = bent(loop_path(), 0.8)
    found = refined(taken, [given], photos=1)
    assert min(timed_distance_px(one.trajectory, loop_path()) for one in found) < 0.4
    assert all(np.isnan(one.misfit) and one.values == 0 for one in found)


@pytest.mark.slow(reason="fits from four orders")
def test_of_all_orders_the_true_one_is_first(taken) -> None:
    given = [
        Trajectory.from_samples(xy) for xy in orders(bent(loop_path(), 0.5), knots=201, count=24)
    ]
    assert len(given) == 4
    found = refined(taken, given[1:] + given[:1])
    assert timed_distance_px(found[0].trajectory, loop_path()) < 0.2
    assert found[0].cost < found[1].cost


def test_the_prior_holds_the_path(taken) -> None:
    """With a small expected error no photo moves it far."""
    given = bent(loop_path(), 1.0)
    found = refined(taken, [given], photos=1, deviation_px=0.02)[0]
    assert timed_distance_px(found.trajectory, given) < 0.1


def test_what_lies_between_the_knots_stays(taken) -> None:
    t = np.linspace(0, 1, 400)
    ripple = 0.2 * np.sin(2 * np.pi * 52 * t)[:, None]  # it is 0 at every knot
    given = Trajectory.from_samples(loop_path().at(t) + ripple, t=t)
    moved = refined(taken, [given])[0].trajectory
    smooth = refined(taken, [Trajectory.from_samples(loop_path().at(t), t=t)])[0].trajectory
    left = moved.at(t) - smooth.at(t)
    assert np.corrcoef((left - left.mean(axis=0))[:, 0], ripple[:, 0])[0, 1] > 0.9


@pytest.mark.parametrize("deviation", [0.0, -1.0, float("nan")])
def test_an_error_of_nothing_is_refused(deviation) -> None:
    with pytest.raises(ValueError, match=r"^deviation_px: must be above 0"):
        refined_paths([loop_path()], [], CODES, deviation_px=deviation)


def test_photos_of_different_sizes_are_refused() -> None:
    photos = [np.random.default_rng(0).random(shape) for shape in ((96, 80), (96, 90))]
    with pytest.raises(ValueError, match=r"^photo 2: has 90 x 96 px, the first one 80 x 96"):
        refined_paths([loop_path()], photos, CODES, kernels=Given())
