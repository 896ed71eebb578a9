"""Restored photos whose light is above white."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from cep.restoration.direction import DirectionResult
from cep.restoration.result import Restoration, misfit


def restoration(peak):
    image = np.linspace(0, peak, 10_000).reshape(100, 100)
    return Restoration(image=image, psf=np.ones((1, 1)), saturated_fraction=0.0, warnings=())


@pytest.mark.parametrize("peak", [0.9, 1.0, 1.04])
def test_light_about_white_is_left_as_it_is(peak):
    sharp = restoration(peak)
    assert sharp.below_white() is sharp


def test_light_above_white_is_darkened_as_a_whole_and_said():
    sharp = restoration(2.0)
    darker = sharp.below_white()
    ratio = sharp.image[sharp.image > 0] / darker.image[sharp.image > 0]
    np.testing.assert_allclose(ratio, ratio[0])
    assert (darker.image > 1).mean() <= 0.001
    assert len(darker.warnings) == 1


def test_the_figures_of_the_direction_are_those_of_its_test():
    tested = DirectionResult("reverse", 0.9, (2.0, 1.0), (0.4, 0.3), np.ones((1, 1)), None)
    fields = replace(restoration(0.9), direction_test=tested).to_dict()
    assert (fields["direction_confidence"], fields["direction_likelihoods"]) == (0.9, (2.0, 1.0))
    untested = restoration(0.9).to_dict()
    assert untested["direction_confidence"] is untested["direction_likelihoods"] is None


def test_the_misfit_is_that_of_the_photo_blurred_again_away_from_borders_and_clipped_light():
    rng = np.random.default_rng(0)
    sharp = rng.uniform(0.1, 0.5, (24, 30))
    psf = np.zeros((5, 5))
    psf[2, 1:4] = 1 / 3
    photo = ndimage.convolve(sharp, psf, mode="nearest")
    assert misfit(photo, sharp, psf) == pytest.approx(0, abs=1e-12)
    wrong = photo + 0.01 * (-1.0) ** np.indices(photo.shape).sum(axis=0)
    assert misfit(wrong, sharp, psf) == pytest.approx(0.01)
    wrong[10, 10] = 1.0  # clipped: it counts as little as the border
    wrong[0] = 0.9
    assert misfit(wrong, sharp, psf) == pytest.approx(0.01)
    everywhere = np.ones(photo.shape, dtype=bool)
    assert np.isnan(misfit(wrong, sharp, psf, clipped=everywhere))
