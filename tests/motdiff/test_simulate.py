"""Simulated photos: brute-force convolution, noise statistics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from motdiff.simulate import (
    add_noise,
    blur_symmetric,
    blur_valid,
    border_px,
    photograph,
    valid_window,
    visible,
)
from motdiff.trajectory import Trajectory


@given(
    seed=st.integers(0, 1000),
    rows=st.integers(1, 9),
    columns=st.integers(1, 9),
    colour=st.booleans(),
)
@settings(max_examples=40, deadline=None)
def test_blur_valid_is_true_convolution(seed: int, rows: int, columns: int, colour: bool) -> None:
    rng = np.random.default_rng(seed)
    image = rng.random((14, 17, 3) if colour else (14, 17))
    psf = rng.random((rows, columns))
    blurred = blur_valid(image, psf)
    channels = image[..., None] if image.ndim == 2 else image
    direct = np.stack(
        [
            signal.convolve(c, psf, mode="valid", method="direct")
            for c in np.moveaxis(channels, 2, 0)
        ],
        2,
    )
    np.testing.assert_allclose(blurred.reshape(direct.shape), direct, atol=1e-12)
    assert image[valid_window(image.shape, psf.shape)].shape == blurred.shape


@pytest.mark.parametrize("size", [7, 8])
def test_a_point_draws_the_psf_where_the_point_is(size: int) -> None:
    psf = np.random.default_rng(0).random((size, size))
    image = np.zeros((40, 41))
    image[20, 22] = 1
    blurred = np.zeros_like(image)
    blurred[valid_window(image.shape, psf.shape)] = blur_valid(image, psf)
    half = size // 2
    np.testing.assert_allclose(
        blurred[20 - half : 20 - half + size, 22 - half : 22 - half + size], psf, atol=1e-14
    )


@pytest.mark.parametrize("size", [1, 6, 7])
def test_a_delta_changes_nothing(size: int) -> None:
    image = np.random.default_rng(0).random((20, 23, 3))
    psf = np.zeros((size, size))
    psf[size // 2, size // 2] = 1
    np.testing.assert_allclose(
        blur_valid(image, psf), image[valid_window(image.shape, psf.shape)], atol=1e-12
    )
    np.testing.assert_allclose(blur_symmetric(image, psf), image, atol=1e-12)


def test_symmetric_borders_mirror_the_scene_and_agree_inside() -> None:
    rng = np.random.default_rng(1)
    image = rng.random((20, 24))
    psf = rng.random((6, 5))
    blurred = blur_symmetric(image, psf)
    assert blurred.shape == image.shape
    np.testing.assert_allclose(
        blurred[valid_window(image.shape, psf.shape)], blur_valid(image, psf), atol=1e-12
    )
    wide = np.pad(image, 10, mode="symmetric")
    np.testing.assert_allclose(
        blurred, signal.convolve(wide, psf)[10 + 3 : 10 + 3 + 20, 10 + 2 : 10 + 2 + 24]
    )
    np.testing.assert_allclose(blur_symmetric(np.ones((9, 9)), psf / psf.sum()), 1, atol=1e-12)


def test_blur_refuses_what_does_not_fit() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        blur_valid(np.zeros((5, 9)), np.ones((6, 6)))
    with pytest.raises(ValueError, match="sharp"):
        blur_valid(np.zeros(5), np.ones((6, 6)))
    with pytest.raises(ValueError, match="psf"):
        blur_valid(np.zeros((5, 9)), np.ones(6))


def test_photon_and_read_noise_have_their_variances() -> None:
    rng = np.random.default_rng(0)
    grey = np.full((300, 300), 0.4)
    shot = add_noise(grey, rng, photons_full_scale=1000)
    assert shot.mean() == pytest.approx(0.4, abs=4e-4)
    assert shot.var() == pytest.approx(0.4 / 1000, rel=0.03)
    np.testing.assert_allclose(shot * 1000, np.rint(shot * 1000), atol=1e-9)  # whole photons
    both = add_noise(grey, rng, photons_full_scale=1000, read_sigma=0.03)
    assert both.var() == pytest.approx(0.4 / 1000 + 0.03**2, rel=0.03)
    np.testing.assert_array_equal(add_noise(grey, rng), grey)
    assert add_noise(grey, rng) is not grey


def test_noise_repeats_with_the_seed_and_refuses_nonsense() -> None:
    grey = np.full((4, 4), 0.5)
    a, b = (
        add_noise(grey, np.random.default_rng(3), photons_full_scale=50, read_sigma=0.1)
        for _ in range(2)
    )
    np.testing.assert_array_equal(a, b)
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="read_sigma"):
        add_noise(grey, rng, read_sigma=-1)
    with pytest.raises(ValueError, match="photons_full_scale"):
        add_noise(grey, rng, photons_full_scale=0)
    with pytest.raises(ValueError, match="photo"):
        add_noise(grey - 1, rng, photons_full_scale=10)


def test_photograph_is_blur_noise_and_what_is_recorded() -> None:
    rng = np.random.default_rng(0)
    scene = rng.random((60, 70)) * 1.5
    motion = Trajectory.straight(9.0, angle_rad=0.4)
    psf = motion.psf(motion.frame_size() | 1)
    plain = photograph(scene, motion, rng=rng, read_sigma=0)
    np.testing.assert_allclose(plain, np.clip(blur_valid(scene, psf), 0, 1))
    np.testing.assert_array_equal(plain, photograph(scene, psf, rng=rng, read_sigma=0))
    noisy = photograph(scene, psf, rng=np.random.default_rng(1), read_sigma=0.2, record=np.asarray)
    assert noisy.min() < 0 < 1 < noisy.max()
    recorded = photograph(scene, psf, rng=np.random.default_rng(1), read_sigma=0.2, record=np.rint)
    np.testing.assert_array_equal(recorded, np.rint(noisy))


@pytest.mark.parametrize(
    ("borders", "blur"), [("real", blur_valid), ("symmetric", blur_symmetric)]
)
def test_a_photo_shows_the_visible_part_of_its_scene(borders, blur) -> None:
    scene = np.random.default_rng(0).random((60, 70, 3))
    rng = np.random.default_rng(1)
    psf = Trajectory.straight(9.0, angle_rad=0.4).psf(20)
    photo = photograph(scene, psf, rng=rng, borders=borders, read_sigma=0)
    np.testing.assert_array_equal(photo, np.clip(blur(scene, psf), 0, 1))
    shown = visible(scene, 20, borders=borders)
    assert (
        photo.shape == shown.shape == (60 - border_px(borders, 20), 70 - border_px(borders, 20), 3)
    )
    still = np.zeros((20, 20))
    still[10, 10] = 1
    np.testing.assert_allclose(
        photograph(scene, still, rng=rng, borders=borders, read_sigma=0), shown, atol=1e-12
    )


def test_unknown_borders_are_refused() -> None:
    with pytest.raises(ValueError, match=r'^borders: must be "real" or "symmetric", got "?'):
        photograph(np.ones((9, 9)), np.ones((1, 1)), rng=np.random.default_rng(0), borders="black")
