"""A photo of the user's own, sharpened or kept; the command and the file of a calibration."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from cep.calibration.calibrate import Calibration
from cep.files.images import read_photo, write_image
from cep.restoration.sharpen import sharpen
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.motdiff import MotDiff
from motdiff.metrics import psnr_up_to_shift
from motdiff.simulate import photograph, visible
from motdiff.trajectory import Trajectory
from tests.motdiff.estimators.test_doubts import discs

PATH = Trajectory.from_samples([[0, 0], [8, 1], [12, 7]])
SCENE = discs(230)
PHOTO = photograph(SCENE, PATH.psf(33), rng=np.random.default_rng(0), read_sigma=0.003)
SHARP = visible(SCENE, 33)
FOUND = MotionEstimate(
    "pmp",
    (PATH,),
    (1.0,),
    PATH.psf(64),
    0.8,
    ("of the path",),
    {"psf_confidence": 0.9},
    ("of the PSF",),
)


def still():
    details = {"psf_confidence": 0.9, "motion_blur": False}
    said = ("This photo shows no motion blur (its sharpest edges are 1.2 px wide)",)
    point = Trajectory.from_samples([[0, 0], [0, 0]])
    return MotionEstimate("pmp", (point,), (1.0,), point.psf(64), 0.9, said, details, said)


def test_a_blurred_photo_is_restored_and_it_is_said_with_what():
    found = sharpen(PHOTO, FOUND)
    assert psnr_up_to_shift(found.image, SHARP) > psnr_up_to_shift(PHOTO, SHARP) + 3
    assert (found.kept, found.method, found.psf_source) == (False, "pnp", "photo")
    assert (
        found.summary
        == "The photo was restored with the blur kernel found in it (confidence 0.90), by pnp"
    )
    assert found.warnings == ("of the PSF",)
    assert found.psf_confidence == 0.9
    assert 0 < found.residual < 0.01
    assert found.unreliable_px == 7


def test_a_dim_photo_is_restored_as_the_bright_one():
    bright = PHOTO * 0.95 / PHOTO.max()
    whole = sharpen(bright, FOUND)
    dim = sharpen(bright / 16, FOUND)
    assert not dim.kept
    np.testing.assert_allclose(16 * dim.image, whole.image, atol=1e-9)
    assert 16 * dim.residual == pytest.approx(whole.residual)


def test_the_path_s_psf_is_taken_where_the_free_one_does_not_fit():
    speckled = PATH.psf(64) + 0.002 * np.random.default_rng(0).random((64, 64))
    found = sharpen(PHOTO, replace(FOUND, psf=speckled / speckled.sum()))
    assert found.psf_source == "path in the photo"
    assert "with the path found in it" in found.summary


@pytest.mark.parametrize(
    ("estimate", "begins"),
    [
        (still(), "This photo shows no motion blur (its sharpest edges are 1.2 px wide): "),
        (
            replace(FOUND, details={"psf_confidence": 0.2}),
            "The blur could not be found with confidence (0.20): ",
        ),
        (
            replace(FOUND, details={}, confidence=0.1),
            "The blur could not be found with confidence (0.10): ",
        ),
        (
            replace(FOUND, psf=PATH.scaled(12).psf(257), trajectories=(PATH.scaled(12),)),
            "No restoration is sharper",
        ),
    ],
    ids=["still", "lost", "lost as a whole", "too long for the photo"],
)
def test_a_photo_that_is_not_improved_is_kept(estimate, begins):
    found = sharpen(PHOTO, estimate)
    assert found.kept
    assert found.summary.startswith(begins)
    assert found.summary.endswith("the photo is kept as it is")
    np.testing.assert_array_equal(found.image, PHOTO)
    assert (found.method, found.psf_source, found.unreliable_px) == (None, None, 0)


@pytest.mark.parametrize(
    ("estimate", "doubt"),
    [
        (still(), "This photo shows no motion blur"),
        (replace(FOUND, details={"psf_confidence": 0.2}), "The blur could not be found"),
    ],
)
def test_a_photo_that_would_be_kept_is_restored_on_request(estimate, doubt):
    found = sharpen(PHOTO, estimate, anyway=True)
    assert not found.kept
    assert found.summary.startswith(doubt)
    assert "restored anyway" in found.summary
    assert found.image.shape == PHOTO.shape
    larger = replace(FOUND, psf=PATH.scaled(12).psf(257), trajectories=(PATH.scaled(12),))
    assert sharpen(PHOTO, larger, anyway=True).kept  # nothing of it would be left


@pytest.fixture
def estimated(monkeypatch):
    def given(estimate):
        estimator = SimpleNamespace(estimate_from=lambda _photos: estimate)
        monkeypatch.setattr(MotDiff, "load", lambda _method, **_options: estimator)

    return given


def test_deblur_of_a_photo_alone_writes_its_bits_and_says_first_what_it_did(
    cep, estimated, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    write_image("photo.png", PHOTO, bits=16)
    estimated(FOUND)
    result = cep.succeeds("deblur", "photo.png")
    assert (result["method"], result["psf_source"], result["kept"]) == ("pnp", "photo", False)
    assert read_photo("photo_sharp.png").bits == 16
    estimated(still())
    cep("deblur", "photo.png", "--force")
    assert cep.code == 0
    assert cep.out.startswith(
        "This photo shows no motion blur (its sharpest edges are 1.2 px wide): the photo is kept"
    )
    np.testing.assert_array_equal(cv2.imread("photo_sharp.png", -1), cv2.imread("photo.png", -1))
    assert cep.succeeds("deblur", "photo.png", "--force")["method"] is None


def test_a_calibration_has_the_restored_photo_unless_it_was_coded(tmp_path):
    written = Calibration.of(FOUND, PHOTO).save(tmp_path / "open", bits=16)
    restored = read_photo(written["sharpened.png"])
    assert restored.bits == 16
    np.testing.assert_allclose(
        restored.pixels, np.clip(sharpen(PHOTO, FOUND).image, 0, 1), atol=1e-3
    )
    coded = replace(FOUND, details={"order_confidence": 0.9})
    assert "sharpened.png" not in Calibration.of(coded, PHOTO).save(tmp_path / "coded")
