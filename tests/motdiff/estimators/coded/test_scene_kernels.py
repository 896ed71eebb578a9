"""Kernels of photos of one scene, searched together, against the PSFs that blurred them."""

import numpy as np
import pytest

from motdiff.estimators.coded import scene_kernels
from motdiff.estimators.coded.scene_kernels import kernels_of_one_scene
from motdiff.estimators.pmp.estimator import PmpEstimator
from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import in_frame
from motdiff.simulate import photograph
from motdiff.trajectory import Trajectory

SHIFT_PX = (1.0, -2.0)
CODE = "0100000000011110001101000000110000100111100000000101"


def figure_of_eight():
    turn = 2 * np.pi * np.linspace(0, 1, 80)
    return Trajectory.from_samples(np.stack([14 * np.sin(turn), 10 * np.sin(2 * turn)], axis=1))


@pytest.fixture(scope="module")
def blocks():
    """Photos of blocks at random through an open shutter and a code, and their PSFs."""

    def taken(coded_psf):
        rng = np.random.default_rng(0)
        scene = np.kron(rng.random((50, 50)), np.ones((5, 5)))
        path = figure_of_eight()
        psfs = [coded_psf(path, "1" * 52), coded_psf(path, CODE, shift_px=SHIFT_PX)]
        photos = [photograph(scene, psf, rng=rng, read_sigma=0.003) for psf in psfs]
        return photos, [psf / psf.sum() for psf in psfs]

    return taken


@pytest.mark.slow(reason="searches kernels from four starts, together and alone")
def test_kernels_found_together_are_better_than_alone(blocks, coded_psf):
    photos, psfs = blocks(coded_psf)
    kernels, confidences = kernels_of_one_scene(photos)
    together = [mnc_subpixel(kernel, psf) for kernel, psf in zip(kernels, psfs, strict=True)]
    alone = [
        mnc_subpixel(PmpEstimator(crops=1).estimate(photo).psf, psf)
        for photo, psf in zip(photos, psfs, strict=True)
    ]
    assert min(together) > max(alone)
    assert min(together) > 0.8
    assert min(confidences) > 0.5
    # the kernels' shift against each other is the photos': one shift aligns both
    assert mnc_subpixel(np.hstack(kernels), np.hstack([in_frame(psf, 64) for psf in psfs])) > 0.8


def test_the_true_kernels_leave_about_the_noise(blocks, coded_psf):
    photos, psfs = blocks(coded_psf)
    crops = np.stack([photo / photo.mean() for photo in photos])
    sigmas = np.array([0.003 / photo.mean() for photo in photos])
    true = scene_kernels._cross_misfit(crops, np.stack(psfs), sigmas)
    swapped = scene_kernels._cross_misfit(crops, np.stack(psfs[::-1]), sigmas)
    assert 0.5 < true < 3
    assert swapped > 30 * true
    # whatever the photos' unit
    assert scene_kernels._cross_misfit(3 * crops, np.stack(psfs), 3 * sigmas) == pytest.approx(
        true
    )
