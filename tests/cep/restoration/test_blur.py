"""The blur as an operator: adjoint, closed forms, borders."""

import numpy as np
import pytest
from scipy import fft, ndimage

from cep.restoration.blur import Blur, power_law
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

PSF = Trajectory.from_samples([[0, 0], [8, 1], [12, 9]]).psf(33)


@pytest.mark.parametrize("border", ["real", "periodic"])
@pytest.mark.parametrize("shape", [(40, 51), (40, 50)])
def test_the_adjoint_has_the_dot_products_of_the_blur(border, shape):
    rng = np.random.default_rng(0)
    blur = Blur(PSF, shape, border)
    scene = rng.standard_normal(blur.grid_shape)
    photo = rng.standard_normal(shape)
    assert np.sum(blur.A(scene) * photo) == pytest.approx(np.sum(scene * blur.A_adjoint(photo)))


def test_the_otf_of_a_box_is_a_dirichlet_kernel():
    blur = Blur(np.full((1, 5), 0.1), (8, 40), "periodic")
    f = np.fft.rfftfreq(40)[1:]
    H = 0.1 * np.sin(5 * np.pi * f) / np.sin(np.pi * f)
    assert blur.H[0, 0] == pytest.approx(0.5)
    np.testing.assert_allclose(blur.H[:, 1:], np.tile(H, (8, 1)), atol=1e-12)


def test_a_point_draws_the_psf_around_it():
    blur = Blur(PSF, (60, 60), "periodic")
    point = np.zeros((60, 60))
    point[30, 30] = 1
    np.testing.assert_allclose(blur.A(point)[14:47, 14:47], PSF, atol=1e-12)


def test_a_periodic_photo_may_be_smaller_than_the_psf():
    """Light that leaves on one side comes in on the other, more than once."""
    psf = Trajectory.straight(20.0).psf(33)
    scene = np.random.default_rng(0).random((11, 14))
    blurred = Blur(psf, scene.shape, "periodic").A(scene)
    np.testing.assert_allclose(blurred, ndimage.convolve(scene, psf, mode="wrap"), atol=1e-12)


def test_no_light_wraps_around_into_a_photo_with_real_borders():
    rng = np.random.default_rng(0)
    blur = Blur(PSF, (40, 51))
    scene = rng.random(blur.grid_shape)
    reach = blur.reach_px
    inside = blur.A(scene)[reach : 40 - reach, reach : 51 - reach]
    valid = blur_valid(blur.crop(scene), blur.psf)
    np.testing.assert_allclose(inside, valid, atol=1e-12)
    dark = np.zeros(blur.grid_shape)
    blur.crop(dark)[:] = scene[:40, :51]
    direct = ndimage.convolve(dark[:40, :51], blur.psf, mode="constant")
    np.testing.assert_allclose(blur.A(dark), direct, atol=1e-12)


def test_the_extension_solves_the_masked_least_squares():
    """Compared with the dense normal equations."""
    photo = np.random.default_rng(0).random((5, 6))
    ratio = 0.3
    blur = Blur(np.outer([0.2, 0.5, 0.1], [0.3, 0.6, 0.2]), photo.shape)
    shape = blur.grid_shape
    units = np.eye(shape[0] * shape[1]).reshape(-1, *shape)
    A = np.stack([blur.A(unit).ravel() for unit in units], axis=1)
    penalty = ratio * power_law(shape)
    prior = np.stack([fft.irfft2(penalty * fft.rfft2(unit), shape).ravel() for unit in units])
    scene = np.linalg.solve(A.T @ A + prior, A.T @ photo.ravel()).reshape(shape)
    expected = blur.image(blur.H * blur.spectrum(scene))
    extended = blur.extend(photo, noise_to_scene=ratio, rounds=500)
    np.testing.assert_array_equal(blur.crop(extended), photo)
    blur.crop(expected)[:] = photo
    np.testing.assert_allclose(extended, expected, atol=1e-6)


def test_a_periodic_photo_needs_no_extension():
    photo = np.random.default_rng(0).random((40, 50))
    assert Blur(PSF, photo.shape, "periodic").extend(photo, rounds=10) is photo


@pytest.mark.parametrize("border", ["real", "periodic"])
def test_the_nearest_scene_solves_the_normal_equations(border):
    """``(A^T A + a) x = A^T y + a z`` holds, as a small case shows with the operator itself."""
    rng = np.random.default_rng(0)
    psf = Trajectory.straight(3.0).psf(7)
    blur = Blur(psf, (9, 10), border)
    photo = rng.random((9, 10))
    z = rng.random(blur.grid_shape)
    x = blur.nearest(photo, z, 0.05, rounds=200)
    residual = blur.A_adjoint(blur.A(x) - photo) + 0.05 * (x - z)
    np.testing.assert_allclose(residual, 0, atol=1e-8)


def test_five_rounds_are_nearer_than_none():
    rng = np.random.default_rng(0)
    scene = ndimage.gaussian_filter(rng.random((80, 80)), 2)
    blur = Blur(PSF, (48, 48), "real")
    photo = blur_valid(scene, PSF)
    z = np.zeros(blur.grid_shape)

    def cost(rounds):
        x = blur.nearest(photo, z, 0.01, rounds=rounds)
        return np.sum((blur.A(x) - photo) ** 2) + 0.01 * np.sum(x**2)

    assert cost(5) < cost(0)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-7])
def test_the_nearest_scene_is_as_near_as_is_asked(tolerance):
    """Within an order of magnitude, as the error is judged by a preconditioner."""
    rng = np.random.default_rng(0)
    scene = ndimage.gaussian_filter(rng.random((80, 80)), 2)
    blur = Blur(PSF, (48, 48), "real")
    photo = blur_valid(scene, PSF)
    z = np.full(blur.grid_shape, scene.mean())
    exact = blur.nearest(photo, z, 0.01, rounds=500)
    x = blur.nearest(photo, z, 0.01, rounds=500, tolerance=tolerance)
    error = (np.sum(blur.A(x - exact) ** 2) + 0.01 * np.sum((x - exact) ** 2)) / x.size
    assert tolerance / 100 < error < 10 * tolerance


def test_single_precision_errs_by_its_rounding():
    rng = np.random.default_rng(0)
    photo = rng.random((48, 50))
    single, double = (Blur(PSF, photo.shape, dtype=dtype) for dtype in (np.float32, np.float64))
    z = rng.random(double.grid_shape)
    x = single.nearest(photo, z, 0.05, rounds=20)
    assert x.dtype == np.float32
    np.testing.assert_allclose(x, double.nearest(photo, z, 0.05, rounds=20), atol=1e-5)
