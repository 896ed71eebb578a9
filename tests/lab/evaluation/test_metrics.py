"""Metrics of the tables: order counts, direction does not; a shift is taken out first."""

import numpy as np
import pytest
from scipy import ndimage

from lab.evaluation.metrics import laid_on, ordered_distance_px, psnr_ssim_up_to_shift
from motdiff.metrics import psnr_up_to_shift
from motdiff.psf_frame import moved


def loop():
    """A leg out, a circle, and the leg on."""
    legs = np.linspace(0, 12, 200)
    turn = np.linspace(-np.pi / 2, 1.5 * np.pi, 400)
    circle = np.column_stack([12 + 6 * np.cos(turn), 6 + 6 * np.sin(turn)])
    straight = np.column_stack([legs, np.zeros(200)])
    return np.concatenate([straight, circle, straight + np.array([12.0, 0.0])])


def test_ordered_distance_is_zero_for_a_path_and_its_reverse_and_sees_a_loop_run_backwards():
    legs = loop()
    assert ordered_distance_px(legs, legs[::-1]) == pytest.approx(0, abs=1e-9)
    turned = np.concatenate([legs[:200], legs[200:600][::-1], legs[600:]])
    assert ordered_distance_px(legs, turned) > 1.0
    assert ordered_distance_px([[0, 0], [10, 0]], [[0, 1], [10, 1]]) == pytest.approx(1.0)
    with pytest.raises(ValueError, match=r"^b: must be"):
        ordered_distance_px(legs, [[1, 2, 3]])


@pytest.mark.parametrize("shift", [(0, 3), (-4, 2), (1.25, -2.5)])
def test_psnr_and_ssim_up_to_shift(shift):
    rng = np.random.default_rng(0)
    image = ndimage.gaussian_filter(rng.standard_normal((90, 110)), 2)
    image = (image - image.min()) / np.ptp(image)
    displaced = ndimage.shift(image, shift, order=5, mode="nearest")
    psnr_db, ssim = psnr_ssim_up_to_shift(displaced, image)
    assert psnr_db == psnr_up_to_shift(displaced, image)
    assert ssim > 0.97


@pytest.mark.parametrize("shape", [(9, 9), (8, 8), (7, 12)])
def test_a_psf_is_laid_on_the_true_one(shape):
    psf = np.random.default_rng(2).random(shape)
    displaced = moved(psf, down_px=-3, right_px=5)
    np.testing.assert_array_equal(laid_on(psf, displaced)[10:-10, 10:-10], psf)
