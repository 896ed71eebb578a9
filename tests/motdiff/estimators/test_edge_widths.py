"""Widths of edges: of known steps, of photos blurred by known kernels, and of kernels
themselves."""

import numpy as np
import pytest
from scipy import ndimage

from motdiff.estimators.edge_widths import edge_widths, kernel_edge_widths
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory


def discs(side=300, *, seed=0, count=40):
    """A scene of overlapping discs, with edges in all directions, as a lens shows it."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side]
    scene = np.full((side, side), 0.3)
    for _ in range(count):
        cy, cx = rng.uniform(0, side, 2)
        scene[(y - cy) ** 2 + (x - cx) ** 2 < rng.uniform(15, 45) ** 2] = rng.uniform(0.05, 0.9)
    return ndimage.gaussian_filter(scene, 0.5)


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
