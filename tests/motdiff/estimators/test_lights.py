"""Clipped lights are spanned by a membrane before a search for a blur that was lost beside
them."""

import numpy as np
import pytest

from motdiff.crops import exposure_gain
from motdiff.estimators.lights import without_lights
from tests.motdiff.estimators.test_blind_estimator import FakeSearch, line

RNG = np.random.default_rng(0)
SCENE = 0.5 * np.kron(RNG.random((16, 16)), np.ones((12, 12)))
LIGHTS = np.zeros(SCENE.shape, bool)
LIGHTS[40:43, 60:80] = True
PHOTO = np.where(LIGHTS, 1.0, SCENE)


def test_a_ramp_is_continued_across_lights():
    y, x = np.indices((60, 70))
    ramp = 0.2 + 0.004 * y + 0.002 * x
    clipped = np.zeros(ramp.shape, bool)
    clipped[25:30, 20:40] = True
    np.testing.assert_allclose(
        without_lights(np.where(clipped, 1.0, ramp), clipped), ramp, atol=1e-12
    )


def test_values_under_lights_do_not_matter_and_others_stay():
    spanned = without_lights(PHOTO, LIGHTS)
    np.testing.assert_array_equal(without_lights(np.where(LIGHTS, 7.0, SCENE), LIGHTS), spanned)
    assert spanned.max() <= SCENE.max()
    far = np.ones(SCENE.shape, bool)
    far[30:53, 50:90] = False
    np.testing.assert_array_equal(spanned[far], PHOTO[far])


def test_a_photo_with_lights_nowhere_or_all_over_is_left():
    assert without_lights(SCENE, np.zeros(SCENE.shape, bool)) is SCENE
    assert without_lights(SCENE, np.ones(SCENE.shape, bool)) is SCENE
    scattered = np.zeros(SCENE.shape, bool)
    scattered[::12, ::12] = True
    assert without_lights(SCENE, scattered) is SCENE


def test_a_light_at_the_border_is_spanned():
    corner = np.zeros(SCENE.shape, bool)
    corner[:3, :5] = True
    spanned = without_lights(np.where(corner, 1.0, SCENE), corner)
    assert np.isfinite(spanned).all()
    assert spanned.max() <= SCENE.max()


def test_a_blur_lost_beside_lights_is_searched_without_them():
    search = FakeSearch((line(9), 0.2), (line(15), 0.8))
    found = search.estimate(PHOTO)
    assert len(search.seen) == 2
    np.testing.assert_array_equal(search.seen[0][0], PHOTO)
    np.testing.assert_array_equal(search.seen[1][0], without_lights(PHOTO, LIGHTS))
    assert found.details["lights_left_out"] is True
    assert found.details["psf_confidence"] == pytest.approx(0.8)


def test_a_light_clipped_in_one_colour_counts():
    colours = np.stack([PHOTO, SCENE, SCENE], axis=2)
    search = FakeSearch((line(9), 0.2), (line(15), 0.8))
    search.estimate(colours)
    grey = colours.mean(axis=2)
    np.testing.assert_array_equal(search.seen[1][0], without_lights(grey, LIGHTS))


def test_the_likelier_of_both_searches_is_kept():
    search = FakeSearch((line(9), 0.3), (line(15), 0.2))
    found = search.estimate(PHOTO)
    assert len(search.seen) == 2
    assert "lights_left_out" not in found.details
    assert found.details["psf_confidence"] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("photo", "confidence"),
    [(SCENE, 0.2), (PHOTO, 0.9), (np.where(np.indices(SCENE.shape)[0] < 40, 1.0, SCENE), 0.2)],
    ids=["nothing clipped", "not lost", "a clipped sky"],
)
def test_otherwise_one_search_of_the_photo_as_it_is(photo, confidence):
    search = FakeSearch((line(9), confidence), (line(15), 0.8))
    found = search.estimate(photo)
    assert len(search.seen) == 1
    np.testing.assert_array_equal(search.seen[0][0], exposure_gain(photo) * photo)
    assert "lights_left_out" not in found.details
