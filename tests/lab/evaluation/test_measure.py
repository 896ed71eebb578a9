"""Figures of one photo: known values for the truth, shifts forgiven, failures kept."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import ndimage

from lab.evaluation.floors import delta, gaussian
from lab.evaluation.measure import measure_estimator, measure_psf, restored
from lab.evaluation.sets import Case
from motdiff.estimators.base import MotionEstimate
from motdiff.metrics import psnr_up_to_shift
from motdiff.motions import boracchi_foi
from motdiff.simulate import photograph, visible
from motdiff.trajectory import Trajectory


@dataclass(frozen=True)
class Says:
    """An estimator that always gives the same answer."""

    answer: MotionEstimate | Exception

    def estimate(self, photo):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def scene(seed, shape=(170, 170)):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), 4)
    return np.digitize(noise / noise.std(), [-1, -0.3, 0.3, 1]) / 5 + 0.1


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(4)
    motion = boracchi_foi(rng, max_length_px=30.0)
    return Case(
        photograph(scene(1), motion.psf(64), rng=rng, read_sigma=0.002),
        motion.psf(64),
        visible(scene(1), 64),
        motion,
    )


def answer(trajectory, psf, confidence=0.8):
    return MotionEstimate("fake", (trajectory,), (1.0,), psf, confidence)


def test_the_truth_is_perfect(case):
    told = Says(answer(case.trajectory, case.psf))
    row = measure_estimator(case, told, restore=False)
    assert (row.mnc, row.mnc_subpixel, row.path_mnc) == pytest.approx((1, 1, 1))
    assert row.path_px == pytest.approx(0, abs=1e-9)
    assert row.confidence == 0.8
    assert row.cpu_s >= 0
    assert math.isnan(row.psnr_db)
    assert math.isnan(row.ssim)


def test_direction_cannot_be_known_from_one_photo(case):
    told = Says(answer(case.trajectory.reversed(), case.psf))
    assert measure_estimator(case, told, restore=False).path_px == pytest.approx(0, abs=1e-9)


def test_the_path_is_judged_by_its_own_psf_even_a_long_one(case):
    told = Says(answer(Trajectory.straight(90.0), case.psf))
    row = measure_estimator(case, told, restore=False)
    assert row.mnc_subpixel == pytest.approx(1)
    assert row.path_mnc < 0.6
    assert row.path_px > 10


def test_without_a_true_path_or_a_sharp_photo_there_is_nothing_to_compare(case):
    bare = replace(case, trajectory=None, sharp=None)
    row = measure_estimator(bare, Says(answer(case.trajectory, case.psf)))
    assert math.isnan(row.path_px)
    assert math.isnan(row.psnr_db)
    assert row.path_mnc == pytest.approx(1)


def test_draws_are_measured_where_there_are_several(case):
    blob = gaussian(5.0)
    point = delta()
    told = answer(case.trajectory, blob)
    assert math.isnan(measure_estimator(case, Says(told), restore=False).best_draw)
    row = measure_estimator(
        case, Says(replace(told, draws=(blob, case.psf, point))), restore=False
    )
    assert row.mnc < 0.9  # the estimate is the blob still
    assert (row.best_draw, row.covered) == pytest.approx((1, 1))
    assert row.draws_alike < 0.9


def test_kernels_are_ranked_by_the_photos_they_restore(case):
    truth, blob, none = (measure_psf(case, psf) for psf in (case.psf, gaussian(5.0), delta()))
    assert truth.psnr_db > none.psnr_db + 2 > blob.psnr_db
    assert truth.ssim > none.ssim
    assert math.isnan(truth.confidence)


def test_a_kernel_may_lie_anywhere(case):
    here = measure_psf(case, case.psf)
    for move in ((7, -9), (-12, 3)):
        there = measure_psf(case, np.roll(np.pad(case.psf, 3), move, axis=(0, 1)))
        assert there.psnr_db == pytest.approx(here.psnr_db, abs=0.2)
        assert there.mnc == pytest.approx(here.mnc)


@pytest.mark.parametrize(
    "wrong",
    [
        ValueError("photo: too dark\nand more"),
        answer(Trajectory.straight(5.0), np.full((64, 64), np.nan)),
        answer(Trajectory.straight(5.0), np.zeros((64, 64))),
    ],
)
def test_what_cannot_be_measured_is_refused(case, wrong):
    with pytest.raises(ValueError, match=r"^photo: too dark|finite|zero"):
        measure_estimator(case, Says(wrong), restore=False)


def test_colour_photos_are_restored_by_their_luminance(case):
    grey = measure_psf(case, case.psf)
    coloured = Case(np.stack([case.photo] * 3, 2), case.psf, np.stack([case.sharp] * 3, 2))
    assert measure_psf(coloured, case.psf).psnr_db == pytest.approx(grey.psnr_db, abs=1e-6)


def test_restoration_with_no_blur_keeps_the_photo():
    photo = scene(2, (90, 100))
    out = restored(photo, delta(9))
    assert out.shape == photo.shape
    assert psnr_up_to_shift(out, photo) > 30
