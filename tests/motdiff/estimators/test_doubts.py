"""Doubts about an estimate: none where it is right, no motion where there is none, and one
sentence for each doubt."""

import numpy as np
import pytest

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.doubts import doubted
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory
from tests.motdiff.estimators.test_edge_widths import discs

BENT = Trajectory.from_samples([[0, 0], [12, 0], [20, 9]])


def estimate_of(path, *, confidence=0.8, psf=None):
    details = {"psf_confidence": confidence, "path_confidence": 0.9 * confidence, "searched": "so"}
    light = path.psf(64) if psf is None else psf
    return MotionEstimate("fake", (path,), (1.0,), light, confidence, ("said before",), details)


def judged(photo, estimate, *, uneven=False, outgrown=False):
    return doubted(estimate, photo[None], uneven=uneven, outgrown=outgrown)


@pytest.mark.parametrize("sigma", [0.0, 0.01])
@pytest.mark.parametrize(
    "path", [BENT, Trajectory.straight(9.0), Trajectory.straight(40.0, angle_rad=1.0)]
)
def test_a_right_estimate_keeps_its_confidence(path, sigma):
    blurred = blur_valid(discs(), path.psf(65))
    photo = blurred + sigma * np.random.default_rng(0).standard_normal(blurred.shape)
    found = judged(photo, estimate_of(path))
    assert found.confidence == found.details["psf_confidence"] == 0.8
    assert found.details["path_confidence"] == pytest.approx(0.72)
    assert found.details["searched"] == "so"
    assert found.warnings == ("said before",)
    assert found.best is path


@pytest.mark.parametrize("path", [BENT, Trajectory.straight(60.0), Trajectory.straight(1.0)])
@pytest.mark.parametrize("sigma", [0.0, 0.01])
def test_a_sharp_photo_shows_no_motion_whatever_was_found_in_it(path, sigma):
    photo = discs() + sigma * np.random.default_rng(0).standard_normal((300, 300))
    found = judged(photo, estimate_of(path))
    assert found.best.length_px == 0
    assert found.psf[32, 32] == found.psf.sum() == 1
    assert found.confidence == 0.9
    assert found.details["motion_blur"] is False
    assert found.details["sharpest_edges_px"] < 2
    (said,) = found.warnings
    assert said.startswith("This photo shows no motion blur (its sharpest edges are 1.")
    assert said.endswith(" px wide)")
    assert found.psf_warnings == found.warnings


def test_edges_of_one_direction_contradict_a_path_but_prove_nothing():
    stripes = np.tile(
        np.kron(np.random.default_rng(0).uniform(0.1, 0.9, 15), np.ones(20)), (300, 1)
    )
    found = judged(stripes, estimate_of(Trajectory.straight(30.0)))
    assert found.best.length_px == 30
    assert found.confidence == 0.25
    assert (
        "px wide, which a motion along the path found would have blurred to" in found.warnings[-1]
    )
    along = judged(stripes, estimate_of(Trajectory.straight(30.0, angle_rad=np.pi / 2)))
    assert along.confidence == 0.8


def test_each_doubt_is_a_sentence_and_lowers_the_confidence():
    photo = blur_valid(discs(), BENT.psf(65))
    right = estimate_of(BENT)
    assert judged(photo, right, uneven=True).confidence == 0.5  # its sentence is the estimator's
    wide = judged(photo, right, outgrown=True)
    assert wide.confidence == 0.5
    assert wide.warnings[-1].startswith("the path found is as wide as the search reaches (20 px)")
    clipped = judged(np.minimum(photo * 1.25, 1), right)
    assert 0.5 < clipped.confidence < 1
    assert clipped.details["psf_confidence"] == clipped.confidence
    assert "% of the pixels searched are clipped" in clipped.warnings[-1]
    flat = judged(0.5 + 0.01 * np.random.default_rng(0).random((200, 200)), right)
    assert flat.confidence == 0.25
    assert flat.warnings[-1] == "the photo has too few steep edges for its motion to show in them"
    assert flat.psf_warnings == flat.warnings[1:]


def test_a_round_spot_is_a_psf_but_no_path():
    y, x = np.mgrid[-32:32, -32:32]
    spot = np.exp(-(x**2 + y**2) / (2 * 2.5**2))
    spot /= spot.sum()
    photo = blur_valid(discs(), spot[:63, :63] / spot[:63, :63].sum())
    found = judged(photo, estimate_of(Trajectory.straight(20.0), psf=spot))
    assert found.details["psf_confidence"] == 0.8
    assert found.confidence == found.details["path_confidence"] == 0.25
    assert "round spot" in found.warnings[-1]
    assert found.psf_warnings == ()


def test_a_spot_found_in_a_photo_of_wide_edges_is_lost_and_no_proof():
    photo = blur_valid(discs(), Trajectory.from_samples([[0, 0], [12, 0], [12, 12]]).psf(65))
    found = judged(photo, estimate_of(Trajectory.straight(2.0), confidence=0.3))
    assert found.best.length_px == 2
    assert found.confidence == 0.25
    assert "motion_blur" not in found.details
