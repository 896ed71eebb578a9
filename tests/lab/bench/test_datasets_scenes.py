"""Scenes cut from photos: names, places, and files that change."""

from pathlib import Path

import numpy as np
import pytest

from cep.files.images import write_image
from lab.bench.datasets import Cut, labels_of, sharp_scene

CUT = Cut(80, "linear", (3, 1))


@pytest.fixture
def photo(tmp_path):
    """A photo whose every pixel tells its place: rows in steps of code values, columns in
    colour."""
    image = np.zeros((120, 130, 3))
    image[..., 0], image[..., 1] = np.arange(120)[:, None] / 255, np.arange(130) / 255
    write_image(tmp_path / "a.png", image, gamma="linear")
    return tmp_path / "a.png"


def test_a_scene_is_the_mean_of_the_colours_of_a_square(photo):
    scene = sharp_scene(photo, CUT)
    assert scene.shape == (80, 80)
    np.testing.assert_allclose(np.diff(scene, axis=0), 1 / 255 / 3, atol=1e-9)
    np.testing.assert_allclose(np.diff(scene, axis=1), 1 / 255 / 3, atol=1e-9)
    assert scene.max() <= (119 + 129) / 255 / 3 + 1e-9


def test_its_place_goes_by_the_seed(photo):
    corners = {sharp_scene(photo, Cut(80, "linear", (3, seed)))[0, 0] for seed in range(8)}
    assert len(corners) > 4
    assert sharp_scene(photo, CUT)[0, 0] == sharp_scene(photo, Cut(80, "linear", (3, 1)))[0, 0]


def test_light_is_less_than_its_code_value(photo):
    light = sharp_scene(photo, Cut(80, "srgb", (3, 1)))
    assert np.all(light < sharp_scene(photo, CUT))


def test_a_photo_that_was_replaced_is_read_again(photo):
    before = sharp_scene(photo, CUT)
    write_image(photo, np.full((121, 130), 0.5), gamma="linear")
    assert np.ptp(before) > 0
    assert np.ptp(sharp_scene(photo, CUT)) == 0


def test_nobody_writes_into_a_scene_that_others_see(photo):
    with pytest.raises(ValueError, match="read-only"):
        sharp_scene(photo, CUT)[0, 0] = 1


def test_a_photo_too_small_for_it(photo):
    with pytest.raises(
        ValueError, match=r"a\.png: 130 x 120 px is too small, the protocol needs 121 px"
    ):
        sharp_scene(photo, Cut(121, "linear", (0,)))


def test_photos_of_one_name_get_their_folders_for_it():
    assert labels_of([Path("x/a.png"), Path("x/b.png")]) == ("a", "b")
    assert labels_of([Path("x/1/sharp/a.png"), Path("x/2/sharp/a.png")]) == (
        "1/sharp/a.png",
        "2/sharp/a.png",
    )
