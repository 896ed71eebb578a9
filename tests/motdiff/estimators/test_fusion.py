"""Fusion of photos of one motion, with searches whose answers are known: what is chosen, and what
is left out."""

import numpy as np
import pytest

from motdiff.blind_search.coarse_to_fine import Start
from motdiff.estimators.base import FoundKernels
from motdiff.estimators.fusion import cut_alike, fuse
from motdiff.estimators.pmp.estimator import PmpEstimator
from motdiff.metrics import mnc_subpixel
from motdiff.simulate import photograph
from motdiff.trajectory import Trajectory

ACROSS, DOWN = (Trajectory.straight(11, angle_rad=angle).psf(27) for angle in (0.2, 1.7))
POINT = Trajectory.straight(0).psf(27)


def photo(psf, seed, *, side=120):
    rng = np.random.default_rng(seed)
    scene = 0.1 + 0.8 * np.kron(rng.random((40, 40)), np.ones((6, 6)))
    return photograph(scene, psf, rng=rng, read_sigma=0.005)[:side, :side]


def found(psf, confidence=0.9):
    return FoundKernels((psf, POINT), np.array([confidence, 0.1]), 0, {"starts": 2})


class Search:
    """Finds the same kernel in any crops; notes how many there were."""

    def __init__(self, psf):
        self.psf = psf
        self.seen = []

    def __call__(self, crops):
        self.seen.append(len(crops))
        return found(self.psf, 0.6)


def fused(psfs, *, own=None, joint=ACROSS, refine=lambda _crops, kernel: kernel):
    crops = [photo(psf, i)[None] for i, psf in enumerate(psfs)]
    search = Search(joint)
    return fuse(crops, [found(psf) for psf in own or psfs], search=search, refine=refine), search


def test_photos_of_one_motion_are_all_kept():
    result, search = fused([ACROSS] * 3)
    assert (result.photos, result.left_out, search.seen) == ((0, 1, 2), (), [3])
    assert result.repeatability == pytest.approx((1, 1, 1))
    assert result.crops.shape == (3, 120, 120)
    assert result.joint.warnings == ()


def test_the_minority_that_shows_another_motion_is_left_out_and_the_others_searched_again():
    result, search = fused([ACROSS, DOWN, ACROSS, ACROSS])
    assert (result.photos, result.left_out, search.seen) == ((0, 2, 3), (1,), [4, 3])
    assert result.repeatability[1] < 0.6 < min(result.repeatability[i] for i in result.photos)
    assert result.joint.warnings == (
        (
            f"photo 2 shows another motion (MNC {result.repeatability[1]:.2f} with the others):"
            " left out"
        ),
    )
    assert result.joint.confidence > 0.5


@pytest.mark.parametrize("psfs", [[ACROSS, DOWN], [ACROSS, DOWN, ACROSS, DOWN]])
def test_without_a_majority_none_is_left_out_and_the_estimate_is_doubted(psfs):
    result, _ = fused(psfs)
    assert (len(result.photos), result.left_out) == (len(psfs), ())
    (said,) = result.joint.warnings
    assert "may show another motion, but no majority agrees" in said
    assert result.joint.confidence <= 0.5


def test_a_photo_that_is_lost_alone_is_no_other_motion():
    """Its own kernel is unlike the shared one, but explains it no better."""
    result, _ = fused([ACROSS] * 3, own=[ACROSS, ACROSS, DOWN])
    assert result.left_out == ()
    assert result.repeatability[2] < 0.7


def test_the_kernel_of_a_photo_takes_the_place_of_a_joint_search_that_is_lost():
    result, _ = fused([ACROSS] * 3, joint=DOWN)
    assert mnc_subpixel(result.joint.best_kernel, ACROSS) == pytest.approx(1)
    assert (result.joint.best, result.joint.confidence) == (0, 0.9)
    assert result.joint.details["fused_by"] == "kernel of one photo"


def test_the_kernel_of_a_photo_is_also_tried_refined_on_all():
    result, _ = fused(
        [ACROSS] * 3,
        own=[DOWN] * 3,
        joint=DOWN,
        refine=lambda crops, _: ACROSS if len(crops) == 3 else 0,
    )
    assert mnc_subpixel(result.joint.kernels[0], ACROSS) == pytest.approx(1)
    assert result.joint.details["fused_by"] == "kernel of one photo, refined on all"


def test_photos_are_cut_about_their_middles_to_one_size():
    large = np.arange(12.0)[None, :, None] * np.ones((2, 1, 14))
    small = np.zeros((1, 10, 20))
    cut = cut_alike([large, small])
    assert [one.shape for one in cut] == [(2, 10, 14), (1, 10, 14)]
    np.testing.assert_array_equal(cut[0][0, :, 0], np.arange(1, 11))


def test_a_photo_much_smaller_than_another_is_refused_by_its_number():
    with pytest.raises(
        ValueError, match=r"^photo 2: is too small .* needs 50 px on a side, got 48"
    ):
        cut_alike([np.zeros((1, 100, 100)), np.zeros((1, 48, 100))])


def test_two_photos_of_poor_scenes_show_together_what_neither_shows_alone():
    """Stripes hide the motion along them: upright ones in one photo, level ones in the other."""
    rng = np.random.default_rng(2)
    path = Trajectory.from_samples([[0, 0], [7, 0], [7, 7]])
    stripes = 0.1 + 0.8 * np.repeat(rng.random(30), 5)
    faint = 0.02 * rng.standard_normal((2, 150, 150))
    shots = [
        photograph(np.clip(scene, 0, 1), path.psf(27), rng=rng, read_sigma=0.002)
        for scene in (
            stripes + np.zeros((150, 1)) + faint[0],
            stripes[:, None] + np.zeros(150) + faint[1],
        )
    ]
    estimator = PmpEstimator(starts=(Start(19),))
    alone = [mnc_subpixel(estimator.estimate(shot).psf, path.psf(27)) for shot in shots]
    together = estimator.estimate_from(shots)
    assert mnc_subpixel(together.psf, path.psf(27)) > 0.05 + max(alone)
