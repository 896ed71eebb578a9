"""The search for one more code that tells orders: near the best of all, and within limits."""

import itertools

import numpy as np
import pytest

from cep.calibration.order_codes import _neighbours, gray_planes, longest_rest, search_next
from cep.calibration.order_contrast import OrderContrast
from cep.search.limits import Limits, RunLimits

CHIPS = 8
OPEN = np.ones(CHIPS)
TIMES = np.linspace(0, 1, 53)
# a straight run, a loop, and a run on; and all of it backwards
ANGLE = 2 * np.pi * np.clip((TIMES - 0.25) / 0.5, 0, 1)
LOOP = np.stack(
    [40 * TIMES - 8 * np.sin(ANGLE) - 20 * np.clip(TIMES - 0.25, 0, 0.5), 8 - 8 * np.cos(ANGLE)],
    axis=1,
)
ORDERS = np.stack([LOOP, LOOP[::-1]])


@pytest.mark.parametrize("runs", [RunLimits(), RunLimits(min_open=2)])
def test_the_search_comes_near_the_best_of_all_codes(runs):
    limits = Limits(CHIPS, (1, CHIPS), runs)
    codes = np.array(list(itertools.product((0, 1), repeat=CHIPS)), dtype=np.int8)
    rests = np.array([longest_rest([code]) for code in codes])
    codes = codes[limits.satisfied(codes) & (rests <= 3)]  # log2 of 8 chips
    contrast = OrderContrast(ORDERS, [OPEN], chips=CHIPS)
    best = contrast.of(codes).min(axis=1).max()
    code, least = search_next(contrast, limits, rng=np.random.default_rng(1))
    assert limits.satisfied(code[None])[0]
    assert longest_rest([code]) <= 3
    assert 0.9 * best < least <= (1 + 1e-3) * best


def test_a_shutter_rests_no_longer_than_the_photos_before_leave_it():
    contrast = OrderContrast(ORDERS, [np.ones(52)], chips=52)
    limits = Limits(52, (1, 52))
    code, _ = search_next(contrast, limits, rng=np.random.default_rng(3))
    assert longest_rest([code]) <= 6
    fine = np.tile([1, 0], 26)  # it switches at every chip, so the next code may rest
    finely = OrderContrast(ORDERS, [np.ones(52), fine], chips=52)
    free, least = search_next(finely, limits, rng=np.random.default_rng(3))
    assert finely.of([code]).min() <= least == finely.of([free]).min()


def test_of_other_scores_the_best_code_is_found_as_well():
    codes = np.array(list(itertools.product((0, 1), repeat=CHIPS)), dtype=np.int8)
    codes = codes[[code.any() and longest_rest([code]) <= 3 for code in codes]]
    contrast = OrderContrast(np.stack([*ORDERS, 0.7 * LOOP[::-1]]), [OPEN], chips=CHIPS)

    def mean(chi_squares):
        return chi_squares.mean(axis=1)

    code, value = search_next(
        contrast, Limits(CHIPS, (1, CHIPS)), score=mean, rng=np.random.default_rng(1)
    )
    assert value == pytest.approx(contrast.of([code]).mean(), rel=1e-3)
    assert value >= 0.9 * mean(contrast.of(codes)).max()


def test_neighbours_move_an_edge_all_edges_or_a_chip():
    code = np.array([0, 0, 0, 1, 1, 1, 0, 0], dtype=np.int8)
    first_edge = {"01111100", "00111100", "00001100", "00000100"}
    second_edge = {"00010000", "00011000", "00011110", "00011111"}
    turned = {"11100000", "00111000", "00001110", "10000011"}
    chip = {"10011100", "01011100", "00111100", "00001100"}
    chip |= {"00010100", "00011000", "00011110", "00011101"}
    neighbours = _neighbours(Limits(CHIPS, (1, CHIPS)), code)
    found = {"".join(map(str, neighbour)) for neighbour in neighbours}
    assert found == first_edge | second_edge | turned | chip
    # at most three open chips, and no run of one
    few = _neighbours(Limits(CHIPS, (1, 3), RunLimits(min_open=2)), code)
    assert {"".join(map(str, neighbour)) for neighbour in few} == {
        "00001100",
        "00011000",
        "00111000",
        "00001110",
        "11100000",
    }


def test_neighbouring_bins_of_a_gray_code_differ_in_one_plane():
    planes = gray_planes(3, 52)
    changes = abs(np.diff(planes, axis=1)).sum(axis=0)
    assert changes.max() == 1
    assert changes.sum() == 7
    assert [int("".join(map(str, column)), 2) for column in gray_planes(3, 8).T] == [
        0,
        1,
        3,
        2,
        6,
        7,
        5,
        4,
    ]
