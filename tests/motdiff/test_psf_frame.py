"""The frame of PSFs: zero displacement keeps its index, whatever the kernel's size; whole-pixel
moves; faint light."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motdiff.psf_frame import (
    MAP_CENTRE,
    MAP_PITCH,
    MAP_PX,
    PSF_PX,
    centred,
    centroid_px,
    in_frame,
    margins,
    moved,
    without_faint_light,
)
from motdiff.trajectory import Trajectory

SIDES = st.integers(1, 20)


@given(rows=SIDES, columns=SIDES, size=SIDES, seed=st.integers(0, 99))
def test_a_kernel_keeps_its_displacements_in_any_frame(rows, columns, size, seed):
    kernels = np.random.default_rng(seed).random((2, rows, columns))
    framed = in_frame(kernels, size)
    assert framed.shape == (2, size, size)
    for y, x in np.ndindex(rows, columns):
        row = y - rows // 2 + size // 2
        column = x - columns // 2 + size // 2
        if 0 <= row < size and 0 <= column < size:
            np.testing.assert_array_equal(framed[:, row, column], kernels[:, y, x])
            framed[:, row, column] = 0
    assert not framed.any()


@given(side=SIDES, size=SIDES)
def test_margins_fill_the_frame(side, size):
    before, after = margins(side, size)
    assert before + side + after == size
    assert before + side // 2 == size // 2


def test_the_hr_map_lies_on_the_psf_frame():
    point = np.zeros((MAP_PX, MAP_PX))
    middle = round(MAP_CENTRE - 0.5)
    point[middle : middle + 2, middle : middle + 2] = 1
    box_means = point.reshape(PSF_PX, MAP_PITCH, PSF_PX, MAP_PITCH).mean(axis=(1, 3))
    assert np.argwhere(box_means).tolist() == [[PSF_PX // 2, PSF_PX // 2]]


@pytest.mark.parametrize("shape", [(9, 9), (8, 8), (7, 12)])
def test_a_move_shifts_the_centroid_and_loses_nothing(shape):
    psf = np.random.default_rng(2).random(shape)
    there = moved(psf, down_px=-3, right_px=5)
    assert there.sum() == pytest.approx(psf.sum())
    np.testing.assert_allclose(np.subtract(centroid_px(there), centroid_px(psf)), (-3, 5))
    assert np.abs(centroid_px(centred(there))).max() <= 0.5


def test_light_is_faint_by_the_peak_of_its_own_kernel():
    kernels = np.array([[[4.0, 1.0]], [[0.4, 0.1]], [[1.0, 0.2]]])
    assert without_faint_light(kernels, below=0.25).tolist() == [[[4, 1]], [[0.4, 0.1]], [[1, 0]]]
    assert centroid_px(np.zeros((3, 3))) == (0, 0)


def test_a_path_gets_the_usual_frame_or_the_one_that_it_needs():
    long = Trajectory.straight(90.0)
    assert Trajectory.straight(9.0).frame_size(PSF_PX) == PSF_PX
    assert long.frame_size(PSF_PX) == long.frame_size() > PSF_PX
