import numpy as np
import pytest
from scipy import fft
from skimage import data

from cep.restoration.blur import Blur
from cep.restoration.borders import extended_shape, membrane_extension
from cep.restoration.noise import fit_spectrum
from cep.restoration.wiener import wiener
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory


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


@pytest.mark.parametrize("sigma", [0.003, 0.02])
def test_noise_and_scene_strength_are_found_in_a_blurred_photo(sigma):
    scene = ((data.camera() / 255.0) ** 2.2)[:300, :300]
    psf = Trajectory.straight(11.0, angle_rad=0.4).psf(21)
    noisy = blur_valid(scene, psf) + sigma * np.random.default_rng(0).standard_normal((280, 280))
    blur = Blur(psf, noisy.shape, "periodic")
    found = fit_spectrum(noisy, blur)
    assert np.sqrt(found.noise) == pytest.approx(sigma, rel=0.1)
    known = fit_spectrum(noisy, blur, noise_variance=sigma**2)
    assert known.noise == sigma**2
    assert known.scene == pytest.approx(found.scene, rel=0.2)
    brighter = fit_spectrum(3 * noisy, blur)
    assert brighter.scene == pytest.approx(9 * found.scene, rel=0.02)


@pytest.mark.parametrize("level", [0.0, 0.3, 1.0])
def test_a_flat_photo_meets_no_bare_inverse_filter(level):
    """Only rounding is left in its spectrum, which a box PSF's zeros would amplify without end."""
    photo = np.full((200, 200), level)
    psf = np.full((1, 9), 1 / 9)
    assert fit_spectrum(photo, Blur(psf, photo.shape, "periodic")).noise > 0
    np.testing.assert_allclose(wiener(photo, psf), level, atol=1e-6)
