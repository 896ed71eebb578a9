"""Scene fitted to pictures: their law, without the noise, whatever their light."""

from dataclasses import replace

import numpy as np
import pytest

from cep.optics.scene import PHOTO, SCENES
from cep.photographs.spectra import fitted_levels, fitted_scene

STEEP = replace(PHOTO, exponent=2.6, fall=0.2, level_db=-15.0)


def pictures_of(scene, *, noise=0.0, count=6, side=256):
    rng = np.random.default_rng(0)
    f = np.fft.fftfreq(side)
    amplitude = np.sqrt(scene.power(f[:, None] ** 2 + f**2))
    amplitude[0, 0] = 0
    drawn = (
        np.fft.ifft2(np.fft.fft2(rng.standard_normal((side, side))) * amplitude).real
        for _ in range(count)
    )
    return [light + scene.mean + noise * rng.standard_normal((side, side)) for light in drawn]


@pytest.mark.parametrize("scene", [PHOTO, STEEP, SCENES["texture"]])
def test_the_fit_is_the_law_that_pictures_were_drawn_from(scene):
    found = fitted_scene(pictures_of(scene), name="drawn")
    np.testing.assert_allclose(fitted_levels(found), fitted_levels(scene), atol=1.0)
    assert found.mean == pytest.approx(scene.mean, abs=0.01)
    assert found.spread_db < 1


def test_white_noise_is_no_part_of_the_scene():
    noise = 10 ** (-25 / 20)  # as strong as the scene at the highest frequencies
    noisy = pictures_of(PHOTO, noise=noise)
    found = fitted_scene(noisy, name="noisy")
    np.testing.assert_allclose(fitted_levels(found), fitted_levels(PHOTO), atol=2.0)


def test_half_the_light_is_6_db_less():
    pictures = pictures_of(STEEP)
    whole, half = (
        fitted_scene([share * picture for picture in pictures], name="drawn")
        for share in (1.0, 0.5)
    )
    assert half.level_db == pytest.approx(whole.level_db - 20 * np.log10(2), abs=0.01)
    assert (half.exponent, half.fall) == pytest.approx((whole.exponent, whole.fall), abs=0.01)


def test_noise_alone_and_nothing_at_all_are_flat():
    rng = np.random.default_rng(0)
    for picture in (np.full((64, 64), 0.3), 0.3 + 0.01 * rng.standard_normal((256, 256))):
        with pytest.raises(ValueError, match="flat"):
            fitted_scene([picture], name="flat")
