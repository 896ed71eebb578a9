"""Codes within limits: counted, drawn and refused as brute force does."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.code import ShutterCode
from cep.search import sampling
from cep.search.limits import (
    Limits,
    RunLimits,
    _fewest_pulses,
    check_feasible,
    conflicting,
    feasible,
    nearest,
)
from cep.search.sampling import draw


@st.composite
def some_limits(draw_one, most_chips=10, runs=True):
    chips = draw_one(st.integers(1, most_chips))
    low = draw_one(st.integers(1, chips))
    return Limits(
        chips,
        (low, draw_one(st.integers(low, chips))),
        RunLimits(
            min_open=draw_one(st.integers(1, 4)),
            min_closed=draw_one(st.integers(1, 4)),
            max_pulses=draw_one(st.none() | st.integers(1, 4)),
            max_open=draw_one(st.none() | st.integers(1, 6)) if runs else None,
            min_period=draw_one(st.integers(1, 8)) if runs else 1,
        ),
    )


def keeps(bits, limits):
    """Say it chip by chip, run by run."""
    if "1" not in bits:
        return False
    runs = ShutterCode(bits.strip("0")).runs
    starts = [place for place, bit in enumerate(bits) if bit == "1" and bits[:place][-1:] != "1"]
    return (
        limits.open_range[0] <= bits.count("1") <= limits.open_range[1]
        and all(
            length >= (limits.runs.min_open if bit else limits.runs.min_closed)
            for bit, length in runs
        )
        and (limits.runs.max_pulses is None or ShutterCode(bits).pulses <= limits.runs.max_pulses)
        and (
            limits.runs.max_open is None
            or all(length <= limits.runs.max_open for bit, length in runs if bit)
        )
        and all(
            after - before >= limits.runs.min_period
            for before, after in itertools.pairwise(starts)
        )
    )


def count(limits):
    """Number of codes, by the table that the walks are drawn from."""
    return np.exp(np.logaddexp.reduce(sampling._by_open_chips(limits)))


def every_code(limits):
    everything = ("".join(bits) for bits in itertools.product("01", repeat=limits.chips))
    return {bits for bits in everything if keeps(bits, limits)}


def text_of(codes):
    return ["".join(map(str, code)) for code in codes]


@given(some_limits(), st.integers(0, 99))
@settings(max_examples=150, deadline=None)
def test_counts_and_draws_are_those_of_enumeration(limits, seed):
    codes = every_code(limits)
    assert feasible(limits) == bool(codes)
    if codes:
        assert count(limits) == pytest.approx(len(codes))
        assert set(text_of(draw(limits, 30, rng=np.random.default_rng(seed)))) <= codes


@given(some_limits(most_chips=12))
@settings(max_examples=150, deadline=None)
def test_longest_runs_and_least_periods_are_those_of_enumeration(limits):
    codes = every_code(limits)
    assert feasible(limits) == bool(codes)
    if codes:
        assert count(limits) == pytest.approx(len(codes))


@given(some_limits())
@settings(max_examples=100, deadline=None)
def test_fewest_pulses_are_those_of_enumeration(limits):
    closed_form = _fewest_pulses(limits)
    free = replace(limits, runs=replace(limits.runs, max_pulses=None))
    fewest = {}
    for bits in every_code(free):
        pulses = ShutterCode(bits).pulses
        fewest[bits.count("1")] = min(pulses, fewest.get(bits.count("1"), pulses))
    for open_chips in range(limits.open_range[0], limits.open_range[1] + 1):
        assert closed_form[open_chips] == fewest.get(open_chips, 1 << 30)


@given(some_limits(most_chips=60, runs=False))
@settings(max_examples=60, deadline=None)
def test_compositions_and_walks_count_the_same(limits):
    """Both are drawn from."""
    if feasible(limits):
        compositions = np.exp(np.logaddexp.reduce(sampling._free_table(limits), axis=None))
        assert compositions == pytest.approx(count(limits), rel=1e-8)


@pytest.mark.parametrize(
    "limits",
    [
        Limits(7, (1, 7)),
        Limits(8, (4, 4)),
        Limits(9, (3, 6), RunLimits(min_open=2, min_closed=2, max_pulses=2)),
        Limits(9, (1, 9), RunLimits(min_closed=3)),
        Limits(9, (1, 9), RunLimits(max_open=2)),
        Limits(9, (1, 9), RunLimits(min_period=4)),
        Limits(10, (3, 6), RunLimits(min_closed=2, max_open=3, min_period=4)),
        Limits(10, (1, 10), RunLimits(min_open=2, max_pulses=3, max_open=2, min_period=5)),
        Limits(10, (2, 7), RunLimits(max_pulses=2, max_open=4, min_period=6)),
    ],
)
@pytest.mark.parametrize("closed_form", [True, False])
def test_every_code_is_equally_likely(limits, closed_form):
    codes = sorted(every_code(limits))
    rng = np.random.default_rng(3)
    many = 200 * len(codes)
    drawn = draw(limits, many, rng=rng) if closed_form else sampling._draw_walks(limits, many, rng)
    assert drawn.dtype == np.int8
    found, counts = np.unique(text_of(drawn), return_counts=True)
    assert found.tolist() == codes
    # chi-square of this many degrees of freedom: mean dof, variance 2 dof
    dof = len(codes) - 1
    assert ((counts - 200) ** 2 / 200).sum() < dof + 4 * np.sqrt(2 * dof)


def test_published_numbers():
    assert count(Limits(52, (26, 26))) == pytest.approx(495918532948104)  # 52 over 26
    one_run = Limits(30, (1, 30), RunLimits(min_closed=29))  # anywhere
    assert count(one_run) == pytest.approx(30 * 31 / 2)
    lucas = Limits(20, (1, 20), RunLimits(min_open=20))
    assert count(lucas) == pytest.approx(1)
    # words without two ones in a row (Fibonacci) and without three (tribonacci), less the one
    # without any
    assert count(Limits(30, (1, 30), RunLimits(max_open=1))) == pytest.approx(2178309 - 1)
    assert count(Limits(30, (1, 30), RunLimits(max_open=2))) == pytest.approx(98950096 - 1)
    # ones at least three apart (Narayana's cows)
    assert count(Limits(30, (1, 30), RunLimits(max_open=1, min_period=3))) == pytest.approx(
        125491 - 1
    )


@pytest.mark.slow  # codes of 600 chips
@pytest.mark.parametrize("chips", [200, 600])
def test_long_codes_keep_their_limits(chips):
    limits = Limits(
        chips,
        (chips // 3, chips // 2),
        RunLimits(min_open=2, min_closed=3, max_pulses=30),
    )
    for one in (
        limits,
        replace(limits, runs=replace(limits.runs, max_open=chips // 20 + 10, min_period=9)),
    ):
        check_feasible(one)
        codes = text_of(draw(one, 8, rng=np.random.default_rng(0)))
        assert all(keeps(bits, one) for bits in codes)
        assert len(set(codes)) == 8


def test_too_large_a_table_is_refused():
    limits = Limits(4000, (100, 2000), RunLimits(max_pulses=30, max_open=90, min_period=3))
    with pytest.raises(ValueError, match=r"^chips: 4000 are too many for a limit on pulses"):
        draw(limits, 1, rng=np.random.default_rng(0))


@given(some_limits(), st.text("01", min_size=10, max_size=10))
@settings(max_examples=150, deadline=None)
def test_the_nearest_code_within_limits_is_that_of_brute_force(limits, bits):
    kept = every_code(limits)
    bits = bits[: limits.chips]
    if not kept:
        return
    near = "".join(map(str, nearest(limits, np.array([int(bit) for bit in bits]))))
    assert near in kept

    def apart(one):
        return sum(a != b for a, b in zip(one, bits, strict=True))

    assert apart(near) == min(map(apart, kept))


@given(some_limits(most_chips=9))
@settings(max_examples=150, deadline=None)
def test_conflicts_are_real_and_smallest(limits):
    names = conflicting(limits)

    def codes_with(kept):
        runs = {name: getattr(limits.runs, name) for name in kept if name != "open_range"}
        light = limits.open_range if "open_range" in kept else (1, limits.chips)
        return every_code(Limits(limits.chips, light, RunLimits(**runs)))

    assert bool(names) == (not every_code(limits))
    if names:
        assert not codes_with(names)
        for name in names:
            assert codes_with(set(names) - {name})


@pytest.mark.parametrize(
    ("limits", "line"),
    [
        (
            Limits(9, (1, 9), RunLimits(min_open=4, max_open=3)),
            "min_open 4 and max_open 3 conflict: no code of 9 chips keeps both",
        ),
        (
            Limits(20, (9, 20), RunLimits(max_open=3, min_period=9)),
            (
                "open_range 9..20, max_open 3 and min_period 9 conflict: no code of 20 chips keeps"
                " all 3"
            ),
        ),
        (
            Limits(9, (2, 3), RunLimits(min_open=4)),
            "open_range 2..3 and min_open 4 conflict: no code of 9 chips keeps both",
        ),
    ],
)
def test_the_line_names_what_conflicts(limits, line):
    with pytest.raises(ValueError, match=r".") as caught:
        check_feasible(limits)
    assert str(caught.value) == line
