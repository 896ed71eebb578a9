"""Checks of photos before a search: their number, their codes, their texture."""

import numpy as np
import pytest

from cep.calibration.photo_checks import check_method_photos, check_texture
from motdiff.estimators.coded import Coded
from motdiff.estimators.motdiff import MotDiff
from motdiff.estimators.point import Point

PHOTOS = list(np.random.default_rng(0).random((5, 192, 192)))


def test_a_blind_method_takes_several_photos_and_others_one():
    for count in (1, 2, 5):
        check_method_photos(PHOTOS[:count], MotDiff())
    check_method_photos(PHOTOS[:1], Point())
    with pytest.raises(ValueError, match=r"method: point takes one photo; .* go with .*motdiff"):
        check_method_photos(PHOTOS[:2], Point())


def test_coded_photos_are_as_many_as_their_codes():
    method = Coded(codes=("1111", "1011"))
    check_method_photos(PHOTOS[:2], method)
    with pytest.raises(ValueError, match="code: needs one for each photo, got 2 for 3"):
        check_method_photos(PHOTOS[:3], method)
    with pytest.raises(ValueError, match="photo: give the photos of several codes as a list"):
        check_method_photos([np.stack(PHOTOS[:2])], method)


def test_a_photo_among_several_is_named_by_its_number():
    flat = np.full((192, 192), 0.5)
    with pytest.raises(ValueError, match=r"photo 2: .* the same all over"):
        check_method_photos([PHOTOS[0], flat], MotDiff())
    with pytest.raises(ValueError, match="photo 3: is the same as photo 1"):
        check_method_photos([PHOTOS[0], PHOTOS[1], PHOTOS[0]], MotDiff())


@pytest.mark.parametrize(
    ("level", "shade"), [(0.0, "black"), (0.004, "black"), (0.5, "the same"), (1.0, "white")]
)
def test_texture_is_two_steps_of_8_bit(level, shade):
    photo = np.full((8, 8), level)
    with pytest.raises(ValueError, match=f"^photo: is {shade} all over"):
        check_texture(photo)
    photo[3, 4] += 0.01 if level < 1 else -0.01  # a lone light has texture
    check_texture(photo)
