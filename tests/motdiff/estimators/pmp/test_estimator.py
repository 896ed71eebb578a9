"""The blind estimator as its users see it."""

import numpy as np
import pytest
from dead_leaves import dead_leaves

from motdiff.blind_search.coarse_to_fine import Start
from motdiff.estimators.pmp.estimator import PmpEstimator, planned
from motdiff.metrics import mnc_subpixel
from motdiff.progress import Progress
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

FEW = (Start(29), Start(21, sparsity=1.0))


@pytest.fixture(scope="module")
def shaken():
    """A blurred photo and its true PSF."""
    t = np.linspace(0, 1, 60)
    motion = Trajectory.from_samples(np.c_[10 * t, 6 * np.sin(2.5 * t)])
    psf = motion.psf(25)
    photo = blur_valid(dead_leaves(230, 1), psf)
    return np.clip(photo + np.random.default_rng(2).normal(0, 0.005, photo.shape), 0, 1), psf


@pytest.fixture(scope="module")
def estimate(shaken):
    return PmpEstimator(starts=FEW).estimate(shaken[0])


def test_finds_the_blur_of_a_simulated_photo(shaken, estimate):
    assert mnc_subpixel(estimate.psf, shaken[1]) > 0.85
    best = estimate.trajectories[0]
    assert mnc_subpixel(best.psf(), shaken[1]) > 0.75
    assert best.direction == "unknown"
    assert estimate.confidence > 0.5
    assert not estimate.psf_warnings


def test_what_it_returns_keeps_the_conventions(estimate):
    assert estimate.method == "pmp"
    assert estimate.psf.shape == (64, 64)
    assert estimate.psf.min() >= 0
    assert estimate.psf.sum() == pytest.approx(1)
    assert sum(estimate.weights) == pytest.approx(1)
    y, x = np.mgrid[:64, :64] - 32
    assert abs((estimate.psf * x).sum()) < 2
    assert abs((estimate.psf * y).sum()) < 2


def test_the_same_photo_gives_the_same_estimate(shaken, estimate):
    again = PmpEstimator(starts=FEW).estimate(shaken[0])
    np.testing.assert_array_equal(again.psf, estimate.psf)
    assert again.confidence == estimate.confidence


def test_colour_is_estimated_on_its_luminance(shaken, estimate):
    colour = PmpEstimator(starts=FEW).estimate(np.repeat(shaken[0][:, :, None], 3, axis=2))
    assert mnc_subpixel(colour.psf, estimate.psf) > 0.99


def test_a_photo_without_a_trace_of_the_blur_is_not_believed(shaken):
    noise = np.clip(np.random.default_rng(3).normal(0.5, 0.05, (200, 200)), 0, 1)
    lost = PmpEstimator(starts=FEW).estimate(noise)
    assert lost.confidence < 0.5
    assert any("lost" in warning for warning in lost.warnings)


def test_progress_rises_to_one(shaken):
    """Many small steps: nobody sees it stand still for the length of a search."""
    seen = []
    PmpEstimator(starts=FEW[:1], progress=seen.append).estimate(shaken[0])
    assert seen == sorted(seen)
    assert seen[-1] == 1
    assert np.diff([0, *seen]).max() < 0.2


@pytest.mark.parametrize(
    ("length_px", "likeness", "agree"),
    [(9.0, 1.0, True), (11.1, 0.94, True), (11.6, 0.92, False), (17.0, 0.76, False)],
)
def test_more_starts_are_run_only_where_the_first_two_disagree(
    monkeypatch, length_px, likeness, agree
):
    starts = (Start(29), Start(21), Start(25, quarter_turns=1), Start(31))
    motions = {s.size: Trajectory.straight(9.0 if s.size == 29 else length_px) for s in starts}
    assert mnc_subpixel(motions[29].psf(29), motions[21].psf(21)) == pytest.approx(
        likeness, abs=0.007
    )
    run = []

    def found(_self, _crops, start, *, on_progress):
        run.append(start)
        on_progress(0.5)
        on_progress(1.0)
        return motions[start.size].psf(start.size)

    monkeypatch.setattr(PmpEstimator, "_run", found)
    told = []
    progress = Progress(told.append)
    progress.expect(planned(len(starts)) + 1)
    kernels = PmpEstimator(starts=starts).kernels(np.zeros((1, 64, 64)), progress=progress)
    progress.spend(0.5)  # half of the one that is left, however many starts there were
    assert told[-1] == pytest.approx((1 + told[-2]) / 2)
    del told[-1]
    expected = starts[:2] if agree else starts
    assert sorted(start.size for start in run) == sorted(start.size for start in expected)
    assert [len(kernel) for kernel in kernels] == [start.size for start in expected]
    assert told == sorted(told)
    assert len(told) == 2 * len(expected)


@pytest.mark.parametrize(
    ("photo", "words"),
    [
        (np.full((100, 100), 0.4), "constant"),
        (np.random.default_rng(0).random((20, 300)), "at least 48 x 48"),
        (np.full((100, 100), np.nan), "finite"),
        (np.zeros(5), "shape"),
    ],
)
def test_unusable_photos_are_refused_in_one_line(photo, words):
    with pytest.raises(ValueError, match=words) as caught:
        PmpEstimator(starts=FEW).estimate(photo)
    assert "\n" not in str(caught.value)


def test_unusable_options_are_refused():
    with pytest.raises(ValueError, match="starts"):
        PmpEstimator(starts=())
    with pytest.raises(ValueError, match="crops"):
        PmpEstimator(crops=0)
