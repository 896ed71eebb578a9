"""The reference estimator on simulated pairs, generated and bundled scenes."""

import json

import numpy as np
import pytest
from scipy import ndimage
from skimage import data

from motdiff.estimators.reference.estimator import (
    ReferenceEstimator,
    coarse_shift,
    high_passed,
)
from motdiff.metrics import mnc_subpixel
from motdiff.motions import boracchi_foi, quadratic
from motdiff.photo_values import to_linear
from motdiff.simulate import blur_valid, photograph

SIGMA = 0.01


def dead_leaves(seed: int, shape: tuple[int, int] = (260, 280)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = np.full(shape, 0.5)
    y, x = np.mgrid[: shape[0], : shape[1]]
    for _ in range(400):
        radius = 4 / rng.random() ** 0.7
        inside = (y - rng.uniform(0, shape[0])) ** 2 + (x - rng.uniform(0, shape[1])) ** 2 < min(
            radius, 60
        ) ** 2
        image[inside] = rng.uniform(0.05, 0.85)
    return image


def taken(
    scene: np.ndarray, psf: np.ndarray, seed: int, shift: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Photo and misregistered sharp photo, both noisy."""
    rng = np.random.default_rng(seed)
    moved = ndimage.shift(scene, (*shift, 0)[: scene.ndim], order=5, mode="reflect")
    sharp = np.clip(moved + SIGMA * rng.standard_normal(scene.shape), 0, 1)
    return photograph(scene, psf, rng=rng, read_sigma=SIGMA), sharp


@pytest.mark.parametrize("seed", range(3))
def test_misregistered_noisy_pair(seed: int) -> None:
    psf = boracchi_foi(np.random.default_rng(seed)).psf(49)
    angle = 2.1 * seed + 0.4
    photo, sharp = taken(dead_leaves(seed), psf, seed, (1.5 * np.sin(angle), 1.5 * np.cos(angle)))
    estimate = ReferenceEstimator(sharp).estimate(photo)
    assert mnc_subpixel(estimate.psf, psf) >= 0.95
    assert estimate.psf.shape == (64, 64)
    assert estimate.psf.min() >= 0
    assert estimate.psf.sum() == pytest.approx(1)
    at = np.arange(64) - 32
    assert np.hypot(at @ estimate.psf.sum(axis=0), at @ estimate.psf.sum(axis=1)) < 0.2
    assert estimate.confidence > 0.9
    assert estimate.trajectories[0].direction == "unknown"
    assert mnc_subpixel(estimate.trajectories[0].psf(96), psf) > 0.8
    assert estimate.details["gain"] == pytest.approx(1, abs=0.08)
    assert estimate.details["noise_sigma"] == pytest.approx(SIGMA, rel=0.15)
    json.dumps(estimate.details, allow_nan=False)


def test_colour_photo_far_misregistered_with_gain_and_offset() -> None:
    scene = to_linear(data.astronaut()[:360, :400] / 255)
    psf = quadratic(np.random.default_rng(1), min_length_px=20, max_length_px=20).psf(41)
    photo, sharp = taken(scene, psf, 0, (13.3, -8.6))
    estimate = ReferenceEstimator(sharp, crop_count=2).estimate(0.7 * photo + 0.1)
    assert mnc_subpixel(estimate.psf, psf) >= 0.95
    assert estimate.details["gain"] == pytest.approx(0.7, abs=0.06)
    # the photo lacks 20 px at its top and left; the scene moved by the shift
    assert estimate.details["shift_px"] == pytest.approx([-8.6 * -1 - 20, -13.3 - 20], abs=0.5)


def test_clipped_lamps_are_left_out() -> None:
    scene = 0.6 * dead_leaves(5)
    rng = np.random.default_rng(0)
    for row, column in rng.integers(60, 200, (4, 2)):
        scene[row : row + 3, column : column + 3] = 20.0
    psf = boracchi_foi(rng, max_length_px=35).psf(41)
    photo = photograph(scene, psf, rng=rng, read_sigma=SIGMA)
    sharp = np.clip(scene + SIGMA * rng.standard_normal(scene.shape), 0, 1)
    estimate = ReferenceEstimator(sharp, size=48).estimate(photo)
    assert mnc_subpixel(estimate.psf, psf) >= 0.97  # 0.93 when their light counts
    assert estimate.details["left_out_share"] > 0.01


def test_another_scene_is_told_apart() -> None:
    psf = boracchi_foi(np.random.default_rng(0)).psf(49)
    photo, _ = taken(dead_leaves(0), psf, 0, (0, 0))
    estimate = ReferenceEstimator(dead_leaves(1)).estimate(photo)
    assert estimate.confidence < 0.3
    assert any("explains only" in warning for warning in estimate.warnings)


def test_blur_that_differs_across_the_photo_is_told() -> None:
    scene = np.hstack([dead_leaves(0), dead_leaves(1)])
    one, two = (
        boracchi_foi(np.random.default_rng(seed), max_length_px=40).psf(41) for seed in (0, 3)
    )
    half = scene.shape[1] // 2 - 20
    photo = np.hstack([blur_valid(scene, one)[:, :half], blur_valid(scene, two)[:, half:]])
    photo = photo + SIGMA * np.random.default_rng(0).standard_normal(photo.shape)
    estimate = ReferenceEstimator(scene, size=48, crop_px=128).estimate(photo)
    assert mnc_subpixel(one, two) < 0.7
    assert any("differs across the photo" in warning for warning in estimate.warnings)
    same = ReferenceEstimator(scene, size=48, crop_px=128).estimate(blur_valid(scene, one))
    assert not any("differs" in warning for warning in same.warnings)


def test_path_longer_than_the_frame_is_told() -> None:
    psf = quadratic(np.random.default_rng(0), min_length_px=40, max_length_px=40).psf(51)
    photo, sharp = taken(dead_leaves(2), psf, 0, (0, 0))
    estimate = ReferenceEstimator(sharp, size=16).estimate(photo)
    assert (
        any("larger size" in warning for warning in estimate.warnings) or estimate.confidence < 0.6
    )


@pytest.mark.parametrize(
    ("sharp", "photo", "said"),
    [
        (np.full((200, 200), 0.5), dead_leaves(0), "sharp: has no texture"),
        (dead_leaves(0), np.zeros((200, 200)), "photo: has no texture"),
        (dead_leaves(0), np.full((200, 200), np.nan), "photo: must be finite"),
        (dead_leaves(0), np.zeros((1, 1)), "photo: 1 x 1 px is too small"),
        (dead_leaves(0)[:80, :80], dead_leaves(0)[:80, :80], "sharp: overlaps the photo"),
    ],
)
def test_photos_that_cannot_be_compared(sharp: np.ndarray, photo: np.ndarray, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        ReferenceEstimator(sharp).estimate(photo)


def test_bad_construction() -> None:
    with pytest.raises(ValueError, match="photo"):
        ReferenceEstimator(np.zeros(3))
    with pytest.raises(ValueError, match="size"):
        ReferenceEstimator(np.zeros((50, 50)), size=1)


# -- registration to whole pixels -----------------------------------------------------------------


def scene(shape: tuple[int, int]) -> np.ndarray:
    return ndimage.gaussian_filter(np.random.default_rng(0).random(shape), 2.0)


@pytest.mark.parametrize("shape", [(200, 240), (1500, 1600)])
@pytest.mark.parametrize(("dy", "dx"), [(0, 0), (17, -30), (-41, 8)])
def test_crops_of_one_scene(shape: tuple[int, int], dy: int, dx: int) -> None:
    whole = scene(shape)
    sharp = whole[50:-10, 50:-50]
    blurred = whole[50 - dy : shape[0] - 50 - dy, 50 - dx : shape[1] - 50 - dx]
    assert coarse_shift(sharp, blurred) == (dy, dx)
    assert coarse_shift(sharp, 0.3 * blurred + 0.5) == (dy, dx)
    assert coarse_shift(blurred, sharp) == (-dy, -dx)


def test_high_pass_takes_offset_and_slope_away() -> None:
    ramp = np.add.outer(np.arange(80.0), 2 * np.arange(90.0))
    assert np.abs(high_passed(ramp + 7)[20:-20, 20:-20]).max() < 1e-9
