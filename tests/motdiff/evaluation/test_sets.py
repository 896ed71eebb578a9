"""The data sets of the evaluation: determinism, the physics of their photos, and Levin's convention."""

import itertools

import cv2
import numpy as np
import pytest
from scipy import io, ndimage, signal

from motdiff.evaluation.measure import restored
from motdiff.evaluation.sets import RECIPES, levin, load_scenes, simulated
from motdiff.metrics import psnr_up_to_shift
from motdiff.motions import boracchi_foi


def scene(seed, shape=(160, 170)):
    """Patches of flat light: edges in every direction, as photos have."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), 4)
    return np.digitize(noise / noise.std(), [-1, -0.3, 0.3, 1]) / 5 + 0.1


def cases(seed=0, count=3, *, borders="real", sigma=0.01, scenes=None, recipe="paper", trace=None, size=96):
    scenes = [scene(1), scene(2)] if scenes is None else scenes
    mix = RECIPES[recipe].mix(trace)
    return list(simulated(scenes, count=count, seed=seed, mix=mix, sigma=sigma, borders=borders, size=size))


@pytest.fixture
def trace_file(tmp_path):
    rng = np.random.default_rng(0)
    rates = 0.1 * ndimage.gaussian_filter1d(rng.standard_normal((1200, 3)), 10, axis=0) * 5
    rows = [f"{i / 200:.4f},{wx:.6f},{wy:.6f},{wz:.6f}" for i, (wx, wy, wz) in enumerate(rates)]
    path = tmp_path / "gyro.csv"
    path.write_text("\n".join(["t_s,wx,wy,wz", *rows]))
    return path


def same(a, b):
    return a.name == b.name and np.array_equal(a.photo, b.photo) and np.array_equal(a.psf, b.psf)


def test_a_case_depends_on_seed_and_number_only():
    few, many = cases(count=2), cases(count=3)
    assert all(same(a, b) for a, b in zip(few, many[:2], strict=True))
    assert not any(same(a, b) for a, b in itertools.combinations(many, 2))
    assert not any(np.array_equal(a.psf, b.psf) for a, b in zip(few, cases(seed=1, count=2), strict=True))


def test_recipes_share_their_motions():
    for real, mirrored in zip(cases(borders="real"), cases(borders="symmetric", sigma=0.0), strict=True):
        np.testing.assert_array_equal(real.psf, mirrored.psf)


def test_symmetric_borders_mirror_the_scene():
    (case,) = cases(count=1, borders="symmetric", sigma=0.0)
    assert case.photo.shape == case.sharp.shape == (96, 96)
    np.testing.assert_allclose(case.photo, ndimage.convolve(case.sharp, case.psf, mode="reflect"), atol=1e-9)


def test_real_borders_let_light_in_from_beyond_the_frame():
    (case,) = cases(count=1, borders="real", sigma=0.0)
    assert case.photo.shape == case.sharp.shape == (96, 96)
    inside = (slice(32, -32),) * 2
    within = ndimage.convolve(case.sharp, case.psf)
    np.testing.assert_allclose(case.photo[inside], within[inside], atol=1e-9)
    assert np.abs(case.photo - ndimage.convolve(case.sharp, case.psf, mode="reflect")).max() > 0.01


def test_noise_is_as_asked_and_the_same_light_stays():
    flat = [np.full((160, 160, 3), 128, np.uint8)]
    (case,) = cases(count=1, scenes=flat, sigma=0.02)
    assert case.photo.shape == (96, 96, 3)
    assert case.photo.mean() == pytest.approx(128 / 255, abs=1e-3)
    assert case.photo.std() == pytest.approx(0.02, rel=0.03)


def test_the_truth_is_the_motion_of_the_recipe(trace_file):
    for case in cases(count=3):
        assert case.trajectory.length_px == pytest.approx(60)
        np.testing.assert_allclose(case.psf, case.trajectory.psf(64))
    extents = [case.trajectory.extent_px for case in cases(count=12, recipe="gyro", trace=trace_file)]
    assert 12 <= min(extents) < max(extents) <= 36


def test_scenes_are_read_large_enough_and_grey_when_asked(tmp_path):
    colours = np.random.default_rng(0).integers(0, 256, (330, 340, 3), np.uint8)
    assert cv2.imwrite(str(tmp_path / "a.png"), colours[..., ::-1])
    assert cv2.imwrite(str(tmp_path / "small.png"), colours[:300])
    (colour,) = load_scenes(tmp_path, least_px=319)
    np.testing.assert_array_equal(colour, colours)
    (grey,) = load_scenes(tmp_path, least_px=319, grey=True)
    np.testing.assert_allclose(grey, colours.mean(axis=2) / 255)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [({"count": 0}, "count"), ({"borders": "black"}, "borders"), ({"size": 200}, "photos"), ({"scenes": []}, "photos")],
)
def test_what_cannot_be_simulated_is_refused(wrong, told):
    with pytest.raises(ValueError, match=rf"^{told}: must be"):
        cases(**wrong)


def test_gyro_motion_needs_a_recording():
    with pytest.raises(ValueError, match="gyro_trace"):
        RECIPES["gyro"].mix()


def test_levins_kernel_is_turned(tmp_path):
    kernel = boracchi_foi(np.random.default_rng(1), max_length_px=30.0).psf(31)
    sharp = scene(3, (190, 190))
    blurred = signal.convolve(sharp, kernel[::-1, ::-1], mode="valid")  # x convolved with rot180(f)
    stored = {"x": sharp[15:-15, 15:-15], "y": blurred, "f": 3 * kernel}
    io.savemat(tmp_path / "im01_ker01.mat", stored)
    (case,) = levin(tmp_path)
    assert case.name == "im01_ker01"
    assert case.trajectory is None
    assert case.psf.sum() == pytest.approx(1)
    np.testing.assert_allclose(case.psf, kernel[::-1, ::-1] / kernel.sum())
    right, wrong = (psnr_up_to_shift(restored(case.photo, psf), case.sharp) for psf in (case.psf, case.psf[::-1, ::-1]))
    assert right > wrong + 3


def test_levins_folder_is_checked(tmp_path):
    with pytest.raises(ValueError, match=r"no \.mat file"):
        list(levin(tmp_path))
    io.savemat(tmp_path / "a.mat", {"x": np.ones((3, 3)), "y": np.ones((3, 3))})
    with pytest.raises(ValueError, match=r"a\.mat: lacks the variable f"):
        list(levin(tmp_path))
