"""Spectra of scene and noise in a blurred photo: simulated ones, and a flat one that has none."""

import numpy as np
import pytest
from skimage import data

from cep.restoration.blur import Blur
from cep.restoration.noise import fit_spectrum
from cep.restoration.wiener import wiener
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory


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
