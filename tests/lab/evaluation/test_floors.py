"""Floors and ceilings have the values that theory and the reference figures say."""

import numpy as np
import pytest
from scipy import ndimage

from lab.evaluation.floors import delta, floors, gaussian, mean_psf, path_kernel, quadratic_kernel
from motdiff.gyro import GyroTrace
from motdiff.metrics import mnc, mnc_subpixel
from motdiff.motions import boracchi_foi
from motdiff.training.motion_bank import MotionMix, draw_motion
from motdiff.trajectory import Trajectory


def walks(count=20):
    return [boracchi_foi(np.random.default_rng([5, i])) for i in range(count)]


def centroid(psf):
    at = np.arange(len(psf)) - len(psf) // 2
    return at @ psf.sum(axis=1), at @ psf.sum(axis=0)


def test_delta_is_no_motion():
    psf = delta()
    assert psf.sum() == psf[32, 32] == 1
    assert mnc(psf, psf) == pytest.approx(1)
    assert mnc_subpixel(psf, psf) == pytest.approx(1)


def test_delta_scores_the_peak_over_the_norm():
    for motion in walks(5):
        psf = motion.psf()
        assert mnc(delta(), psf) == pytest.approx(psf.max() / np.linalg.norm(psf))


def test_gaussian_is_round_centred_and_as_wide_as_asked():
    psf = gaussian(3.0)
    assert psf.sum() == pytest.approx(1)
    assert centroid(psf) == pytest.approx((0, 0), abs=1e-9)
    at = np.arange(64) - 32
    assert at**2 @ psf.sum(axis=0) == pytest.approx(9, rel=1e-3)
    np.testing.assert_allclose(psf, psf.T)


def test_a_blob_scores_high_on_random_walks():
    """0.549 over many (reference, section 0.2); 20 leave a standard error of 0.02."""
    assert np.mean([mnc(gaussian(), motion.psf()) for motion in walks()]) == pytest.approx(
        0.55, abs=0.07
    )


def test_the_mean_of_motions_is_centred_and_beats_a_blob_on_its_own_kind():
    mean = mean_psf([boracchi_foi(np.random.default_rng([7, i])).psf() for i in range(60)])
    assert mean.shape == (64, 64)
    assert mean.sum() == pytest.approx(1)
    assert centroid(mean) == pytest.approx((0, 0), abs=0.6)
    own, blob = (
        np.mean([mnc(floor, motion.psf()) for motion in walks()]) for floor in (mean, gaussian())
    )
    assert blob - 0.01 < own < 0.68


def test_the_mean_lays_motions_on_each_other():
    """Hand shake dwells off its centroid: a mean over centroids would be a blur and too easy to
    beat."""
    rates = ndimage.gaussian_filter1d(
        np.random.default_rng(0).standard_normal((1200, 3)), 10, axis=0
    )
    mix = MotionMix(boracchi_foi=0.0, gyro=1.0, gyro_trace="below", min_extent_px=20.0)
    trace = GyroTrace(np.arange(1200) / 200, rates)
    psfs, others = (
        [draw_motion(mix, np.random.default_rng([seed, i]), trace).psf() for i in range(60)]
        for seed in (6, 1)
    )
    centroids_laid, laid = (
        np.mean([mnc(m, psf) for psf in psfs]) for m in (np.mean(psfs, axis=0), mean_psf(others))
    )
    assert laid > centroids_laid + 0.03


def test_a_perfect_map_forgets_dwell_only():
    even = Trajectory.straight(24.0, angle_rad=0.4)
    assert mnc_subpixel(path_kernel(even), even.psf()) > 0.93
    t = np.linspace(0, 1, 200)
    uneven = Trajectory.from_samples(even.at(t**3), t=t)
    np.testing.assert_array_equal(even.hr_map().sum(), uneven.hr_map().sum())
    assert mnc_subpixel(path_kernel(uneven), uneven.psf()) < 0.85
    assert np.mean([mnc(path_kernel(m), m.psf()) for m in walks()]) == pytest.approx(
        0.99, abs=0.01
    )


def test_the_mean_is_a_floor_where_it_is_known():
    assert list(floors()) == ["delta", "gaussian"]
    assert list(floors(gaussian())) == ["delta", "gaussian", "mean-kernel"]


def test_a_quadratic_motion_is_its_own_best_quadratic():
    motion = Trajectory.straight(5.0)
    assert mnc_subpixel(quadratic_kernel(motion), motion.psf()) == pytest.approx(1)
