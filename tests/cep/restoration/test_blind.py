"""Restoration of a coded photo from the photo and its code alone."""

import numpy as np
import pytest
from skimage import data

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.restore import find_psf, restore
from motdiff.metrics import mnc_subpixel, psnr_up_to_shift
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory

CODE = ShutterCode("1101000101101110")
PATH = Trajectory.from_samples([[0, 0], [5, 0], [9, 2], [11, 6], [11, 11]])
SCENE = (data.camera()[60:240, 130:310] / 255.0) ** 2.2
PHOTO = capture(
    SCENE,
    PATH,
    CODE,
    camera=Camera(photons_full_scale=1e6, read_noise_e=2000),
    rng=np.random.default_rng(0),
)
TRUTH = coded_psf(PATH, CODE, PATH.frame_size())


@pytest.mark.slow(reason="a blind search")
def test_the_photo_and_its_code_are_enough():
    shares = []
    sharp = visible(SCENE, SCENE.shape[0] - PHOTO.shape[0] + 1)
    found = restore(PHOTO, code=CODE, progress=lambda share, _what: shares.append(share))
    assert found.psf.sum() == pytest.approx(CODE.duty)
    assert mnc_subpixel(found.psf, TRUTH) > 0.8
    assert found.direction is None
    assert 0.5 < found.psf_confidence <= 1
    backwards = restore(PHOTO, coded_psf(PATH.reversed(), CODE, 64)).image
    score = psnr_up_to_shift(found.image, sharp)
    assert score > psnr_up_to_shift(PHOTO / CODE.duty, sharp) + 2
    assert score > psnr_up_to_shift(backwards, sharp) + 2
    assert shares == sorted(shares)
    assert shares[-1] == 1


def test_a_lost_psf_is_said_to_be_lost(monkeypatch):
    from motdiff.estimators.base import MotionEstimate
    from motdiff.estimators.pmp.estimator import PmpEstimator

    def lost(_self, photos):
        said = ("of its path", "of its PSF")
        return MotionEstimate("pmp", (PATH,), (1.0,), PATH.psf(), 0.2, said, psf_warnings=said[1:])

    monkeypatch.setattr(PmpEstimator, "estimate_from", lost)
    found = find_psf(PHOTO, CODE)
    assert found.psf.sum() == pytest.approx(CODE.duty)
    assert found.confidence == 0.2
    first, second = found.psf_warnings
    assert "may be worse" in first
    assert second == "of its PSF"
    assert restore(PHOTO, code=CODE).warnings[0] == first


@pytest.mark.parametrize(
    "photo", [np.full((60, 60), 0.2), np.random.default_rng(0).random((30, 60))]
)
def test_a_photo_that_cannot_be_searched_is_refused(photo):
    with pytest.raises(ValueError, match=r"^photo: "):
        restore(photo, code=CODE)
