"""Spectrum of the scenes that codes are designed for: its law, and that of photographs."""

import numpy as np
import pytest

from cep.optics.band import circle_samples
from cep.optics.camera import Camera
from cep.optics.scene import PHOTO, inverse_scene, noise_variance
from cep.photographs.scene_photo import BANDS, band_levels
from cep.photographs.scenes import photographs


def test_the_law_has_its_level_and_slopes():
    f = np.array([0.02, 0.04])
    low_db = np.diff(10 * np.log10(PHOTO.power(f**2)))[0]
    assert low_db == pytest.approx(-10 * PHOTO.exponent * np.log10(2), abs=0.2)
    knee = 1 + (0.1 / PHOTO.knee_cy_px) ** 2
    level_db = PHOTO.level_db - 10 * PHOTO.fall * np.log10(knee)
    assert 10 * np.log10(PHOTO.power(0.01)) == pytest.approx(level_db, abs=0.02)
    assert np.isfinite(PHOTO.power(0.0))


def test_the_inverse_is_of_the_power_at_each_radius():
    samples = circle_samples(8, oversampling=4)
    np.testing.assert_allclose(inverse_scene(samples) * PHOTO.power(samples.radius2), 1)


def test_noise_is_that_of_the_mean_light():
    camera = Camera(photons_full_scale=1000, read_noise_e=3)
    assert noise_variance(camera, 0.5) == pytest.approx(camera.noise_variance(PHOTO.mean / 2))


def test_the_bundled_photographs_have_about_this_spectrum():
    """Their mean level in each band, against the law fitted to 580 others."""
    levels = np.mean([band_levels(scene) for scene in photographs()], axis=0)
    f = np.sqrt(BANDS[1:] * BANDS[:-1])
    law = 10 * np.log10(PHOTO.power(f**2))
    assert np.abs(levels - law).mean() < 1.5
    assert 0.15 < np.mean([scene.mean() for scene in photographs()]) < 0.3
