"""Scores of kernels: evidence prepared once as one by one, and probabilities."""

import numpy as np
import pytest
from dead_leaves import dead_leaves
from scipy import special

from motdiff.estimators.kernel_score import (
    Judge,
    Phase,
    Spectrum,
    distinct,
    kernel_score,
    rank_kernels,
)
from motdiff.metrics import mnc_matrix
from motdiff.photo_noise import noise_sigma
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
        radius = 3 / rng.uniform(0.05, 1)
        cx = rng.uniform(0, width + 32)
        cy = rng.uniform(0, height + 32)
        sharp[(x - cx) ** 2 + (y - cy) ** 2 < radius**2] = rng.uniform(0.05, 0.95)
    photo = blur_valid(sharp, motion.psf(33))
    return np.clip(photo + rng.normal(0, 0.005, photo.shape), 0, 1)


@pytest.fixture(scope="module")
def crops():
    return np.stack([photo_of(bent(), 96, 112, seed=seed) for seed in (1, 2, 3)])


def test_evidence_is_that_of_every_kernel_in_every_crop_alone(crops):
    judge = Judge(crops)
    assert judge.sigma == np.median([noise_sigma(crop) for crop in crops])
    kernels = [
        bent().psf(31),
        bent().psf(31)[::-1, ::-1],
        STRAIGHT.psf(63),
        np.full((5, 5), 1 / 25),
    ]
    evidence = judge.evidence(kernels)
    assert evidence.shape == (4, 3)
    for kernel, (fit, phase, rim) in zip(kernels, evidence, strict=True):
        assert fit == pytest.approx(
            np.mean([Spectrum(crop, sigma=judge.sigma).fit(kernel) for crop in crops])
        )
        assert phase == pytest.approx(
            np.mean([Phase(crop, sigma=judge.sigma).evidence(kernel) for crop in crops])
        )
        assert rim == pytest.approx(1 - kernel[1:-1, 1:-1].sum())
    np.testing.assert_array_equal(
        judge.evidence(kernels[::-1]), evidence[::-1]
    )  # nothing is kept in between
    assert evidence[0, 0] == pytest.approx(
        evidence[1, 0], abs=1e-9
    )  # reflections have the same spectrum
    assert evidence[0, 1] == pytest.approx(
        -evidence[1, 1], abs=1e-6
    )  # and opposite phases (in single precision)
    assert evidence[0, 1] > 0.01
    assert evidence[3, 2] == pytest.approx(16 / 25)


def test_the_classical_ranking_is_by_score(crops):
    kernels = [STRAIGHT.psf(31), bent().psf(31), bent().psf(63), np.full((5, 5), 1 / 25)]
    ranking = rank_kernels(crops, kernels)
    alike = mnc_matrix(kernels)
    agreement = (alike.sum(axis=1) - 1) / 3  # with the three others
    assert ranking.agreement == pytest.approx(agreement[ranking.best])
    scores = kernel_score(Judge(crops).evidence(kernels), agreement)
    assert ranking.best == int(np.argmax(scores)) in (1, 2)
    log_odds = special.logit(ranking.probabilities)
    np.testing.assert_allclose(np.polyval(np.polyfit(scores, log_odds, 1), scores), log_odds)
    assert log_odds[ranking.best] > log_odds[0]


def test_score_rises_with_the_evidence_and_agreement_and_falls_with_light_on_the_rim():
    fit, phase, rim = kernel_score(np.eye(3))
    assert min(fit, phase) > 0 > rim
    rows = np.random.default_rng(0).normal(size=(20, 3))
    np.testing.assert_allclose(kernel_score(rows), rows @ [fit, phase, rim])
    assert (kernel_score(rows, 0.5) > kernel_score(rows)).all()


def test_the_photo_believes_the_truth_and_not_what_is_lost(crops):
    truth = bent().psf(63)
    lost = STRAIGHT.psf(63).T
    blob = np.exp(-0.5 * (np.mgrid[-31:32, -31:32] ** 2).sum(axis=0) / 16)
    kernels = [truth, truth[::-1, ::-1], lost, blob / blob.sum()]
    ranking = rank_kernels(crops, kernels)
    assert ranking.best == 0
    assert ranking.probabilities[0] > 0.6
    assert ranking.probabilities[2:].max() < 0.4


def test_distinct_kernels_are_chosen_in_order():
    straight, longer, upright = (
        Trajectory.straight(length, angle_rad=angle).psf(63)
        for length, angle in ((12, 0), (13, 0), (12, 1.5))
    )
    alike = mnc_matrix([straight, longer, upright, straight, np.eye(63) / 63])
    order = np.array([3, 1, 2, 0, 4])
    assert distinct(alike, [3], order, count=3) == [3, 2, 4]
    assert distinct(alike, [3], order, count=2) == [3, 2]
    assert distinct(alike, [4, 0], order, count=4) == [4, 0, 2]
    assert distinct(alike, [0, 1], order, count=4) == [
        0,
        1,
        2,
        4,
    ]  # the first ones even if they are alike


@pytest.fixture
def scene():
    return dead_leaves(200, 3)


def curved(size=25):
    t = np.linspace(0, 1, 60)
    return Trajectory.from_samples(np.c_[14 * t, 8 * np.sin(2.5 * t)], t=t**1.3).psf(size)


def test_spectrum_and_phase_tell_the_kernel_from_lost_ones(scene):
    psf = curved(25)
    photo = blur_valid(scene, psf) + np.random.default_rng(9).normal(0, 0.005, (176, 176))
    spectrum = Spectrum(photo, sigma=0.005)
    phase = Phase(photo, sigma=0.005)
    right = spectrum.fit(psf)
    gaussian = np.exp(-0.5 * (np.mgrid[-12:13, -12:13] ** 2).sum(axis=0) / 9)
    assert right > 0.5
    assert right > spectrum.fit(gaussian / gaussian.sum()) + 0.2
    assert right > spectrum.fit(psf.T) + 0.2
    assert right == pytest.approx(spectrum.fit(psf[::-1, ::-1]), abs=1e-9)  # no phase in it
    assert phase.evidence(psf) > 0.02
    assert phase.evidence(psf[::-1, ::-1]) < -0.02


@pytest.mark.parametrize("period_px", [2, 8, 32])
def test_stripes_leave_frequencies_without_power(period_px):
    """Their powers, of rounding alone, are negative where they are summed up."""
    stripes = np.tile(np.arange(256) % period_px < period_px / 2, (256, 1)) * 0.5 + 0.2
    board = np.indices((128, 128)).sum(axis=0) % 2 * 0.5 + 0.2
    kernel = Trajectory.straight(9.0).psf(15)
    for pattern in (stripes, board):
        assert -1 <= Spectrum(pattern, sigma=0.0).fit(kernel) <= 1


@pytest.mark.parametrize(("contrast", "level"), [(1.0, 0.0), (1e-6, 0.9)])
def test_evidence_in_single_precision_is_that_in_double(scene, contrast, level):
    """The formulas in double precision, for a plain photo and for one whose contrast single
    precision hardly holds."""
    psf = curved(25)
    photo = (
        contrast * (blur_valid(scene, psf) + np.random.default_rng(9).normal(0, 0.005, (176, 176)))
        + level
    )
    sigma = 0.005 * contrast
    energy = np.mean(np.diff(photo, axis=0) ** 2) + np.mean(np.diff(photo, axis=1) ** 2)
    padded = np.pad(photo - photo.mean(), 32, mode="symmetric")
    radius2 = np.fft.fftfreq(240)[:, None] ** 2 + np.fft.rfftfreq(240)[None, :] ** 2
    penalty = 40 * max(sigma, 2e-3) ** 2 / max(energy - 4 * sigma**2, 1e-6) * radius2 + 1e-12
    frame = np.zeros((240, 240))
    frame[:25, :25] = psf
    transfer = np.fft.rfft2(np.roll(frame, (-12, -12), axis=(0, 1)))
    sparsities = []
    for response in (transfer, transfer.conj()):
        restored = np.fft.irfft2(
            np.fft.rfft2(padded) * response.conj() / (np.abs(transfer) ** 2 + penalty)
        )
        inner = restored[40:-40, 40:-40]
        energies = np.concatenate([np.diff(inner, axis=axis).ravel() ** 2 for axis in (0, 1)])
        sparsities.append(
            np.mean(energies**0.4) / np.mean(energies) ** 0.4
        )  # 0.8-norm over 2-norm
    expected = np.log(sparsities[1] / sparsities[0])
    assert Phase(photo, sigma=sigma).evidence(psf) == pytest.approx(expected, abs=2e-6)
