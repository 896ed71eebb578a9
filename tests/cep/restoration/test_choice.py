"""Choice of the PSF that a photo is restored with: the right one, none for a sharp photo, quickly
for a large one."""

import numpy as np
import pytest

from cep.restoration import choice
from cep.restoration.choice import (
    choose_method,
    choose_psf,
    is_possible_light,
    restore_with_estimate,
)
from cep.restoration.tv import tv
from motdiff.metrics import psnr_up_to_shift
from motdiff.simulate import photograph, visible
from motdiff.trajectory import Trajectory
from tests.motdiff.estimators.test_doubts import discs

PATH = Trajectory.from_samples([[0, 0], [8, 1], [12, 7]])
RIGHT = PATH.psf(33)
WRONG = Trajectory.straight(14.0, angle_rad=-1.0).psf(33)
SCENE = discs(260)
EVEN = {"a": 0.0, "b": 0.0}


def restore_chosen(photo, psf):
    """A photo restored by the method that suits it, and that method."""
    method = choose_method(photo, psf).method
    return restore_with_estimate(photo, psf, method), method


def taken(scene=SCENE, *, sigma=0.003):
    photo = photograph(scene, RIGHT, rng=np.random.default_rng(0), read_sigma=sigma)
    return photo, visible(scene, 33)


@pytest.mark.parametrize("sigma", [0.001, 0.01])
def test_the_right_psf_is_chosen(sigma):
    photo, _ = taken(sigma=sigma)
    name, scores_db, _ = choose_psf(photo, {"a": WRONG, "b": RIGHT}, prior_db=EVEN)
    assert name == "b"
    assert scores_db["b"] > scores_db["a"]
    name, scores_db, _ = choose_psf(photo, {"a": RIGHT, "b": RIGHT}, prior_db={"a": 0.0, "b": 0.1})
    assert name == "b"
    assert scores_db["b"] == pytest.approx(scores_db["a"] + 0.1)


@pytest.mark.parametrize("white", [1.0, 0.8])
def test_the_evidence_of_a_choice_is_that_of_the_photo(white):
    """Clipped or not, what chose the PSF chooses the same method as a look of its own."""
    photo, _ = taken()
    photo = np.clip(photo / white, 0, 1)
    evidence = choose_psf(photo, {"a": WRONG, "b": RIGHT}, prior_db=EVEN).evidence
    for name, psf in (("a", WRONG), ("b", RIGHT)):
        assert choose_method(photo, psf, evidence=evidence[name]) == choose_method(photo, psf)


def test_a_sharp_photo_is_restored_with_none():
    photo = SCENE + 0.003 * np.random.default_rng(0).standard_normal(SCENE.shape)
    wide = Trajectory.straight(40.0).psf(65)
    assert choose_psf(photo, {"a": wide}, prior_db=EVEN)[0] is None or not is_possible_light(
        restore_chosen(photo, wide)[0], photo, wide
    )


def test_light_beyond_black_and_white_is_impossible():
    assert is_possible_light(SCENE, SCENE, RIGHT)
    assert is_possible_light(1.02 * SCENE - 0.01, SCENE, RIGHT)
    assert not is_possible_light(3 * (SCENE - 0.3), SCENE, RIGHT)


def test_beside_lights_less_light_below_black_is_possible():
    lit = SCENE.copy()
    lit[:20, :20] = 1.0  # clipped
    for photo, possible in [(SCENE, True), (lit, False)]:
        ringing = photo.copy()
        ringing[len(photo) // 2 :] = -0.15 * np.std(photo)  # 0.106 of the contrast, rms
        assert is_possible_light(ringing, photo, RIGHT) == possible


def test_a_restored_photo_is_nearer_the_scene_in_every_colour():
    colours = np.stack([SCENE, 0.8 * SCENE, discs(260, seed=2)], axis=2)
    photo, sharp = taken(colours)
    image, method = restore_chosen(photo, RIGHT)
    assert method == "pnp"
    assert image.shape == photo.shape
    for channel in range(3):
        gain = psnr_up_to_shift(image[..., channel], sharp[..., channel]) - psnr_up_to_shift(
            photo[..., channel], sharp[..., channel]
        )
        assert gain > 3


@pytest.mark.parametrize(("sigma", "scale"), [(0.001, 1.25), (0.01, 1.5)])
def test_a_psf_that_does_not_explain_the_photo_is_not_trusted(sigma, scale):
    photo, sharp = taken(sigma=sigma)
    near = PATH.scaled(scale).psf(33)
    image, method = restore_chosen(photo, near)
    assert method == "tv"
    assert psnr_up_to_shift(image, sharp) > psnr_up_to_shift(tv(photo, near), sharp)
    assert choose_method(photo, RIGHT, trusted=True).method == "pnp"
    assert choose_method(photo, PATH.scaled(1.8).psf(33), trusted=True).method == "tv"


def test_strong_noise_is_not_sharpened():
    photo, sharp = taken(sigma=0.03)
    assert psnr_up_to_shift(restore_chosen(photo, RIGHT)[0], sharp) > psnr_up_to_shift(
        photo, sharp
    )


def test_a_large_photo_is_restored_by_the_fast_method(monkeypatch):
    monkeypatch.setattr(choice, "LARGEST_ESTIMATED_PX", 200 * 200)
    photo, sharp = taken(np.stack([SCENE] * 3, axis=2))
    image, method = restore_chosen(photo, RIGHT)
    assert method == "wiener"
    assert image.shape == photo.shape
    assert (
        psnr_up_to_shift(image[..., 0], sharp[..., 0])
        > psnr_up_to_shift(photo[..., 0], sharp[..., 0]) + 2
    )
