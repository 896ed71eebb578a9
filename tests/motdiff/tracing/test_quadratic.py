import numpy as np
import pytest
from scipy import ndimage

from lab.evaluation.metrics import ordered_distance_px
from motdiff.metrics import mnc_subpixel
from motdiff.motions import boracchi_foi, quadratic, random_straight
from motdiff.tracing.path import trace_psf_to_trajectory
from motdiff.tracing.quadratic import (
    QuadraticPath,
    _overlap,
    quadratic_of_psf,
    simplest_trajectory,
)
from motdiff.trajectory import Trajectory


def blotchy(psf, seed, share=0.25):
    """A kernel as blind estimates are: uneven along the path, and wider in places."""
    rng = np.random.default_rng(seed)
    uneven = psf * ndimage.gaussian_filter(rng.random(psf.shape), 1) ** 2
    around = ndimage.gaussian_filter(psf, 1.2) * (rng.random(psf.shape) > 0.5)
    kernel = (1 - share) * uneven / uneven.sum() + share * around / around.sum()
    kernel[kernel < 0.05 * kernel.max()] = 0
    return kernel / kernel.sum()


def psf_of(path):
    return path.psf(max(64, path.frame_size()))


def centred(path):
    points = path.at(np.linspace(0, 1, 200))
    return points - points.mean(axis=0)


@pytest.mark.parametrize("seed", range(12))
def test_the_quadratic_path_of_a_quadratic_paths_psf_is_that_path(seed):
    rng = np.random.default_rng(seed)
    truth = (
        quadratic(rng, min_length_px=8, max_length_px=60)
        if seed % 3
        else random_straight(rng, max_length_px=60)
    )
    found = quadratic_of_psf(psf_of(truth)).trajectory()
    assert mnc_subpixel(psf_of(found), psf_of(truth)) > 0.99
    assert found.length_px == pytest.approx(truth.length_px, rel=0.05, abs=0.5)
    assert (
        ordered_distance_px(centred(found), centred(truth)) < 0.5
    )  # in order, or wholly reversed


@pytest.mark.parametrize("seed", range(6))
def test_blotches_do_not_lengthen_a_plain_motion(seed):
    truth = quadratic(np.random.default_rng(seed), min_length_px=20, max_length_px=40)
    kernel = blotchy(psf_of(truth), seed)
    found = simplest_trajectory(kernel)
    assert found.length_px == pytest.approx(truth.length_px, rel=0.2)
    assert ordered_distance_px(centred(found), centred(truth)) < 1.5
    assert found.direction == "unknown"


def test_the_overlap_of_points_falls_along_its_gradient():
    rng = np.random.default_rng(5)
    points = rng.normal(size=(4, 2))
    targets = rng.normal(size=(6, 2))
    weight = rng.dirichlet(np.ones(6))
    mean, gradient = _overlap(points, targets, weight, 2.5)
    distance2 = np.square(points[:, None] - targets).sum(axis=2)
    assert mean == pytest.approx((np.exp(-distance2 / 2.5) @ weight).mean())
    for index in np.ndindex(points.shape):
        moved = np.zeros_like(points)
        moved[index] = 1e-5
        ahead, behind = (
            _overlap(points + step, targets, weight, 2.5)[0] for step in (moved, -moved)
        )
        assert gradient[index] == pytest.approx((ahead - behind) / 2e-5, rel=1e-6)


def test_a_tangle_is_traced_as_before():
    psf = boracchi_foi(np.random.default_rng(3)).psf(64)
    np.testing.assert_array_equal(simplest_trajectory(psf).xy, trace_psf_to_trajectory(psf).xy)


def test_a_point_has_a_path():
    psf = np.zeros((15, 15))
    psf[7, 7] = 1
    assert simplest_trajectory(psf).length_px < 1


@pytest.mark.parametrize(
    "bad", [np.zeros((5, 5)), np.ones(7), np.full((5, 5), np.nan), -np.ones((5, 5))]
)
def test_no_path_of_what_is_no_psf(bad):
    with pytest.raises(ValueError, match="psf: must be a finite, non-negative"):
        quadratic_of_psf(bad)


def test_turned_psfs_have_turned_paths():
    truth = Trajectory.from_samples([[0, 0], [8, 1], [15, 4], [20, 9]])
    psf = psf_of(truth)[1:, 1:]  # odd: a quarter turn about its middle pixel
    upright, turned = (quadratic_of_psf(p).trajectory() for p in (psf, np.rot90(psf)))
    assert turned.length_px == pytest.approx(upright.length_px, rel=1e-2)


@pytest.mark.parametrize("bad", [[1.0], [1.0, 2.0, 3.0], [5.0, np.nan], [np.inf, 0.0]])
def test_a_quadratic_path_needs_two_finite_numbers_each(bad):
    with pytest.raises(ValueError, match="a: must be two finite numbers"):
        QuadraticPath(bad, [0.0, 0.0])
    with pytest.raises(ValueError, match="b: must be two finite numbers"):
        QuadraticPath([5.0, 0.0], bad)
