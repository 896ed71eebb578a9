"""An uneven blur: told where crops need kernels of their own, not where a search in one of them
was lost."""

import re

import numpy as np
import pytest

from motdiff.estimators.kernel_score import uneven_blur_warning
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory


def line(length_px, angle_rad, *, side=32):
    return Trajectory.straight(length_px, angle_rad=angle_rad).psf(side)


def scene(seed, side):
    """Blocks of random brightness: edges everywhere."""
    rng = np.random.default_rng(seed)
    image = np.zeros((side, side))
    for _ in range(400):
        row, column, height, width = (*rng.integers(side, size=2), *rng.integers(4, 40, size=2))
        image[row : row + height, column : column + width] = rng.random()
    return image


def crops(*psfs):
    rng = np.random.default_rng(1)
    blurred = [
        blur_valid(scene(seed, 192 + psf.shape[0] - 1), psf) for seed, psf in enumerate(psfs)
    ]
    return np.stack([one + 0.004 * rng.standard_normal(one.shape) for one in blurred])


ALONG, ACROSS, SLANTED = (line(14, angle_rad) for angle_rad in (0.0, np.pi / 2, 0.7))


def odd(psf):
    return psf[1:, 1:] / psf[1:, 1:].sum()


def test_one_blur_is_even_whatever_a_lost_search_says():
    photos = crops(ALONG, ALONG, ALONG)
    for own in ([ALONG] * 3, [ALONG, ACROSS, SLANTED], [ACROSS] * 3):
        assert uneven_blur_warning(photos, own, odd(ALONG)) is None


def test_a_poor_shared_kernel_is_not_an_uneven_blur():
    assert uneven_blur_warning(crops(ALONG, ALONG), [ALONG, ALONG], odd(ACROSS)) is None


@pytest.mark.parametrize("shared", [ALONG, (ALONG + ACROSS) / 2])
def test_crops_with_a_blur_of_their_own_are_counted(shared):
    said = uneven_blur_warning(crops(ALONG, ACROSS, ALONG), [ALONG, ACROSS, ALONG], odd(shared))
    assert said is not None
    told = re.fullmatch(
        r"The blur differs across the photo \(1 of 3 crops have another one, mutual MNC"
        r" (0\.\d\d)\): no single "
        r"trajectory fits\.",
        said,
    )
    assert told is not None
    assert float(told[1]) < 0.5


def test_where_no_two_crops_share_a_blur_at_least_two_differ():
    said = uneven_blur_warning(crops(ALONG, ACROSS, SLANTED), [ALONG, ACROSS, SLANTED], odd(ALONG))
    assert said is not None
    assert "2 of 3 crops" in said


def test_odd_frames_and_a_single_crop_do_as_well():
    assert uneven_blur_warning(crops(ALONG), [odd(ACROSS)], odd(ALONG)) is None
