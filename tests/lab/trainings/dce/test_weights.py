"""The trained weights: small, described by their card, and better than doing nothing."""

import numpy as np
import pytest

from cep.codes.published import published
from cep.optics.exposure import coded_psf
from lab.trainings.dce.shipped_code import DCE_CODE
from lab.trainings.dce.weights import WEIGHTS, read_card, restore
from motdiff.motions import boracchi_foi, random_straight
from motdiff.photo_values import to_linear
from motdiff.simulate import add_noise, blur_valid, valid_window


@pytest.fixture(scope="module")
def scene():
    from skimage import data

    return to_linear(data.camera()[40:327, 80:367] / 255)


def mean_square(image, sharp):
    return float(np.mean((image - sharp) ** 2))


def test_they_are_small_and_say_what_they_are():
    assert WEIGHTS.stat().st_size <= 5 * 2**20
    card = read_card(WEIGHTS)
    assert card.code == DCE_CODE
    assert card.start == published("merl-32-t64").code
    assert card.steps > 0
    assert {"photos", "motions", "evaluation"} <= set(card.notes)
    readme = WEIGHTS.with_name("README.md").read_text(encoding="utf-8")
    assert card.code.bits in readme
    assert f"{card.steps:,}" in readme


def test_they_restore_photos_better_than_doing_nothing(scene):
    """Over eight motions together, and on none of them much worse."""
    rng = np.random.default_rng(5)
    code = DCE_CODE
    gains = []
    for number in range(8):
        motion = (
            random_straight(rng, max_length_px=30)
            if number % 2
            else boracchi_foi(rng, max_length_px=30)
        )
        photo = add_noise(blur_valid(scene, coded_psf(motion, code, 64)), rng, read_sigma=0.01)
        sharp = scene[valid_window(scene.shape, (64, 64))]
        gains.append(
            10
            * np.log10(mean_square(photo / code.duty, sharp) / mean_square(restore(photo), sharp))
        )
    assert np.mean(gains) > 0.3, gains
    assert min(gains) > -0.5, gains


def test_an_even_photo_stays_as_bright_as_it_was():
    flat = np.full((64, 64, 3), 0.4 * DCE_CODE.duty)
    np.testing.assert_allclose(restore(flat)[16:-16, 16:-16], 0.4, atol=0.03)


def test_a_photo_that_is_none_is_refused():
    with pytest.raises(ValueError, match=r"^photo: must be \(H, W\)"):
        restore(np.zeros(5))
