"""Photos of photographs: they hold their scenes, and noise that all codes share."""

import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.photographs.scenes import NAMES, photographs
from cep.photographs.trial import JUDGED_PX, PhotoTrial, grid_px, needed_px
from cep.restoration.wiener import wiener
from motdiff.trajectory import Trajectory

BRIGHT = Camera(photons_full_scale=1e7, read_noise_e=1e-3, bits=16)


def trial(path, count=2, *, camera=BRIGHT, **options):
    return PhotoTrial([path], photographs()[:count], camera=camera, **options)


def unrestored(photo, psf, *, camera):
    return photo / psf.sum()


def test_the_photographs_are_twelve_in_linear_light():
    scenes = photographs()
    assert len(scenes) == len(set(NAMES)) == 12
    assert {scene.shape for scene in scenes} == {(256, 256)}
    assert all(scene.min() >= 0 and scene.max() <= 1 for scene in scenes)


def test_without_motion_and_noise_the_photo_is_the_scene():
    levels = trial(Trajectory.straight(0.01), 3, restore=unrestored).psnr_db([ShutterCode("1111")])
    assert levels.shape == (1, 3)
    assert levels.min() > 60  # what the photons leave


def test_blur_costs_what_the_blurred_scene_differs_by():
    """Against a blur along the rows by hand."""
    blurred_trial = trial(Trajectory.straight(9.0), 1, restore=unrestored)
    level = blurred_trial.psnr_db([ShutterCode("1111")])[0, 0]
    scene = photographs()[0]
    # trapezium rule on whole pixels: the ends of the path count half
    weights = np.array([0.5, *[1.0] * 8, 0.5]) / 9
    blurred = sum(w * np.roll(scene, k, axis=1) for w, k in zip(weights, range(10), strict=True))
    middle = slice((256 - JUDGED_PX) // 2, (256 + JUDGED_PX) // 2)
    by_hand = min(
        np.mean((np.roll(blurred, -shift, axis=1) - scene)[middle, middle] ** 2)
        for shift in (4, 5)
    )
    assert level == pytest.approx(-10 * np.log10(by_hand), abs=1.0)


def test_two_photos_at_the_same_time_tell_more_than_one():
    camera = Camera(photons_full_scale=300, read_noise_e=5)
    halves = ShutterCode("1100"), ShutterCode("0011")
    path = Trajectory.straight(6.0, direction="known")
    alone, together = trial(path, 1, camera=camera).psnr_db([halves[0], halves])
    assert together[0] > alone[0]


def test_the_noise_is_the_same_for_every_code_and_of_the_seed():
    camera = Camera(photons_full_scale=300, read_noise_e=5)
    codes = ShutterCode("1010"), ShutterCode("1010")
    path = Trajectory.straight(5.0)
    first, second = trial(path, camera=camera, restore=unrestored).psnr_db(codes)
    np.testing.assert_array_equal(first, second)
    again = trial(path, camera=camera, restore=unrestored).psnr_db(codes[:1], [1])
    assert again[0, 0] == first[1]
    other = trial(path, camera=camera, restore=unrestored, seed=1).psnr_db(codes[:1])
    assert not np.array_equal(other[0], first)


def test_a_wrong_path_costs_something():
    path = Trajectory.straight(20.0)
    code = [ShutterCode("10110011")]
    right = trial(path, restore=wiener).psnr_db(code)
    wrong = trial(path, restore=wiener, path_error_px=1.0).psnr_db(code)
    assert right.mean() > wrong.mean() + 1


def test_a_longer_motion_in_two_directions_takes_larger_photos():
    short, long, bent = (
        grid_px([Trajectory.from_samples(samples)])
        for samples in ([[0, 0], [20, 0]], [[0, 0], [60, 0]], [[0, 0], [60, 0], [60, 60]])
    )
    assert JUDGED_PX**2 < short < long < bent


def test_a_scene_as_large_as_needed_is_not_mirrored():
    """What lies beyond it changes nothing; what lies at its rim does."""
    path = Trajectory(np.array([0.0, 1.0]), np.array([[-10.0, -3.0], [10.0, 3.0]]))
    height, width = needed_px([path])
    large = photographs()[0]
    top, left = (large.shape[0] - height) // 2, (large.shape[1] - width) // 2
    middle = large[top : top + height, left : left + width]

    def depends_on_all(photo, psf, *, camera):
        return photo + photo.mean()

    def level_db(scene):
        whole = PhotoTrial([path], [scene], camera=BRIGHT, restore=depends_on_all)
        return whole.psnr_db([ShutterCode("1111")])

    np.testing.assert_array_equal(level_db(middle), level_db(large))
    assert level_db(middle[8:-8, 8:-8]) != level_db(large)
