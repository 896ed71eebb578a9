"""Which paths are straight motions, their axes, and their lengths at constant speed."""

import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.optics.straight_motion import stays_in_place, straight_axis, uniform_length_px
from cep.proofs.certify.certificate import certify
from motdiff.trajectory import Trajectory


@pytest.mark.parametrize("angle_rad", [0.0, 0.7, np.pi / 2, 3.0])
def test_a_straight_motion_of_constant_speed_has_an_axis_and_a_length(angle_rad):
    path = Trajectory.straight(17.0, angle_rad=angle_rad)
    assert straight_axis(path) == pytest.approx([np.cos(angle_rad), np.sin(angle_rad)])
    assert uniform_length_px(path) == pytest.approx(17.0)
    # however it is sampled
    t = np.sort(np.random.default_rng(1).random(9))
    resampled = Trajectory.from_samples(path.at(t), t=t)
    assert uniform_length_px(resampled) == pytest.approx(17.0 * np.ptp(t))


def test_at_its_own_pace_or_back_and_forth_it_has_an_axis_alone():
    t = np.linspace(0, 1, 30)
    for along in (t**2, np.abs(t - 0.5)):
        path = Trajectory.from_samples(np.stack([3 * along, 4 * along], axis=1), t=t)
        assert np.abs(straight_axis(path)) == pytest.approx([0.6, 0.8])
        assert uniform_length_px(path) is None


def test_a_bent_path_is_none_and_a_point_has_no_length():
    bent = Trajectory.from_samples([[0, 0], [5, 1e-3], [10, 0]])
    assert straight_axis(bent) is None
    assert uniform_length_px(bent) is None
    point = Trajectory.from_samples([[2, 3], [2, 3]])
    assert stays_in_place(point)
    assert uniform_length_px(point) is None


def test_a_certificate_along_a_uniform_straight_motion_covers_both_directions():
    code = ShutterCode("11100101")
    for direction in ("known", "unknown"):
        path = Trajectory.from_samples([[0, 0], [12, 5]], direction=direction)
        assert certify(code, path).directions == ("forward", "backward")
    accelerated = Trajectory.from_samples([[0, 0], [1, 0], [9, 0]], direction="known")
    assert certify(code, accelerated).directions == ("forward",)
