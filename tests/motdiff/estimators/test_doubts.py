"""Doubts about an estimate: none where it is right, no motion where there is none, and one
sentence for each doubt. Widths of edges: of known steps, of photos blurred by known kernels, and
of kernels themselves."""

import numpy as np
import pytest
from scipy import ndimage

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.doubts import doubted, edge_widths, kernel_edge_widths
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [12, 0], [20, 9]])


def discs(side=300, *, seed=0, count=40):
    """A scene of overlapping discs, with edges in all directions, as a lens shows it."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side]
    scene = np.full((side, side), 0.3)
    for _ in range(count):
        cy, cx = rng.uniform(0, side, 2)
        scene[(y - cy) ** 2 + (x - cx) ** 2 < rng.uniform(15, 45) ** 2] = rng.uniform(0.05, 0.9)
    return ndimage.gaussian_filter(scene, 0.5)


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


@pytest.mark.parametrize(("confidence", "shows_motion"), [(0.8, True), (0.3, False)])
def test_a_kernel_somewhat_wider_than_a_lenss_spot_is_one_only_where_the_search_is_lost(
    confidence, shows_motion
):
    """It gives edges 3 px wide, and the photo has some of 2 px; those of a Gaussian are
    sqrt(2 pi) sigma wide, a little more on pixels."""
    y, x = np.mgrid[-32:32, -32:32]
    spot = np.exp(-(x**2 + y**2) * np.pi / 2.4**2)
    sharp = ndimage.gaussian_filter(discs(), np.sqrt(1.9**2 / (2 * np.pi) - 0.5**2))
    found = judged(
        sharp, estimate_of(Trajectory.straight(3.0), confidence=confidence, psf=spot / spot.sum())
    )
    assert found.details.get("motion_blur", True) is shows_motion


# -- widths of edges ------------------------------------------------------------------------------


def test_a_gaussian_edge_is_as_wide_as_its_contrast_over_its_slope():
    for sigma in (1.0, 2.0):
        step = 0.2 + 0.5 * ndimage.gaussian_filter1d((np.arange(80) >= 40).astype(float), sigma)
        found = edge_widths([np.tile(step, (80, 1))])
        assert np.isfinite(found.widths_px).sum() == 1
        assert (
            found.sharpest_px
            == found.widest_px
            == pytest.approx(sigma * np.sqrt(2 * np.pi), rel=0.12)
        )
        assert not found.bound_motion  # a motion along them would not show


def test_a_motion_widens_the_edges_across_it_and_no_others():
    path = Trajectory.straight(12.0)
    found = edge_widths([blur_valid(discs(), path.psf(33))])
    sharp = edge_widths([discs()])
    assert sharp.widest_px < 2.6
    assert sharp.bound_motion
    assert found.bound_motion
    assert found.widths_px[[0, 7]].min() > 6  # normals along the motion
    assert np.nanmin(found.widths_px[3:5]) < 2.6


@pytest.mark.parametrize(
    "path", [[[0, 0], [9, 4]], [[0, 0], [12, 0], [12, 8]], [[0, 0], [5, 5], [14, 5], [8, -4]]]
)
def test_a_kernel_s_widths_are_those_of_the_photo_that_it_blurs(path):
    psf = Trajectory.from_samples(path).psf(41)
    found = edge_widths([blur_valid(discs(seed=s), psf) for s in (1, 2)])
    sharp = edge_widths([discs()])
    assert 0.6 < found.share_of(kernel_edge_widths(psf, found.normals_rad)) < 1.15
    assert sharp.share_of(kernel_edge_widths(psf, sharp.normals_rad)) < 0.5


def test_noise_is_no_edge():
    rng = np.random.default_rng(0)
    grainy = edge_widths([discs() + 0.01 * rng.standard_normal((300, 300))])
    clean = edge_widths([discs()])
    assert grainy.widest_px == pytest.approx(clean.widest_px, rel=0.2)
    for shape in ((100, 100), (48, 300)):
        nothing = edge_widths([rng.random(shape)])
        assert nothing.counts.sum() < 6
        assert np.isnan(nothing.sharpest_px)
        assert np.isnan(nothing.widest_px)
        assert np.isnan(nothing.share_of(np.ones(8)))
        assert not nothing.bound_motion


def test_light_scales_nothing():
    photo = discs()
    np.testing.assert_allclose(
        edge_widths([photo]).widths_px, edge_widths([0.5 * photo]).widths_px, rtol=0.05
    )
