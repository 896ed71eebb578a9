"""Photos of one motion, compared where large enough beside their blur, and their kernels."""

import numpy as np
import pytest
from scipy import ndimage

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded import exposures
from motdiff.estimators.coded.exposures import Exposures, exposures_of, kernels_of_one_scene
from motdiff.estimators.pmp.estimator import PmpEstimator
from motdiff.metrics import mnc_subpixel
from motdiff.progress import Progress
from motdiff.psf_frame import in_frame
from motdiff.simulate import photograph
from motdiff.trajectory import Trajectory

SHIFT_PX = (1.0, -2.0)
CODE = "0100000000011110001101000000110000100111100000000101"


@pytest.mark.parametrize(("extent_px", "grids"), [(24, 3), (45, 0)])
def test_photos_are_compared_where_enough_of_them_lies_inside_their_borders(extent_px, grids):
    rng = np.random.default_rng(0)
    kernel = np.zeros((65, 65))
    kernel[32, 32 - extent_px // 2 : 33 + extent_px // 2] = 1 / (extent_px + 1)
    exposures = Exposures(
        codes=("1111", "1011"),
        kernels=(kernel, kernel),
        weights=np.ones(2),
        gains=np.ones(2),
        photos=tuple(rng.random((128, 128)) for _ in range(2)),
    )
    assert len(exposures.spectra()) == grids


class Unblurred:
    """Estimator that calls every photo sharp, in no time."""

    def estimate(self, photo):
        path = Trajectory.straight(1.0)
        return MotionEstimate("oracle", (path,), (1.0,), path.psf(64), 0.9)


def scene(seed):
    """Random detail, of which much is coarser than blurs are."""
    noise = np.random.default_rng(seed).random((320, 320))
    return (
        sum(ndimage.gaussian_filter(noise, sigma, mode="wrap") * sigma for sigma in (1, 6, 20))
        % 1.0
    )


@pytest.mark.parametrize("shift", [(3, -2), (25, 40), (-44, 18)])
def test_photos_of_one_scene_are_laid_on_each_other(shift):
    """Up to a quarter of their size apart."""
    down, right = shift
    whole = scene(1)
    photos = [
        whole[60:260, 60:260],
        0.8 * whole[60 + down : 260 + down, 60 + right : 260 + right],
    ]
    exposures = exposures_of(photos, ["1111", "1011"], kernels=Unblurred())
    first, second = exposures.photos
    middle = (slice(20, 100),) * 2  # moved by a few px at most
    coarse = [ndimage.gaussian_filter(photo, 4)[middle].ravel() for photo in (first, second)]
    assert np.corrcoef(*coarse)[0, 1] > 0.95 or max(map(abs, shift)) < 5
    assert first.shape == second.shape
    assert min(first.shape) >= 200 - max(map(abs, shift)) - 2


def test_photos_of_other_scenes_are_not():
    photos = [scene(seed)[60:260, 60:260] for seed in (1, 2)]
    assert exposures_of(photos, ["1111", "1011"], kernels=Unblurred()).photos == ()


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
    true = exposures._cross_misfit(crops, np.stack(psfs), sigmas)
    swapped = exposures._cross_misfit(crops, np.stack(psfs[::-1]), sigmas)
    assert 0.5 < true < 3
    assert swapped > 30 * true
    # whatever the photos' unit
    assert exposures._cross_misfit(3 * crops, np.stack(psfs), 3 * sigmas) == pytest.approx(true)


def test_all_searches_together_take_the_planned_share(monkeypatch, coded_psf, blocks):
    photos, psfs = blocks(coded_psf)

    def searched(_crops, _start, *, on_progress, **_options):
        on_progress(0.5)
        on_progress(1.0)
        return np.stack([in_frame(psf, 64) for psf in psfs])

    monkeypatch.setattr(exposures, "searched_kernels", searched)
    shares = []
    progress = Progress(shares.append)
    progress.expect(40.0)
    kernels_of_one_scene(photos, progress=progress, cost=10.0)
    assert len(shares) == 2 * len(exposures.STARTS)
    assert shares[-1] == pytest.approx(0.25)
