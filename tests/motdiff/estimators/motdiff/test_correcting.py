"""Kernels that two searches agree on, at the photo's scale and at half of it."""

import cv2
import numpy as np
import pytest
from skimage import data

from motdiff.estimators.kernel_score import Judge
from motdiff.estimators.motdiff.correcting import agreed_kernels, kernels_agreed_at_half
from motdiff.metrics import mnc_subpixel
from motdiff.progress import Progress
from motdiff.simulate import photograph
from motdiff.trajectory import Trajectory
from motdiff.weights import load_correction

BENT = Trajectory.from_samples([[0, 0], [9, 2], [17, 8], [22, 17]])
LOST = (Trajectory.straight(9.0, angle_rad=2.2), Trajectory.straight(20.0, angle_rad=1.4))


def photo_of(motion, *, side=256):
    rng = np.random.default_rng(0)
    scene = (data.camera()[60 : 60 + side + 64, 100 : 100 + side + 64] / 255) ** 2.2
    return photograph(scene, motion, rng=rng, read_sigma=0.005)[:side, :side]


def agreed_at_half(photo, pair):
    halved = cv2.resize(photo, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return kernels_agreed_at_half(
        load_correction(),
        photo[None],
        pair,
        halved[None],
        judge=Judge(photo[None]),
        progress=Progress(),
    )


@pytest.fixture(scope="module")
def blurred():
    return photo_of(BENT)


def test_kernels_that_differ_are_not_agreed_on(blurred):
    pair = [motion.psf(63) for motion in LOST]
    assert agreed_kernels(load_correction(), blurred[None], pair, Judge(blurred[None])) is None


def test_what_searches_agree_on_at_half_the_size_is_the_motion_of_the_photo(blurred):
    candidates = agreed_at_half(blurred, [motion.psf(63) for motion in LOST])
    (kernel,) = candidates.corrected
    assert kernel.shape == (63, 63)
    assert kernel.sum() == pytest.approx(1)
    assert mnc_subpixel(kernel, BENT.psf(63)) > 0.9
    assert candidates.confidence > 0.9
    # enlarged alone it is coarser, and lies where it lay
    (searched,) = candidates.kernels
    assert 0.6 < mnc_subpixel(searched, BENT.psf(63)) < mnc_subpixel(kernel, BENT.psf(63))


def test_a_motion_that_outgrows_the_frame_is_left_to_the_photo_at_half_its_size():
    long = Trajectory.straight(84.0, angle_rad=0.3)
    assert agreed_at_half(photo_of(long), [motion.psf(63) for motion in LOST]) is None
