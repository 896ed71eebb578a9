"""The photos of the coded table: what is taken, estimated and restored."""

from dataclasses import replace

import numpy as np
import pytest
from coded_table import BENT, CLEAN, GUESS, INVERSE, LOPSIDED, blocks, shown
from scipy import ndimage

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.proofs.measure import measure
from cep.restoration.wiener import wiener
from lab.bench.coded.designs import MotionPrior, design_code
from lab.bench.coded.protocol import (
    paths_from,
)
from lab.bench.coded.stages import estimate_motion, photographed, take_photo
from lab.bench.psf_text import psf_to_text
from motdiff.psf_frame import PSF_PX, moved
from motdiff.trajectory import Trajectory


@pytest.mark.parametrize("borders", ["real", "symmetric"])
@pytest.mark.parametrize("light_true", [True, False])
def test_a_still_camera_takes_the_target_pixel_for_pixel(borders, light_true):
    still = Trajectory.straight(1e-9)
    taken = photographed(**shown(still, bits="1100", borders=borders, light_true=light_true))
    side = 128 if borders == "symmetric" else 128 - PSF_PX + 1
    assert taken.photo.shape == taken.target.shape == taken.restored.shape == (side, side)
    light = 0.5 if light_true else 1.0
    np.testing.assert_allclose(taken.photo, light * taken.target, atol=3e-4)
    np.testing.assert_allclose(taken.restored, taken.target, atol=2e-3)


def test_real_borders_show_what_comes_from_outside():
    """Brute force: each pixel of the photo is the scene summed up along the path, as long as the
    shutter is open."""
    code = ShutterCode(LOPSIDED)
    taken = photographed(**shown(BENT, borders="real"))
    t = (np.arange(16 * 40) + 0.5) / (16 * 40)
    at = BENT.at(t)[np.repeat(code.array, 40) == 1]
    scene = blocks(128)
    row = 3
    column = 60
    total = 0.0
    for dx, dy in at:  # what is displaced by (dx, dy) came from (-dx, -dy)
        y = 31 + row - dy
        x = 31 + column - dx
        i = int(np.floor(y))
        j = int(np.floor(x))
        u = y - i
        v = x - j
        total += (1 - u) * ((1 - v) * scene[i, j] + v * scene[i, j + 1])
        total += u * ((1 - v) * scene[i + 1, j] + v * scene[i + 1, j + 1])
    assert taken.photo[row, column] == pytest.approx(total / t.size, abs=1e-3)


def test_a_coded_photo_has_the_light_that_came_through():
    duty = ShutterCode(LOPSIDED).duty
    true, equal = (photographed(**shown(BENT, light_true=flag)) for flag in (True, False))
    np.testing.assert_allclose(true.photo, duty * equal.photo, atol=1e-4)
    np.testing.assert_allclose(
        true.restored, equal.restored, atol=0.02
    )  # but for rounding to code values
    dim = Camera(photons_full_scale=300.0, read_noise_e=5.0, black_level=0.1)
    short = {"bits": "1010010000000000", "camera": dim}
    dark, lit = (
        take_photo(**shown(BENT, light_true=flag, **short))["psnr_db"] for flag in (True, False)
    )
    assert lit > dark + 1


@pytest.mark.parametrize("light_true", [True, False])
def test_with_the_true_psf_and_no_noise_the_oracles_code_restores_far_better_than_an_open_shutter(
    light_true,
):
    motion = Trajectory.straight(24.0, angle_rad=0.4)
    code = design_code(
        "oracle",
        MotionPrior((motion,), (1.0,)),
        chips=16,
        open_range=(6, 10),
        objective="min-mtf",
        camera=Camera(),
        steps=2000,
        rng=np.random.default_rng(0),
    )
    coded, plain = (
        take_photo(**shown(motion, bits=bits, light_true=light_true, restoration=INVERSE))
        for bits in (code.bits, "1" * 16)
    )
    assert coded["psnr_db"] > plain["psnr_db"] + 6
    assert coded["ssim"] > plain["ssim"]
    assert coded["min_mtf"] > 10 * plain["min_mtf"]


@pytest.mark.parametrize("light_true", [True, False])
def test_a_hidden_direction_is_found(light_true):
    """Restored by a path of unknown direction it is as good as by the true PSF, whichever way the
    camera ran."""
    options = {"light_true": light_true, "camera": Camera(photons_full_scale=1e6)}
    for truth in (BENT, BENT.reversed()) if light_true else (BENT.reversed(),):
        told = take_photo(**shown(truth, **options))["psnr_db"]
        found = take_photo(**shown(truth, assumed=BENT, **options))["psnr_db"]
        assert found == pytest.approx(told, abs=0.05)
    wrong = take_photo(
        **shown(BENT.reversed(), assumed=replace(BENT, direction="known"), **options)
    )["psnr_db"]
    assert wrong < told - 3


@pytest.mark.parametrize(("length_px", "lost_db"), [(32.0, 0.01), (30.7, 0.5)])
def test_a_scene_that_is_merely_displaced_is_as_good(length_px, lost_db):
    """A snapshot at the end of a straight motion, taken for one at its start: the same PSF, 20 px
    or less away.

    Two of 16 chips are open, their middle at 13/16 of the path.
    """
    straight = Trajectory.straight(length_px)
    scene = ndimage.gaussian_filter(
        blocks(128), 1.5
    )  # of sharp steps, sampling between pixels would ring
    options = {
        "bits": "0" * 12 + "1100",
        "scene": scene,
        "camera": Camera(photons_full_scale=1e5),
    }
    told = take_photo(**shown(straight, **options))["psnr_db"]
    backwards = replace(straight.reversed(), direction="known")
    assert take_photo(**shown(straight, assumed=backwards, **options))["psnr_db"] == pytest.approx(
        told, abs=lost_db
    )
    # a PSF of another shape is no better for lying where it should
    across = replace(Trajectory.straight(length_px, angle_rad=1.5), direction="known")
    assert take_photo(**shown(straight, assumed=across, **options))["psnr_db"] < told - 3


def test_run_backwards_a_code_is_its_mirror_image():
    figures, mirrored = (
        take_photo(**shown(BENT, bits=bits)) for bits in (LOPSIDED, LOPSIDED[::-1])
    )
    assert figures["reversed_noise_gain_db"] == pytest.approx(mirrored["noise_gain_db"], abs=1e-6)
    assert figures["noise_gain_db"] == pytest.approx(mirrored["reversed_noise_gain_db"], abs=1e-6)
    assert abs(figures["noise_gain_db"] - figures["reversed_noise_gain_db"]) > 0.01
    assert figures["noise_gain_db"] == measure(BENT, ShutterCode(LOPSIDED)).noise_gain_db


def test_noise_gain_is_that_of_the_light_the_photo_has():
    """As if coding cost no light, a code's gain is the deconvolution noise factor, relative to
    DC."""
    true, equal = (take_photo(**shown(BENT, light_true=flag)) for flag in (True, False))
    metrics = measure(BENT, ShutterCode(LOPSIDED))
    assert true["noise_gain_db"] == metrics.noise_gain_db
    assert equal["noise_gain_db"] == pytest.approx(metrics.dnf_db, abs=1e-9)


def test_the_wiener_filter_is_told_the_cameras_noise():
    dim = Camera(photons_full_scale=300.0, read_noise_e=5.0, black_level=0.1)
    arguments = shown(BENT, camera=dim)
    taken = photographed(**arguments)
    told = wiener(taken.photo, taken.psf, camera=dim, border_rounds=10)
    np.testing.assert_array_equal(taken.restored, np.clip(told, 0, 1))


def test_motion_is_estimated_from_the_uncoded_photo(guesses):
    arguments = {"method": "motdiff", "borders": "real", "camera": CLEAN, "seed": 0}
    found = estimate_motion(blocks(159), GUESS, **arguments)
    assert found["mnc"] == pytest.approx(1.0)
    assert found["cpu_s"] >= 0
    paths, weights = paths_from(found["paths"])
    np.testing.assert_array_equal(paths[1].xy, BENT.xy)
    assert weights == (0.75, 0.25)
    (photo,) = guesses.photos
    assert photo.shape == (96, 96)
    open_shutter = photographed(**shown(GUESS, bits="1", borders="real", side=159)).photo
    np.testing.assert_allclose(photo, open_shutter, atol=3e-4)
    assert estimate_motion(blocks(159), BENT, **arguments)["mnc"] < 0.9


def test_restored_with_its_kernel_a_photo_is_as_with_its_psf():
    psf = coded_psf(BENT, ShutterCode(LOPSIDED), PSF_PX)
    away = moved(psf, down_px=7, right_px=-5)  # a blind kernel lies anywhere
    for light_true in (True, False):
        known, blind = (
            take_photo(**shown(BENT, light_true=light_true, kernel=kernel))
            for kernel in (None, psf_to_text(away / away.sum()))
        )
        assert blind["psnr_db"] == pytest.approx(known["psnr_db"], abs=0.02)
