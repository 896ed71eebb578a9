"""Registration to whole pixels, small and large, with unequal sizes."""

import numpy as np
import pytest
from scipy import ndimage

from motdiff.estimators.reference.registration import coarse_shift, high_passed


def scene(shape: tuple[int, int]) -> np.ndarray:
    return ndimage.gaussian_filter(np.random.default_rng(0).random(shape), 2.0)


@pytest.mark.parametrize("shape", [(200, 240), (1500, 1600)])
@pytest.mark.parametrize(("dy", "dx"), [(0, 0), (17, -30), (-41, 8)])
def test_crops_of_one_scene(shape: tuple[int, int], dy: int, dx: int) -> None:
    whole = scene(shape)
    sharp = whole[50:-10, 50:-50]
    blurred = whole[50 - dy : shape[0] - 50 - dy, 50 - dx : shape[1] - 50 - dx]
    assert coarse_shift(sharp, blurred) == (dy, dx)
    assert coarse_shift(sharp, 0.3 * blurred + 0.5) == (dy, dx)
    assert coarse_shift(blurred, sharp) == (-dy, -dx)


def test_high_pass_takes_offset_and_slope_away() -> None:
    ramp = np.add.outer(np.arange(80.0), 2 * np.arange(90.0))
    assert np.abs(high_passed(ramp + 7, sigma_px=4)[20:-20, 20:-20]).max() < 1e-9
