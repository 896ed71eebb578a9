"""The gyro estimator against the path that its readings were taken from."""

import json
import re

import numpy as np
import pytest

from motdiff.estimators.gyro import Gyro
from motdiff.estimators.gyro.estimator import GyroEstimator
from motdiff.gyro import GyroTrace, trajectory_from_gyro
from motdiff.metrics import mnc_subpixel, path_distance_px

FOCAL_PX = 3000.0


def shake(seed: int, *, duration_s: float = 2.0, rate_hz: float = 4000.0) -> GyroTrace:
    """Sums of sines of 1 to 12 Hz, about 0.1 rad/s."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    freq = rng.uniform(1, 12, (12, 3))
    phase = rng.uniform(0, 2 * np.pi, (12, 3))
    strength = np.exp(-freq / 5)
    rate = (strength * np.sin(2 * np.pi * freq * t[:, None, None] + phase)).sum(axis=1)
    rate = 0.1 * rate / rate.std(axis=0)
    rate[:, 2] *= 0.02
    return GyroTrace(t, rate)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise_rad_s", [0.0, 0.001])
def test_psf_from_readings_at_200_hz(seed: int, noise_rad_s: float) -> None:
    exact = shake(seed)
    window = {"focal_px": FOCAL_PX, "start_s": 0.4 + 0.0013 * seed, "exposure_s": 0.15}
    path = trajectory_from_gyro(exact, **window)
    rng = np.random.default_rng(seed)
    noisy = exact.rate_rad_s[::20] + noise_rad_s * rng.standard_normal((len(exact.t_s[::20]), 3))
    estimate = GyroEstimator(GyroTrace(exact.t_s[::20], noisy), **window).estimate(
        np.zeros((600, 800))
    )
    frame = max(64, path.frame_size())
    assert mnc_subpixel(estimate.psf, path.psf(frame)) >= 0.99
    found = estimate.trajectories[0]
    assert found.direction == "known"
    assert path_distance_px(found, path) < 0.5
    # direction and dwell too: the same place at the same time
    t = np.linspace(0, 1, 50)
    assert np.abs(found.at(t) - path.at(t)).max() < 0.03 * path.extent_px + 0.3
    assert estimate.confidence > 0.5
    assert estimate.details["sample_rate_hz"] == pytest.approx(200)
    json.dumps(estimate.details, allow_nan=False)


def test_roll_lowers_the_confidence_and_is_told() -> None:
    calm = shake(0)
    rolling = GyroTrace(calm.t_s, calm.rate_rad_s + np.array([0, 0, 0.2]))
    window = {"focal_px": FOCAL_PX, "start_s": 0.4, "exposure_s": 0.1}
    photo = np.zeros((3000, 4000))
    estimate = GyroEstimator(rolling, **window).estimate(photo)
    assert any("Roll" in warning for warning in estimate.warnings)
    assert estimate.details["roll_at_corner_px"] == pytest.approx(
        50, rel=0.1
    )  # 0.02 rad at 2500 px
    small = GyroEstimator(rolling, **window).estimate(photo[:100, :100])
    assert small.confidence > estimate.confidence
    np.testing.assert_array_equal(small.psf, estimate.psf)


def test_sparse_readings_and_long_paths_are_told() -> None:
    trace = shake(1)
    slow = GyroTrace(trace.t_s[::400], trace.rate_rad_s[::400])  # 10 Hz
    estimate = GyroEstimator(slow, focal_px=100, start_s=0.41, exposure_s=0.05).estimate(
        np.zeros((9, 9))
    )
    assert any("gyro readings" in warning for warning in estimate.warnings)
    assert estimate.confidence == 0
    far = GyroEstimator(trace, focal_px=30_000, start_s=0.3, exposure_s=0.3).estimate(
        np.zeros((300, 400))
    )
    assert any("PSF frame" in warning for warning in far.warnings)
    assert far.psf.sum() == pytest.approx(1)
    assert len(far.psf) == far.trajectories[0].frame_size() > 64


def test_errors_pass_through() -> None:
    trace = shake(0)
    with pytest.raises(ValueError, match="within the trace"):
        GyroEstimator(trace, focal_px=100, start_s=1.95, exposure_s=0.1).estimate(np.zeros((9, 9)))
    with pytest.raises(ValueError, match="photo"):
        GyroEstimator(trace, focal_px=100, start_s=0.5, exposure_s=0.1).estimate(np.zeros(9))


def test_degrees_read_as_radians_are_refused_before_anything_is_drawn(monkeypatch) -> None:
    """57 times too long, the path leaves the photo: the question is asked at once, whatever the
    rates."""
    trace = shake(0)
    window = {"focal_px": FOCAL_PX, "start_s": 0.4, "exposure_s": 0.1}
    photo = np.zeros((600, 800))
    assert GyroEstimator(trace, **window).estimate(photo).trajectories[0].extent_px < 64

    def drawn(*_arguments, **_options):
        raise AssertionError("a PSF is drawn")

    monkeypatch.setattr("motdiff.trajectory.Trajectory.psf", drawn)
    single = trace.rate_rad_s.copy()
    single[1800] = 1e8
    for rates in (np.degrees(trace.rate_rad_s), single):
        with pytest.raises(
            ValueError, match=r"^rate_unit: .* px .*800 x 600 px.*deg/s \(rate_unit='deg'\)"
        ):
            GyroEstimator(GyroTrace(trace.t_s, rates), **window).estimate(photo)


@pytest.mark.parametrize("clock_s", [0.0, 2.5e5, 1.6e9])
def test_the_clock_may_count_from_1970(clock_s: float) -> None:
    trace = shake(2)
    path = trajectory_from_gyro(trace, focal_px=FOCAL_PX, start_s=0.5, exposure_s=0.2)
    late = GyroTrace(trace.t_s + clock_s, trace.rate_rad_s)
    found = trajectory_from_gyro(late, focal_px=FOCAL_PX, start_s=clock_s + 0.5, exposure_s=0.2)
    t = np.linspace(0, 1, 50)
    np.testing.assert_allclose(found.at(t), path.at(t), atol=1e-3)
    for start_s in (clock_s - 0.01, clock_s + 1.9):
        with pytest.raises(ValueError, match="within the trace"):
            trajectory_from_gyro(late, focal_px=FOCAL_PX, start_s=start_s, exposure_s=0.2)


@pytest.mark.parametrize("clock_s", [0.000_04, 1234.567_89, 1_600_000_012.345_678])
def test_the_times_told_are_times_that_can_be_chosen(clock_s: float) -> None:
    trace = shake(3)
    late = GyroTrace(trace.t_s + clock_s, trace.rate_rad_s)
    with pytest.raises(ValueError, match="within the trace") as caught:
        trajectory_from_gyro(late, focal_px=FOCAL_PX, start_s=5.0 + clock_s, exposure_s=0.1)
    asked, there = re.findall(r"(\d+\.\d+)\.\.(\d+\.\d+) s", str(caught.value))
    assert float(asked[0]) == pytest.approx(5.0 + clock_s, abs=1e-4)
    first_s, last_s = map(float, there)
    assert first_s == pytest.approx(late.t_s[0], abs=1.1e-4)
    assert last_s == pytest.approx(late.t_s[-1], abs=1.1e-4)
    for start_s in (first_s, last_s - 0.1):
        trajectory_from_gyro(late, focal_px=FOCAL_PX, start_s=start_s, exposure_s=0.1)


def test_a_path_too_long_to_be_handled_is_refused() -> None:
    steady = GyroTrace(np.linspace(0, 1, 100), np.tile([0.0, 5.0, 0.0], (100, 1)))
    estimator = GyroEstimator(steady, focal_px=5000, start_s=0.1, exposure_s=0.2)
    with pytest.raises(
        ValueError, match=r"the path is 5000 px long, at most 4096 px can be handled"
    ):
        estimator.estimate(np.zeros((64, 8000)))


def test_a_unit_is_for_files_alone() -> None:
    options = {"gyro": shake(0), "focal_px": FOCAL_PX, "start_s": 0.4, "exposure_s": 0.1}
    assert isinstance(Gyro(**options).make(), GyroEstimator)
    with pytest.raises(ValueError, match="rate_unit: is for a file"):
        Gyro(**options, rate_unit="deg").make()
