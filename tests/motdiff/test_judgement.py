"""The photo's verdict on kernels: prepared once as one by one, agreement by hand, and what is believed."""

import numpy as np
import pytest
from scipy import special

from motdiff.estimators.judge import Judge, kernel_features, noise_sigma, phase_evidence, spectral_fit
from motdiff.estimators.motdiff.judgement import FEATURES, features, probabilities
from motdiff.metrics import mnc_matrix, mnc_subpixel
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

STRAIGHT = Trajectory.straight(15.0, angle_rad=0.5)


def bent():
    t = np.linspace(0, 1, 50)
    return Trajectory.from_samples(np.c_[15.3 * t, 7.1 * np.sin(2.7 * t) + 3.3 * t], t=t**1.6)


def photo_of(motion, height, width, *, seed):
    """Dead leaves, blurred and a little noisy."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: height + 32, : width + 32]
    sharp = np.full(x.shape, 0.5)
    for _ in range(300):
        radius, cx, cy = 3 / rng.uniform(0.05, 1), rng.uniform(0, width + 32), rng.uniform(0, height + 32)
        sharp[(x - cx) ** 2 + (y - cy) ** 2 < radius**2] = rng.uniform(0.05, 0.95)
    photo = blur_valid(sharp, motion.psf(33))
    return np.clip(photo + rng.normal(0, 0.005, photo.shape), 0, 1)


@pytest.fixture(scope="module")
def crops():
    return np.stack([photo_of(bent(), 96, 112, seed=seed) for seed in (1, 2, 3)])


def test_evidence_is_that_of_every_kernel_in_every_crop_alone(crops):
    judge = Judge(crops)
    assert judge.sigma == np.median([noise_sigma(crop) for crop in crops])
    kernels = [bent().psf(31), bent().psf(31)[::-1, ::-1], STRAIGHT.psf(63), np.full((5, 5), 1 / 25)]
    evidence = judge.evidence(kernels)
    assert evidence.shape == (4, 3)
    for kernel, (fit, phase, rim) in zip(kernels, evidence, strict=True):
        assert fit == pytest.approx(np.mean([spectral_fit(crop, kernel, sigma=judge.sigma) for crop in crops]))
        assert phase == pytest.approx(np.mean([phase_evidence(crop, kernel, sigma=judge.sigma) for crop in crops]))
        assert rim == pytest.approx(1 - kernel[1:-1, 1:-1].sum())
    np.testing.assert_array_equal(judge.evidence(kernels[::-1]), evidence[::-1])  # nothing is kept in between
    assert evidence[0, 0] == pytest.approx(evidence[1, 0], abs=1e-9)  # reflections have the same spectrum
    assert evidence[0, 1] == pytest.approx(-evidence[1, 1], abs=1e-6)  # and opposite phases (in single precision)
    assert evidence[0, 1] > 0.01
    assert evidence[3, 2] == pytest.approx(16 / 25)


def test_the_classical_ranking_reads_the_same_evidence(crops):
    kernels = [bent().psf(31), STRAIGHT.psf(63), np.full((5, 5), 1 / 25)]
    table = kernel_features(crops, kernels)
    np.testing.assert_allclose(table[:, [0, 2, 3]], Judge(crops).evidence(kernels))


def test_agreement_by_hand():
    """Points and pairs of points: the MNC of a point with a pair is 1 / sqrt 2, of two different pairs 1 / 2."""
    point, across, down = np.zeros((3, 15, 15))
    point[7, 7] = 1
    across[7, 5], across[7, 10] = 0.5, 0.5
    down[4, 7], down[11, 7] = 0.5, 0.5
    kernels = [point, across, down, point, across]  # two samples, two classical ones, another
    evidence = np.arange(15.0).reshape(5, 3)
    table = features(evidence, mnc_matrix(kernels), samples=2, classical=2)
    assert table.shape == (5, len(FEATURES)) == (5, 5)
    np.testing.assert_array_equal(table[:, :3], evidence)
    r = np.sqrt(1 / 2)
    samples = [r, r, (r + 1 / 2) / 2, (1 + r) / 2, (r + 1) / 2]  # the first two without themselves
    classical = [(r + 1) / 2, (1 / 2 + r) / 2, r, r, (1 / 2 + r) / 2]
    np.testing.assert_allclose(table[:, 3:].T, [samples, classical], atol=1e-6)


def test_without_others_there_is_no_agreement():
    kernels = [STRAIGHT.psf(31), bent().psf(31)]
    one_sample = features(np.zeros((2, 3)), mnc_matrix(kernels), samples=1, classical=0)
    assert one_sample[0, 3:].tolist() == [0, 0]
    assert one_sample[1, 3] == pytest.approx(mnc_subpixel(*kernels), abs=0.03)
    assert one_sample[1, 4] == 0


def test_probabilities_rise_with_the_evidence_and_fall_with_light_on_the_rim():
    nothing = probabilities(np.zeros((1, 5)))[0]
    assert 0 < nothing < 0.1
    each = dict(zip(FEATURES, probabilities(np.eye(5)), strict=True))
    assert each.pop("rim_light") < nothing
    assert min(each.values()) > nothing
    assert probabilities(np.zeros((0, 5))).shape == (0,)


def test_every_feature_adds_to_the_log_odds_on_its_own():
    rows = 0.2 * np.random.default_rng(0).normal(size=(20, 5))
    log_odds = special.logit(probabilities(rows))
    np.testing.assert_allclose(log_odds, [special.logit(probabilities(row[None])[0]) for row in rows])
    start = special.logit(probabilities(np.zeros((1, 5)))[0])
    per_feature = special.logit(probabilities(0.1 * np.eye(5))) - start
    np.testing.assert_allclose(log_odds, start + 10 * rows @ per_feature)


def test_the_photo_believes_the_truth_and_not_what_is_lost(crops):
    truth, lost = bent().psf(63), STRAIGHT.psf(63).T
    blob = np.exp(-0.5 * (np.mgrid[-31:32, -31:32] ** 2).sum(axis=0) / 16)
    kernels = [truth, truth[::-1, ::-1], lost, blob / blob.sum()]
    believed = probabilities(features(Judge(crops).evidence(kernels), mnc_matrix(kernels), samples=4, classical=0))
    assert believed.argmax() == 0
    assert believed[0] > 0.7
    assert believed[2:].max() < 0.4
