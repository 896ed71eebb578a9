"""The choice of an estimator, and the files of a calibration."""

import numpy as np
import pytest

from cep.calibrate import CALIBRATION_FILES, METHODS, calibrate, make_estimator, write_calibration
from cep.files import read_psf
from cep.images import read_image
from motdiff.estimators.base import MotionEstimate
from motdiff.files import read_motion
from motdiff.gyro import GyroTrace
from motdiff.trajectory import Trajectory

TRACE = GyroTrace(np.linspace(0, 1, 101), np.tile([0.1, 0.2, 0.0], (101, 1)))
GYRO = {"gyro": TRACE, "focal_px": 500.0, "start_s": 0.2, "exposure_s": 0.1}
BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5]])


def estimate(*paths):
    weights = tuple(1 / len(paths) for _ in paths)
    return MotionEstimate("pmp", paths, weights, paths[0].psf(max(64, paths[0].frame_size())), 0.5)


def test_each_method_makes_its_estimator():
    needs = {"reference": {"sharp": np.eye(40)}, "gyro": GYRO}
    for method in METHODS:
        name = type(make_estimator(method, **needs.get(method, {}))).__name__
        assert name.lower() == f"{method}estimator"


def test_a_steady_turn_gives_a_straight_path():
    found = calibrate(np.random.default_rng(0).random((50, 60)), make_estimator("gyro", **GYRO))
    assert found.trajectories[0].direction == "known"
    assert found.trajectories[0].length_px == pytest.approx(500 * 0.1 * np.hypot(0.1, 0.2), rel=1e-3)


@pytest.mark.parametrize(
    ("method", "options", "message"),
    [
        ("magic", {}, "method: must be one of pmp"),
        ("reference", {}, "sharp: the method"),
        ("gyro", GYRO | {"focal_px": None}, "focal_px: the method"),
        ("pmp", {"sharp": np.eye(40)}, "no use for it"),
        ("point", {"start_s": 1.0}, "no use for it"),
    ],
)
def test_what_a_method_needs_is_said(method, options, message):
    with pytest.raises(ValueError, match=message):
        make_estimator(method, **options)


@pytest.mark.parametrize(("level", "shade"), [(0.0, "black"), (1.0, "white"), (0.4, "the same")])
def test_a_photo_without_texture_is_refused(level, shade):
    with pytest.raises(ValueError, match=f"{shade} all over"):
        calibrate(np.full((64, 64, 3), level), make_estimator("point"))


def test_the_files_hold_the_estimate(tmp_path):
    found = estimate(BENT, BENT.scaled(1.2))
    photo = np.random.default_rng(0).random((80, 90, 3))
    written = write_calibration(tmp_path / "m", found, photo, source={"image": "a.png", "seed": 4})
    assert set(written) == set(CALIBRATION_FILES) == {item.name for item in (tmp_path / "m").iterdir()}
    stored = read_motion(written["trajectory.json"])
    np.testing.assert_allclose(stored.trajectory.xy, BENT.xy)
    assert stored.weight == 0.5
    assert len(stored.alternatives) == 1
    assert stored.source == {"method": "pmp", "image": "a.png", "seed": 4}
    np.testing.assert_allclose(read_psf(written["psf.npy"]), found.psf, rtol=1e-6)
    np.testing.assert_array_equal(read_image(written["map.png"], gamma="linear"), BENT.hr_map())


def test_a_path_too_large_for_the_map_has_none(tmp_path):
    written = write_calibration(tmp_path / "m", estimate(Trajectory.straight(100.0)), np.zeros((60, 60)))
    assert set(written) == set(CALIBRATION_FILES) - {"map.png"}


def test_nothing_is_replaced_or_half_written(tmp_path):
    write_calibration(tmp_path / "m", estimate(BENT), np.zeros((60, 60)))
    before = (tmp_path / "m/trajectory.json").read_text()
    with pytest.raises(ValueError, match="use --force"):
        write_calibration(tmp_path / "m", estimate(BENT.scaled(2)), np.zeros((60, 60)))
    with pytest.raises(TypeError, match="shape"):  # fails on the last file, the preview
        write_calibration(tmp_path / "m", estimate(BENT.scaled(2)), np.zeros((60, 60, 7)), force=True)
    assert (tmp_path / "m/trajectory.json").read_text() == before
    assert [item.name for item in tmp_path.iterdir()] == ["m"]
