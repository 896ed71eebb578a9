"""PSFs of a path over slices of time against a path that is sampled densely."""

import numpy as np
import pytest

from motdiff.path_psfs import interpolated, slice_of, slice_psfs

SIZE = 11
EDGES = np.array([0.1, 0.3, 0.35, 0.9])


def sampled_psfs(t, xy, edges, *, count=40_000):
    """Light of a path in each slice, shared by the four pixels around each of many moments."""
    psfs = np.zeros((len(edges) - 1, SIZE, SIZE))
    for psf, begin, end in zip(psfs, edges[:-1], edges[1:], strict=True):
        moments = begin + (end - begin) * (np.arange(count) + 0.5) / count
        x, y = (np.interp(moments, t, axis) + SIZE // 2 for axis in xy.T)
        left, top = np.floor([x, y]).astype(int)
        for right, below in np.ndindex(2, 2):
            share = np.where(right, x - left, 1 + left - x) * np.where(below, y - top, 1 + top - y)
            np.add.at(psf, (top + below, left + right), share * (end - begin) / count)
    return psfs


@pytest.mark.parametrize(
    "xy",
    [
        [(-3.2, 1.1), (0.4, -2.7), (0.4, 2.3), (3.6, 2.3), (-1.3, -3.9)],
        [(-2.0, -2.0), (0.0, 0.0), (0.0, 0.0), (2.0, 2.0), (2.0, -1.0)],  # along the pixels' grid
        [(0.25, -0.5)] * 5,  # at rest
    ],
    ids=["between pixels", "on pixels", "at rest"],
)
def test_slices_hold_the_light_of_their_time(xy):
    t = np.array([0.0, 0.15, 0.4, 0.65, 1.0])
    xy = np.array(xy)
    psfs = slice_psfs(t, xy, EDGES, SIZE)
    np.testing.assert_allclose(psfs.sum(axis=(1, 2)), np.diff(EDGES), rtol=1e-12)
    np.testing.assert_allclose(psfs, sampled_psfs(t, xy, EDGES), atol=1e-5)


def test_a_straight_path_along_a_row_gives_a_trapezoid():
    t = np.array([0.0, 1.0])
    xy = np.array([(-2.0, 0.0), (2.0, 0.0)])
    (psf,) = slice_psfs(t, xy, t, SIZE)
    np.testing.assert_allclose(psf[5, 3:8], np.array([1, 2, 2, 2, 1]) / 8, atol=1e-12)
    assert np.count_nonzero(psf) == 5


def test_the_slice_of_a_time():
    times = np.array([0.1, 0.29, 0.3, 0.34, 0.35, 0.9])
    assert slice_of(times, EDGES).tolist() == [0, 0, 1, 1, 2, 2]


def test_points_between_knots_are_on_the_line_between_theirs():
    knots = np.array([0.0, 1.0, 3.0])
    points = np.array([(0.0, 5.0), (2.0, 5.0), (2.0, 1.0)])
    assert interpolated(np.array([0.5, 2.5]), knots, points).tolist() == [[1.0, 5.0], [2.0, 2.0]]
    assert interpolated(2.0, knots, points).tolist() == [2.0, 3.0]
