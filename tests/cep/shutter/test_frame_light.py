"""Histogram of a frame, and what is advised about its light."""

import numpy as np
import pytest

from cep.shutter.frame_light import FrameLight
from hw.cameras.camera import Frame
from motdiff.photo_values import clipped_mask


def light_of(values, bits=12, black_level=None):
    frame = Frame(
        values=np.asarray(values, dtype=np.uint16 if bits > 8 else np.uint8),
        bits=bits,
        frame_id=1,
        camera="any",
        black_level=black_level,
    )
    return FrameLight.of(frame)


def test_every_pixel_is_in_the_histogram_and_white_in_its_last_bin():
    values = np.arange(4096).reshape(64, 64)
    light = light_of(values)
    assert light.counts == (64,) * 64
    assert light.clipped == clipped_mask(values / 4095).mean()


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.12, "12 % of the photo is clipped: halve the light"),
        (0.02, "2 % of the photo is clipped: halve the light"),
        (0.8, "80 % of the photo is clipped: quarter the light"),
        (0.005, "the light is right: the brightest parts reach 100 % of white, 0.5 % is clipped"),
    ],
)
def test_clipped_light_is_to_be_less(share, words):
    values = np.full(1000, 900)
    values[: round(1000 * share)] = 1023
    light = light_of(values.reshape(20, 50), bits=10)
    assert light.clipped == pytest.approx(share)
    assert light.advice == words


def test_a_single_hot_pixel_is_no_light():
    values = np.full((100, 100), 500)
    values[3, 4] = 4095
    assert "8 times the light" not in light_of(values).advice
    assert light_of(values).brightest == pytest.approx(500 / 4095)
    assert light_of(values).advice.startswith("the brightest parts reach 12 % of white: 7 times")


def test_finished_pictures_are_judged_by_their_light():
    picture = Frame(
        values=np.full((9, 9, 3), 188, dtype=np.uint8),
        bits=8,
        frame_id=1,
        camera="any",
        gamma="srgb",
    )
    light = FrameLight.of(picture)
    assert light.brightest == pytest.approx(0.5, abs=0.005)  # sRGB's code value of half the light
    assert light.clipped == 0


def test_the_black_level_is_no_light():
    assert light_of(np.full((9, 9), 200), bits=8, black_level=55).brightest == pytest.approx(0.725)
    assert light_of(np.zeros((9, 9)), black_level=64).brightest == 0
