"""Codes that tell orders: the best of all where all can be tried, and within limits."""

from itertools import product

import numpy as np
import pytest

from cep.calibration.order_codes import gray_planes, longest_unseen, search_order_codes
from cep.calibration.order_separation import BLIND_ERROR, OrderSeparation, ordered_walks
from cep.search.limits import Limits, RunLimits


def found_codes(limits, photos, *, walks=6):
    rng = np.random.default_rng(4)
    measure = OrderSeparation(ordered_walks(walks, rng=rng), chips=limits.chips)
    return np.array(search_order_codes(limits, photos, measure=measure, rng=rng)), measure


def confused(measure, codes):
    return np.exp(
        -measure.of_each_motion(sum(measure.of(code) for code in codes)) / BLIND_ERROR
    ).mean()


def test_beside_an_open_photo_no_gray_plane_confuses_fewer_walks():
    codes, measure = found_codes(Limits(16, (1, 16)), 2)
    assert codes[0].tolist() == [1] * 16
    planes = [
        plane
        for count in (1, 2, 3)
        for plane in gray_planes(count, 16)
        if (plane != plane[::-1]).any()
    ]
    assert confused(measure, codes) <= min(
        confused(measure, [codes[0], plane]) for plane in planes
    )


def test_one_photo_sees_the_motion_nearly_always():
    codes, measure = found_codes(Limits(6, (1, 6)), 1)
    every = [
        bits
        for bits in product((0, 1), repeat=6)
        if any(bits) and bits != bits[::-1] and longest_unseen([bits]) <= 1
    ]
    assert longest_unseen(codes) <= 1
    assert confused(measure, codes) <= 1.25 * min(
        confused(measure, [bits]) for bits in every
    )  # a search, not a proof


@pytest.mark.parametrize(
    ("photos", "limits"),
    [
        (3, Limits(20, (4, 12), RunLimits(min_open=3, min_closed=2, max_open=6))),
        (2, Limits(24, (1, 24), RunLimits(min_open=2, max_pulses=2))),
        (1, Limits(20, (1, 20), RunLimits(min_period=6))),
    ],
)
def test_limits_are_kept(photos, limits):
    codes, _ = found_codes(limits, photos, walks=3)
    assert codes.shape == (photos, limits.chips)
    assert limits.satisfied(codes).all()
    assert any(code.tolist() != code[::-1].tolist() for code in codes)
    assert (codes[0].min() == 1) == (photos > 1 and limits.open_range[1] == limits.chips)


def test_codes_that_tell_no_direction_are_refused():
    with pytest.raises(
        ValueError, match="chips: every code of 4 chips within the limits is its own mirror image"
    ):
        found_codes(Limits(4, (4, 4)), 1, walks=2)


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
