"""Restored photos whose light is above white."""

import numpy as np
import pytest

from cep.restoration.result import Restoration


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
