"""Gains stated beside those of other photographs."""

import numpy as np
import pytest

import cep
from cep.files.images import write_image
from cep.optics.camera import Camera
from cep.photographs.scenes import photographs
from cep.search.problem import SearchProblem
from lab.photo_gains.gains import Gain, measured_gain, trial_of
from lab.photo_gains.photographs import load_scenes
from motdiff.trajectory import Trajectory


def test_a_folder_s_photos_are_read_in_linear_light(tmp_path):
    for number, level in enumerate((0.1, 0.2, 0.3)):
        write_image(tmp_path / f"{number}.png", np.full((40, 50, 3), level))
    scenes = load_scenes(tmp_path, side_px=32, count=2)
    assert [scene.shape for scene in scenes] == [(32, 32)] * 2
    np.testing.assert_allclose([scene.mean() for scene in scenes], [0.1, 0.2], atol=0.003)


@pytest.mark.slow(reason="a search and sixty restorations")
def test_a_gain_is_that_of_the_same_two_ways():
    camera = Camera(photons_full_scale=10_000, read_noise_e=50)
    problem = SearchProblem.along(Trajectory.straight(40.0), chips=40, camera=camera)
    verdict = cep.advise(problem, levels=[], photographs=photographs()[:1]).here
    gain = measured_gain(verdict, trial_of(problem, photographs()[2:4]))
    assert gain.stated_db == verdict.code_gain_db
    assert gain.over_best_db <= gain.measured_db + 1e-9
    assert gain.stated_chips == verdict.best("snapshot").code.open_chips


def test_cells_say_whether_the_range_holds():
    gain = Gain(1.0, 0.5, 1.5, 1.2, 1.1, 0.4, 5, 4)
    assert gain.covered
    assert gain.cells == "+1.00 (+0.5 to +1.5) | +1.20 | yes | 0.40 | +1.10 | 5 (4)"
