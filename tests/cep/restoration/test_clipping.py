"""Clipped pixels: replaced by what the others show, whatever their values; a photo without any
stays as it is."""

from dataclasses import replace

import numpy as np
import pytest
from skimage import data

from cep.restoration.choice import choose_psf, is_possible_light
from cep.restoration.clipping import fill_clipped, lights_cut
from cep.restoration.registry import METHODS
from cep.restoration.restore import restore
from cep.restoration.result import misfit
from motdiff.metrics import psnr
from motdiff.photo_values import clipped_mask
from motdiff.simulate import blur_valid, photograph, visible
from motdiff.trajectory import Trajectory

PATH = Trajectory.from_samples([[0, 0], [8, 1], [12, 7]])
PSF = PATH.psf(33)


def night():
    """Scene of 0.5 at most, with six lights 3 to 15 times full scale."""
    scene = 0.5 * ((data.camera() / 255.0) ** 2.2)[100:260, 100:280]
    rng = np.random.default_rng(1)
    for strength in np.linspace(3, 15, 6):
        y, x = rng.integers(30, 120, 2)
        scene[y : y + 3, x : x + 3] = strength
    return scene


SCENE = night()
TRUTH = np.clip(visible(SCENE, 33), 0, 1)
LIGHT = blur_valid(SCENE, PSF)
PHOTO = np.clip(LIGHT + 0.004 * np.random.default_rng(0).standard_normal(LIGHT.shape), 0, 1)
CLIPPED = clipped_mask(PHOTO)


@pytest.mark.parametrize("method", [m.name for m in METHODS.values() if m.fills_clipped])
def test_every_method_before_which_they_are_filled_restores_a_night_scene_better(method):
    assert 0.002 < CLIPPED.mean() < 0.05
    without = METHODS[method].function(PHOTO, PSF)
    found = restore(PHOTO, PSF, method=method)
    gain = psnr(np.clip(found.image, 0, 1), TRUTH) - psnr(np.clip(without, 0, 1), TRUTH)
    assert gain > 1.5
    assert "clipped" in found.warnings[0]
    assert found.residual < misfit(PHOTO, without, PSF)


@pytest.mark.parametrize("fills_clipped", [False, True])
def test_a_method_says_whether_they_are_filled_before_it(monkeypatch, fills_clipped):
    photos = []
    monkeypatch.setattr("cep.restoration.tv.tv", lambda photo, _psf: photos.append(photo) or photo)
    entry = replace(METHODS["tv"], fills_clipped=fills_clipped)
    monkeypatch.setitem(METHODS, "tv", entry)
    restored = restore(PHOTO, PSF, method="tv")
    assert (photos[0] is PHOTO) != fills_clipped
    assert ("their light was inferred" in restored.warnings[0]) == fills_clipped


def test_a_registered_function_is_called_as_its_name_is():
    by_function = restore(PHOTO, PSF, method=METHODS["wiener"].function)
    np.testing.assert_array_equal(by_function.image, restore(PHOTO, PSF, method="wiener").image)


def test_light_beneath_clipped_pixels_is_found():
    filled = fill_clipped(PHOTO, PSF)
    np.testing.assert_array_equal(filled[~CLIPPED], PHOTO[~CLIPPED])
    error = np.abs(filled - LIGHT)[CLIPPED].mean()
    assert error < 0.35 * (LIGHT - PHOTO)[CLIPPED].mean()


def test_values_of_clipped_pixels_do_not_matter():
    other = PHOTO.copy()
    other[CLIPPED] = 1 + 5 * np.random.default_rng(2).random(int(CLIPPED.sum()))
    np.testing.assert_array_equal(fill_clipped(other, PSF), fill_clipped(PHOTO, PSF))
    np.testing.assert_array_equal(restore(other, PSF).image, restore(PHOTO, PSF).image)
    assert misfit(other, PHOTO, PSF) == misfit(PHOTO, PHOTO, PSF)


def test_the_fill_does_not_depend_on_the_scale_of_the_psf_and_is_per_channel():
    np.testing.assert_allclose(fill_clipped(PHOTO, 0.5 * PSF), fill_clipped(PHOTO, PSF), atol=1e-9)
    colours = np.stack([PHOTO, 0.5 * PHOTO, PHOTO], axis=2)
    filled = fill_clipped(colours, PSF)
    np.testing.assert_array_equal(filled[..., 1], colours[..., 1])
    np.testing.assert_array_equal(filled[..., 0], fill_clipped(PHOTO, PSF))


def test_tiles_join(monkeypatch):
    whole = fill_clipped(PHOTO, PSF)
    monkeypatch.setattr("cep.restoration.clipping._TILE_PX", 48)
    tiled = fill_clipped(PHOTO, PSF)
    assert np.abs(tiled - whole)[CLIPPED].mean() < 0.1 * (whole - PHOTO)[CLIPPED].mean()


def test_paper_just_below_clipping_is_not_made_brighter():
    # white paper at full scale is taken for clipped; the most likely scene is as white as it
    page = np.ones((160, 180))
    rng = np.random.default_rng(3)
    for y, x in rng.integers(10, 150, (40, 2)):
        page[y : y + 3, x : x + 12] = 0.05
    photo = np.clip(photograph(page, PSF, rng=rng, read_sigma=0.004), 0, 1)
    assert clipped_mask(photo).mean() > 0.1
    sharp = visible(page, 33)
    with_mask, without = (
        np.clip(x, 0, 1)
        for x in (restore(photo, PSF, method="tv").image, METHODS["tv"].function(photo, PSF))
    )
    assert psnr(with_mask, sharp) > psnr(without, sharp) - 1


@pytest.mark.parametrize("method", ["wiener", "tv"])
def test_a_photo_with_nothing_clipped_is_restored_as_by_the_method_alone(method):
    dim = 0.97 * PHOTO
    assert fill_clipped(dim, PSF) is dim
    np.testing.assert_array_equal(
        restore(dim, PSF, method=method).image, METHODS[method].function(dim, PSF)
    )
    np.testing.assert_array_equal(lights_cut(2 * dim, np.zeros(dim.shape, bool), PSF), 2 * dim)


def test_a_photo_clipped_throughout_stays_white():
    white = np.ones((60, 70))
    np.testing.assert_allclose(fill_clipped(white, PSF), 1, atol=0.02)
    assert np.isnan(misfit(white, white, PSF))


def test_lights_are_possible_light_and_their_ringing_is_not():
    bright = np.where(CLIPPED, 8.0, PHOTO)
    assert is_possible_light(bright, PHOTO, PSF)
    assert not is_possible_light(bright - 0.1, PHOTO, PSF)
    assert not is_possible_light(bright, 0.97 * PHOTO, PSF)


def test_the_right_psf_is_chosen_beside_lights():
    wrong = Trajectory.straight(14.0, angle_rad=-1.0).psf(33)
    assert choose_psf(PHOTO, {"a": wrong, "b": PSF}, prior_db={"a": 0.0, "b": 0.0})[0] == "b"
