"""The frame of a dwell's fit: no light of the path is beyond it, wherever the path is moved."""

import numpy as np
import pytest

from motdiff.path_psfs import slice_psfs
from motdiff.tracing.dwell import _MOST_SHIFT_PX, _piece_psfs

ONCE = np.array([0.0, 1.0])


@pytest.mark.parametrize("side", [41, 15, 9])
def test_the_frame_holds_the_path_wherever_its_shift_may_be(side):
    ends = np.array([(-3.0, 0.0), (1.0, 1.0)])
    for shift in (-_MOST_SHIFT_PX, 0.0, _MOST_SHIFT_PX):
        (psf,) = slice_psfs(ONCE, ends + shift, ONCE, 41)
        cut = (41 - side) // 2
        light = psf[cut : 41 - cut, cut : 41 - cut]
        pieces, target = _piece_psfs(np.linspace(*ends, 9), light)
        assert pieces.shape[1:] == target.shape
        np.testing.assert_allclose(pieces.sum(axis=(1, 2)), 1)
        # light that the photo's frame had is in the fit's
        assert target.sum() == pytest.approx(light.sum())
    assert light.sum() == pytest.approx(1)
