"""Photo of the user's own as a scene: the parts on which gains are measured, refusals, and the
fit: the law of pictures without their noise, whatever their light.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from cep.files.images import write_image
from cep.optics.scene import PHOTO, SCENES
from cep.photographs.scene_photo import MOST_CROPS, ScenePhoto, fitted_levels, fitted_scene
from cep.photographs.scenes import photographs
from cep.photographs.trial import needed_px
from motdiff.trajectory import Trajectory

PATH = Trajectory.straight(12.0)
NEEDED = needed_px([PATH])
STEEP = replace(PHOTO, exponent=2.6, fall=0.2, level_db=-15.0)


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
