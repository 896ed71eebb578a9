"""Noise of a photo: that which was added to it, whatever blur and edges it has."""

import numpy as np
import pytest
from skimage import data

from motdiff.photo_noise import noise_sigma, shared_sigma
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory


@pytest.mark.parametrize("sigma", [0.005, 0.02])
def test_noise_is_measured_on_a_blurred_photo(sigma):
    time = np.linspace(0, 1, 60)
    path = Trajectory.from_samples(np.c_[14 * time, 8 * np.sin(2.5 * time)], t=time**1.3)
    blurred = blur_valid(data.camera()[100:300, 100:300] / 255.0, path.psf(25))
    noise = np.random.default_rng(8).normal(0, sigma, blurred.shape)
    assert noise_sigma(blurred + noise) == pytest.approx(sigma, rel=0.15)


def test_crops_share_the_median():
    noise = np.random.default_rng(0).standard_normal((3, 64, 64))
    crops = np.array([0.01, 0.02, 0.3])[:, None, None] * noise
    assert shared_sigma(crops) == noise_sigma(crops[1])
