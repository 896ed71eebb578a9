"""Calibrations of the coded table by other photos than an open one."""

import numpy as np
import pytest
from coded_table import BENT

from cep.optics.camera import Camera
from lab.bench.coded.calibrations import (
    calibration_photos,
    codes_of_set,
    motion_from_light,
    moved_psfs,
)
from lab.bench.coded.protocol import (
    paths_from,
)
from motdiff.metrics import timed_distance_px
from motdiff.psf_frame import centroid_px
from motdiff.trajectory import Trajectory


def test_photos_of_a_calibration_are_moved_by_their_own_shifts():
    codes = codes_of_set("open+gray2", 8)
    shifts_px = [[1.5, -0.5], [0.0, 0.0], [-2.0, 1.0]]
    psfs = moved_psfs([BENT] * 3, codes, shifts_px)
    assert psfs.sum(axis=(1, 2)) == pytest.approx([1.0, 0.5, 0.5])
    still = moved_psfs([BENT] * 3, codes, np.zeros((3, 2)))
    for psf, unmoved, shift_px in zip(psfs, still, shifts_px, strict=True):
        centroids = [np.array(centroid_px(one))[::-1] for one in (psf, unmoved)]
        np.testing.assert_allclose(centroids[0] - centroids[1], shift_px, atol=1e-9)


def test_calibration_photos_have_their_codes_light():
    dim = Camera(photons_full_scale=1e9, read_noise_e=0.0, bits=16)
    options = {"camera": dim, "borders": "real"}
    for light_true, light in ((True, 0.5), (False, 1.0)):
        plain, coded = calibration_photos(
            np.full((128, 128), 0.6),
            BENT,
            ["1" * 8, "11001010"],
            rng=np.random.default_rng(0),
            light_true=light_true,
            **options,
        )
        assert plain.shape == coded.shape
        assert coded.mean() / plain.mean() == pytest.approx(light, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "message"), [("theirs", "'theirs' is no code"), ("open", "order cannot be known")]
)
def test_a_set_that_tells_no_order_is_refused(name, message):
    with pytest.raises(ValueError, match=message):
        codes_of_set(name, 16)


def test_a_point_light_through_a_code_shows_the_path_and_its_direction():
    angle = np.linspace(0, np.pi / 2, 60)
    arc = Trajectory.from_samples(
        10 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]), direction="known"
    )
    found = motion_from_light(motion=arc, camera=Camera(), seed=0)
    path = paths_from(found["paths"])[0][0]
    assert path.direction == "known"
    assert found["error_px"] == pytest.approx(timed_distance_px(path, arc), abs=1e-3)
    assert found["error_px"] < 0.3
    assert timed_distance_px(path.reversed(), arc) > 3
    assert found["mnc"] > 0.95
