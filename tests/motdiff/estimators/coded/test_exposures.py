"""Photos of one motion, compared where they are large enough beside their blur."""

import numpy as np
import pytest
from scipy import ndimage

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.exposures import Exposures, exposures_of
from motdiff.trajectory import Trajectory


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
