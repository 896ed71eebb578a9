"""The blur as an operator: adjoint, closed forms, borders."""

import numpy as np
import pytest
from scipy import fft, ndimage
from skimage import data

from cep.restoration.blur import Blur, extended_shape, membrane_extension, power_law
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

PSF = Trajectory.from_samples([[0, 0], [8, 1], [12, 9]]).psf(33)


def adjoint(blur, photo):
    return blur.image(blur.correlated(blur.spectrum(photo)))


@pytest.mark.parametrize("border", ["real", "periodic"])
@pytest.mark.parametrize("shape", [(40, 51), (40, 50)])
def test_the_adjoint_has_the_dot_products_of_the_blur(border, shape):
    rng = np.random.default_rng(0)
    blur = Blur(PSF, shape, border)
    scene = rng.standard_normal(blur.grid_shape)
    photo = rng.standard_normal(shape)
    assert np.sum(blur.A(scene) * photo) == pytest.approx(np.sum(scene * adjoint(blur, photo)))


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
    residual = adjoint(blur, blur.A(x) - photo) + 0.05 * (x - z)
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


@pytest.fixture(scope="module")
def photo():
    return ((data.camera() / 255.0) ** 2.2)[100:180, 90:190]


@pytest.mark.parametrize("psf_shape", [(1, 1), (17, 17), (1, 41), (41, 3)])
def test_extended_shape_leaves_a_gap_and_suits_the_fft(psf_shape):
    shape = extended_shape((97, 210), psf_shape)
    for side, reach, size in zip((97, 210), psf_shape, shape, strict=True):
        assert size - side >= reach - 1
        assert fft.next_fast_len(size, real=True) == size


def test_membrane_keeps_the_photo_and_is_harmonic_in_each_tile(photo):
    height, width = photo.shape
    extended = membrane_extension(photo, (100, 120))
    np.testing.assert_array_equal(extended[:height, :width], photo)
    laplacian = (
        sum(np.roll(extended, s, a) for s, a in ((1, 0), (-1, 0), (1, 1), (-1, 1))) - 4 * extended
    )
    for rows, columns in (
        (slice(height, None), slice(1, width - 1)),
        (slice(1, height - 1), slice(width, None)),
        (slice(height, None), slice(width, None)),
    ):
        assert np.abs(laplacian[rows, columns]).max() < 1e-9
    assert photo.min() <= extended.min()
    assert extended.max() <= photo.max()


def test_membrane_steps_across_the_seam_are_as_small_as_inside(photo):
    extended = membrane_extension(photo, (100, 120))
    around = (
        np.abs(extended[0] - extended[-1]).mean(),
        np.abs(extended[:, 0] - extended[:, -1]).mean(),
    )
    naive = np.abs(photo[0] - photo[-1]).mean(), np.abs(photo[:, 0] - photo[:, -1]).mean()
    assert max(around) < 0.3 * min(naive)


def test_no_gap_changes_nothing(photo):
    np.testing.assert_array_equal(membrane_extension(photo, photo.shape), photo)


# ---- several photos of one scene


@pytest.mark.parametrize("border", ["real", "periodic"])
def test_the_adjoint_of_several_photos(border):
    """<A x, y> = <x, A^T y>, of all photos together."""
    rng = np.random.default_rng(3)
    psfs = rng.random((3, 5, 7)) * (rng.random((3, 5, 7)) > 0.5)
    psfs[:, 2, 3] = 1
    blur = Blur(psfs, (20, 27), border)
    scene = rng.standard_normal(blur.grid_shape)
    photos = rng.standard_normal((3, 20, 27))
    assert blur.A(scene).shape == photos.shape
    assert np.vdot(blur.A(scene), photos) == pytest.approx(np.vdot(scene, adjoint(blur, photos)))


def test_several_photos_are_their_single_ones():
    rng = np.random.default_rng(4)
    psfs = rng.random((2, 5, 5))
    together = Blur(psfs, (30, 31))
    scene = rng.random(together.grid_shape)
    for photo, psf in zip(together.A(scene), psfs, strict=True):
        np.testing.assert_allclose(photo, Blur(psf, (30, 31)).A(scene), atol=1e-12)


def test_the_proximal_step_of_several_photos_is_the_least_squares_solution():
    """Against the dense normal equations, at real borders."""
    rng = np.random.default_rng(5)
    blur = Blur(rng.random((2, 3, 3)), (5, 6))
    photos = rng.random((2, 5, 6))
    z = rng.random(blur.grid_shape)
    size = z.size
    A = np.stack([blur.A(row.reshape(z.shape)).ravel() for row in np.eye(size)], axis=1)
    dense = np.linalg.solve(A.T @ A + 0.1 * np.eye(size), A.T @ photos.ravel() + 0.1 * z.ravel())
    nearest = blur.nearest(photos, z, 0.1, rounds=300)
    np.testing.assert_allclose(nearest.ravel(), dense, atol=1e-7)
