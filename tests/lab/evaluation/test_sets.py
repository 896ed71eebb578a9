"""Levin's photos: their convention, and what is no such file."""

import numpy as np
import pytest
from scipy import io, ndimage, signal

from lab.evaluation.measure import restored
from lab.evaluation.sets import levin_photo
from motdiff.metrics import psnr_up_to_shift
from motdiff.motions import boracchi_foi


def test_levins_kernel_is_turned(tmp_path):
    kernel = boracchi_foi(np.random.default_rng(1), max_length_px=30.0).psf(31)
    noise = ndimage.gaussian_filter(np.random.default_rng(3).standard_normal((190, 190)), 4)
    sharp = (
        np.digitize(noise / noise.std(), [-1, -0.3, 0.3, 1]) / 5 + 0.1
    )  # flat patches: edges in every direction
    blurred = signal.convolve(
        sharp, kernel[::-1, ::-1], mode="valid"
    )  # x convolved with rot180(f)
    stored = {"x": sharp[15:-15, 15:-15], "y": blurred, "f": 3 * kernel}
    io.savemat(tmp_path / "im01_ker01.mat", stored)
    case = levin_photo(tmp_path / "im01_ker01.mat")
    assert case.trajectory is None
    assert case.psf.sum() == pytest.approx(1)
    np.testing.assert_allclose(case.psf, kernel[::-1, ::-1] / kernel.sum())
    right, wrong = (
        psnr_up_to_shift(restored(case.photo, psf), case.sharp)
        for psf in (case.psf, case.psf[::-1, ::-1])
    )
    assert right > wrong + 3


def test_levins_variables_are_checked(tmp_path):
    io.savemat(tmp_path / "a.mat", {"x": np.ones((3, 3)), "y": np.ones((3, 3))})
    with pytest.raises(ValueError, match=r"a\.mat: lacks the variable f"):
        levin_photo(tmp_path / "a.mat")
