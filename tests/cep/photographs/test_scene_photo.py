"""Photo of the user's own as a scene: which parts of it gains are measured on, and refusals."""

from itertools import combinations

import numpy as np
import pytest

from cep.files.images import write_image
from cep.optics.scene import PHOTO
from cep.photographs.scene_photo import MOST_CROPS, ScenePhoto
from cep.photographs.scenes import photographs
from cep.photographs.trial import needed_px
from motdiff.trajectory import Trajectory

PATH = Trajectory.straight(12.0)
NEEDED = needed_px([PATH])


def crops_of(height, width):
    """Parts of a photo whose pixels are numbered."""
    light = np.arange(height * width, dtype=float).reshape(height, width)
    return ScenePhoto(light, PHOTO).crops([PATH])


@pytest.mark.parametrize(("down", "across"), [(2, 2), (1, 4), (3, 3), (6, 7)])
def test_parts_are_disjoint_where_four_fit(down, across):
    crops = crops_of(down * NEEDED[0] + 5, across * NEEDED[1] + 9)
    assert len(crops) == min(down * across, MOST_CROPS)
    assert {crop.shape for crop in crops} == {NEEDED}
    for first, second in combinations(crops, 2):
        assert np.intersect1d(first, second).size == 0


@pytest.mark.parametrize(
    ("more", "count"), [((0, 0), 1), ((0, 60), 2), ((60, 60), 4), ((300, 100), 4)]
)
def test_fewer_than_four_may_overlap(more, count):
    crops = crops_of(NEEDED[0] + more[0], NEEDED[1] + more[1])
    assert len(crops) == count
    assert len({crop[0, 0] for crop in crops}) == count


def test_a_photo_smaller_than_one_part_is_refused():
    height, width = NEEDED
    with pytest.raises(ValueError, match=f"{width - 1} x {height} px is too small"):
        crops_of(height, width - 1)


def test_the_scene_is_that_of_the_photo(tmp_path):
    photo = photographs()[3]
    write_image(tmp_path / "cat.png", photo, bits=16)
    found = ScenePhoto.read(tmp_path / "cat.png")
    assert found.scene.name == "cat.png"
    assert found.scene.mean == pytest.approx(photo.mean(), abs=1e-4)
    np.testing.assert_allclose(found.light, photo, atol=1e-4)


def test_photos_that_are_no_scene_are_refused(tmp_path):
    photo = photographs()[3]
    clipped = np.where(photo > np.quantile(photo, 0.7), 1.0, photo)
    for pixels, fault in (
        (clipped, "% of it are at white"),
        (np.full((100, 100), 0.2), "flat"),
        (photo[:50], "too small"),
    ):
        write_image(tmp_path / "photo.png", pixels)
        with pytest.raises(ValueError, match=fault) as refusal:
            ScenePhoto.read(tmp_path / "photo.png")
        assert "photo.png" in str(refusal.value)
