"""The restoration that is chosen where no method is named."""

import numpy as np
import pytest
from skimage import data

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.restore import restore
from motdiff.metrics import psnr_up_to_shift
from motdiff.motions import with_smooth_error
from motdiff.trajectory import Trajectory

CODE = ShutterCode("1011000110111010")
STRAIGHT = Trajectory.straight(9.0, angle_rad=0.5)
t = np.linspace(0, 1, 50)
CURVED = Trajectory.from_samples(np.column_stack([9 * t, 12 * t**2]), direction="unknown")


@pytest.fixture(scope="module")
def scene():
    return ((data.camera() / 255.0) ** 2.2)[60:260, 100:300]


def photo_of(scene, path, code=None, *, seed=0, size=33):
    camera = Camera(photons_full_scale=10_000)
    psf = coded_psf(path, code or ShutterCode("1"), size)
    return capture(scene, psf, None, camera, rng=np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("path", "code", "method"),
    [
        (STRAIGHT, None, "pnp"),  # the same in both directions
        (CURVED.reversed(), CODE, "pnp"),
        (CURVED, None, "pnp"),
        (Trajectory.from_samples(CURVED.xy, direction="known"), None, "pnp"),
    ],
)
def test_a_motion_that_fits_the_photo_is_trusted(scene, path, code, method):
    photo = photo_of(scene, path, code)
    assert restore(photo, trajectory=path, code=code).method == method


@pytest.mark.parametrize(
    "wrong", [Trajectory.straight(9.0, angle_rad=-0.7), Trajectory.straight(13.0, angle_rad=0.5)]
)
def test_a_straight_motion_that_does_not_fit_is_not_trusted(scene, wrong):
    photo = photo_of(scene, STRAIGHT)
    assert restore(photo, trajectory=wrong).method == "tv"


def test_a_motion_that_does_not_fit_at_all_is_told(scene):
    still = scene + 0.002 * np.random.default_rng(0).standard_normal(scene.shape)
    far = restore(np.clip(still, 0, 1), trajectory=Trajectory.straight(25.0))
    assert any("does not fit this photo" in warning for warning in far.warnings)
    assert restore(photo_of(scene, STRAIGHT), trajectory=STRAIGHT).warnings == ()


def test_a_psf_that_was_closed_for_a_time_is_a_code_s(scene):
    photo = photo_of(scene[:90, :90], STRAIGHT, CODE)
    psf = coded_psf(STRAIGHT, CODE, 33)
    assert restore(photo, psf).method == "pnp"


def test_a_large_photo_is_restored_in_time(scene, monkeypatch):
    monkeypatch.setattr("cep.restoration.choice.LARGEST_PNP_PX", 1_000)
    assert restore(photo_of(scene, STRAIGHT, CODE), trajectory=STRAIGHT, code=CODE).method == (
        "wiener"
    )


def test_the_default_is_the_better_one(scene):
    photo = photo_of(scene, STRAIGHT, CODE)
    camera = Camera(photons_full_scale=10_000)
    truth = scene[16:-16, 16:-16]
    psnr = {
        method: psnr_up_to_shift(
            restore(photo, trajectory=STRAIGHT, code=CODE, method=method, camera=camera).image,
            truth,
        )
        for method in ("auto", "wiener")
    }
    assert psnr["auto"] > psnr["wiener"] + 1.0


def test_a_path_that_is_wrong_by_a_pixel_leaves_fewer_stripes(scene):
    psnr = {"auto": [], "wiener": [], "tv": []}
    for seed in range(3):
        true_path = with_smooth_error(CURVED, 1.0, rng=np.random.default_rng(seed))
        photo = photo_of(scene, true_path, seed=seed)
        for method, values in psnr.items():
            image = restore(photo, trajectory=CURVED, method=method).image
            values.append(psnr_up_to_shift(image, scene[16:-16, 16:-16]))
    assert np.mean(psnr["auto"]) > np.mean(psnr["wiener"]) + 0.5
    assert np.mean(psnr["auto"]) > np.mean(psnr["tv"])


def test_a_camera_is_welcome_where_it_is_not_needed(scene):
    photo = photo_of(scene[:90, :90], CURVED)
    camera = Camera(photons_full_scale=10_000)
    plain = restore(photo, trajectory=CURVED)
    np.testing.assert_array_equal(
        restore(photo, trajectory=CURVED, camera=camera).image, plain.image
    )


def test_an_option_of_a_method_needs_its_method(scene):
    with pytest.raises(ValueError, match="weight: not valid without a method that takes it"):
        restore(scene[:64, :64], np.full((1, 3), 1 / 3), weight=1e-2)
