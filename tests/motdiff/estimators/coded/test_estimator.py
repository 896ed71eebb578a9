"""The estimator: what it refuses, and order and direction of a path with a loop, from kernels that
are given."""

import re
from collections.abc import Sequence

import numpy as np
import pytest

from motdiff.estimators.base import Estimator, MotionEstimate
from motdiff.estimators.coded.candidates import UNEXPLAINED
from motdiff.estimators.coded.estimator import CodedEstimator
from motdiff.trajectory import Trajectory

OPEN = "1" * 52
FIRST_HALF = "1" * 26 + "0" * 26
RNG = np.random.default_rng(0)
TEXTURE = RNG.random((96, 80))
SLOW = pytest.mark.slow  # a search for the path from all its starts: 5 to 15 s


def loop_path() -> Trajectory:
    """A figure of eight, open at one end: four orders draw its PSF."""
    turn = np.linspace(-0.3 * np.pi, 1.3 * np.pi, 200)
    return Trajectory.from_samples(np.stack([8 * np.sin(turn), 5 * np.sin(2 * turn)], axis=1))


class Given:
    """Hands out kernels that are known, one a photo."""

    def __init__(self, kernels: Sequence[np.ndarray]) -> None:
        self.kernels = list(kernels)

    def estimate(self, photo: np.ndarray) -> MotionEstimate:
        return MotionEstimate("given", (Trajectory.straight(9),), (1.0,), self.kernels.pop(0), 0.9)


class Forbidden:
    def estimate(self, photo: np.ndarray) -> MotionEstimate:
        raise AssertionError("searched although the input is refused")


def error_px(a: Trajectory, b: Trajectory) -> float:
    """Rms distance at equal times, after the best shift."""
    t = np.linspace(0, 1, 401)
    apart = a.at(t) - b.at(t)
    return float(np.sqrt(((apart - apart.mean(axis=0)) ** 2).sum(axis=1).mean()))


def estimate(taken, photos=None, **options) -> MotionEstimate:
    kernels: Estimator = Given(taken.psfs)
    return CodedEstimator(taken.codes, kernels=kernels, **options).estimate_from(
        photos or taken.photos
    )


# -- refusals -------------------------------------------------------------------------------------


def test_codes_that_tell_no_order_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^code: order cannot be known"):
        CodedEstimator(["1111", "1111"])


@pytest.mark.parametrize(
    ("photos", "message"),
    [
        ([TEXTURE], "code: needs one for each photo, got 2 for 1 photos"),
        ([], "code: needs one for each photo, got 2 for 0 photos"),
        ([TEXTURE] * 3, "code: needs one for each photo, got 2 for 3 photos"),
        ([TEXTURE, TEXTURE[:, :70]], "photo 2: has 70 x 96 px, the first one 80 x 96"),
        ([TEXTURE, np.full_like(TEXTURE, 0.5)], "photo 2: is constant"),
        ([TEXTURE[:20, :20], TEXTURE], "photo 1: "),
        ([TEXTURE, np.full_like(TEXTURE, np.nan)], "photo 2: must be finite"),
        ([TEXTURE, TEXTURE[None, None]], "photo 2: must be (H, W)"),
    ],
)
def test_photos_that_do_not_fit_are_refused(photos: list[np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}") as refusal:
        CodedEstimator([OPEN, FIRST_HALF], kernels=Forbidden()).estimate_from(photos)
    assert "\n" not in str(refusal.value)


def test_one_photo_needs_one_code() -> None:
    with pytest.raises(ValueError, match=r"^code: needs one for each photo"):
        CodedEstimator([OPEN, FIRST_HALF], kernels=Forbidden()).estimate(TEXTURE)


def test_a_lone_photo_needs_no_number() -> None:
    with pytest.raises(ValueError, match=r"^photo: is constant"):
        CodedEstimator([FIRST_HALF], kernels=Forbidden()).estimate(np.zeros_like(TEXTURE))


# -- from given kernels ---------------------------------------------------------------------------


@SLOW
def test_order_and_direction_are_found(shots, gray_codes) -> None:
    """Whatever the photos' brightness, shifts and order."""
    path = loop_path().reversed()  # the other way than in the test below
    codes = gray_codes(52, 2)
    told = []
    taken = shots(
        path,
        (codes[0], OPEN, codes[1]),  # the brightest is not the first
        side_px=144,
        shifts_px=[(1.5, -1.0), (0.0, 0.0), (-2.0, 0.6)],
        gains=[0.7, 1.0, 1.3],
    )
    found = estimate(taken, progress=told.append)
    assert error_px(found.best, path) < 0.3
    assert error_px(found.best.reversed(), path) > 3
    assert {one.direction for one in found.trajectories} == {"known"}
    assert found.psf.sum() == pytest.approx(1)
    assert found.details["order_confidence"] == found.confidence
    assert 0.02 < found.details["path_uncertainty_px"] < 0.5
    assert found.details["misfit"] == pytest.approx(1, abs=0.25)
    assert len(found.details["kernel_confidences"]) == 3
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1)


@SLOW
def test_kernels_of_different_scenes_tell_the_order(shots, gray_codes) -> None:
    path = loop_path()
    taken = shots(path, (OPEN, *gray_codes(52, 2)), side_px=144)
    # a photo that shows another scene, whose blur is nevertheless the kernel given for it
    photos = [taken.photos[0], taken.photos[1][::-1], taken.photos[2]]
    found = estimate(taken, photos)
    assert error_px(found.best, path) < 0.3
    assert any("different scenes" in warning for warning in found.warnings)
    assert found.details["misfit"] is None


class AtRest:
    """Finds no motion blur in any photo."""

    def estimate(self, photo: np.ndarray) -> MotionEstimate:
        path = Trajectory.from_samples([[0.0, 0.0], [0.0, 0.0]])
        return MotionEstimate(
            "pmp", (path,), (1.0,), path.psf(64), 0.9, ("sharp",), {"motion_blur": False}
        )


def test_photos_without_motion_blur_have_no_path(shots) -> None:
    taken = shots(loop_path(), (OPEN, FIRST_HALF), side_px=144)
    found = CodedEstimator(taken.codes, kernels=AtRest()).estimate_from(taken.photos)
    assert found.best.length_px == 0
    assert found.details["motion_blur"] is False
    assert found.path_error_px is None
    assert found.warnings == ("The photos show no motion blur",)


@SLOW
def test_a_path_lost_in_its_error_is_doubted(shots, short_search) -> None:
    taken = shots(Trajectory.straight(0.05), (OPEN, FIRST_HALF), side_px=144)
    found = estimate(taken)
    assert found.confidence <= 0.3
    assert any("may not have moved" in warning for warning in found.warnings)


@SLOW
def test_the_seed_alone_decides(shots) -> None:
    # one photo, whose kernel leaves many paths: the quickest search
    taken = shots(loop_path(), (FIRST_HALF,), side_px=144)
    first, again, other = (estimate(taken, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.best.xy, again.best.xy)
    assert first.weights == again.weights
    assert first.confidence == again.confidence
    assert np.abs(first.best.xy - other.best.xy).max() > 0


@SLOW
def test_photos_of_another_motion_are_doubted(shots, gray_codes, short_search) -> None:
    path = loop_path()
    codes = (OPEN, *gray_codes(52, 2))
    taken = shots(path, codes, side_px=144)
    other = shots(Trajectory.from_samples(1.5 * path.xy[:, ::-1]), codes, side_px=144)
    mixed = type(taken)(
        codes, (*taken.psfs[:2], other.psfs[2]), (*taken.photos[:2], other.photos[2])
    )
    found = estimate(mixed)
    assert found.details["misfit"] > UNEXPLAINED
    assert any("unexplained" in warning for warning in found.warnings)
