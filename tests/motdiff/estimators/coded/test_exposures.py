"""Photos of one motion, compared where they are large enough beside their blur."""

import numpy as np
import pytest

from motdiff.estimators.coded.exposures import Exposures


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
