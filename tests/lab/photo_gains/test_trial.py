"""Measured gains: photos that hold their scenes, and noise that all codes share."""

import numpy as np
import pytest

import cep
from cep.files.images import write_image
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.restoration.wiener import wiener
from cep.search.problem import SearchProblem
from lab.photo_gains.__main__ import measured_row
from lab.photo_gains.photographs import load_scenes, photographs
from lab.photo_gains.trial import JUDGED_PX, Trial
from motdiff.trajectory import Trajectory

BRIGHT = Camera(photons_full_scale=1e7, read_noise_e=1e-3, bits=16)


def unrestored(photo, psf, *, camera):
    return photo / psf.sum()


def test_the_photographs_are_twelve_in_linear_light():
    scenes = photographs()
    assert len(scenes) == 12
    assert {scene.shape for scene in scenes} == {(300, 300)}
    assert 0.15 < np.mean([scene.mean() for scene in scenes]) < 0.3


def test_a_folder_s_photos_are_read_in_linear_light(tmp_path):
    for number, level in enumerate((0.1, 0.2, 0.3)):
        write_image(tmp_path / f"{number}.png", np.full((40, 50, 3), level))
    scenes = load_scenes(tmp_path, side_px=32, count=2)
    assert [scene.shape for scene in scenes] == [(32, 32)] * 2
    np.testing.assert_allclose([scene.mean() for scene in scenes], [0.1, 0.2], atol=0.003)


def test_without_motion_and_noise_the_photo_is_the_scene():
    problem = SearchProblem.along(Trajectory.straight(0.01), chips=4, camera=BRIGHT)
    levels = Trial(problem, photographs()[:3], unrestored).psnr_db([ShutterCode("1111")])
    assert levels.shape == (1, 3)
    assert levels.min() > 60  # what the photons leave


def test_blur_costs_what_the_blurred_scene_differs_by():
    """Against a blur along the rows by hand."""
    problem = SearchProblem.along(Trajectory.straight(9.0), chips=4, camera=BRIGHT)
    level = Trial(problem, photographs()[:1], unrestored).psnr_db([ShutterCode("1111")])[0, 0]
    scene = photographs()[0]
    # trapezium rule on whole pixels: the ends of the path count half
    weights = np.array([0.5, *[1.0] * 8, 0.5]) / 9
    blurred = sum(w * np.roll(scene, k, axis=1) for w, k in zip(weights, range(10), strict=True))
    middle = slice((300 - JUDGED_PX) // 2, (300 + JUDGED_PX) // 2)
    by_hand = min(
        np.mean((np.roll(blurred, -shift, axis=1) - scene)[middle, middle] ** 2)
        for shift in (4, 5)
    )
    assert level == pytest.approx(-10 * np.log10(by_hand), abs=1.0)


def test_the_noise_is_the_same_for_every_code():
    camera = Camera(photons_full_scale=300, read_noise_e=5)
    problem = SearchProblem.along(Trajectory.straight(5.0), chips=4, camera=camera)
    trial = Trial(problem, photographs()[:2], unrestored)
    same = ShutterCode("1010"), ShutterCode("1010")
    first, second = trial.psnr_db(same)
    np.testing.assert_array_equal(first, second)


def test_a_wrong_path_costs_something():
    problem = SearchProblem.along(Trajectory.straight(20.0), chips=8, camera=BRIGHT)
    code = [ShutterCode("10110011")]
    right = Trial(problem, photographs()[:2], wiener)
    wrong = Trial(problem, photographs()[:2], wiener, path_error_px=1.0)
    assert right.psnr_db(code).mean() > wrong.psnr_db(code).mean() + 1


def test_a_row_holds_the_expected_and_the_measured_gain():
    camera = Camera(photons_full_scale=10_000, read_noise_e=50)
    problem = SearchProblem.along(Trajectory.straight(40.0), chips=40, camera=camera)
    verdict = cep.advise(problem, levels=[]).here
    trial = Trial(problem, photographs()[:2], wiener)
    expected, same_two, best, chips, _ = measured_row(verdict, trial).split(" | ")
    gain = verdict.best("code").psnr_db - verdict.best("snapshot").psnr_db
    assert float(expected) == pytest.approx(gain, abs=0.006)
    assert float(best) <= float(same_two) + 0.006  # no single exposure is better than the best
    assert chips.endswith(f"({verdict.best('snapshot').code.open_chips})")
