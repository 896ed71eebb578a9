"""Judging codes for motions that may run backwards, and translating a shutter's limits."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_resolved
from cep.optics.response import ShutterResponse
from cep.proofs.measure import measure, measure_worst
from cep.search.limits import RunLimits
from cep.search.playable import limits_of_device, response_of_device
from cep.search.problem import SearchProblem
from hw.device import DeviceProfile, load_profile
from hw.program import Program
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
CODE = ShutterCode("110100011")


def test_an_unknown_direction_is_judged_by_the_worse_one():
    forward = measure(BENT, CODE)
    reverse = measure(BENT.reversed(), CODE)
    assert forward.mse_db != pytest.approx(reverse.mse_db)
    judged = measure_worst(BENT, CODE)
    assert judged.mse_db == max(forward.mse_db, reverse.mse_db)
    assert judged.min_mtf == min(forward.min_mtf, reverse.min_mtf)
    assert measure_worst(Trajectory(BENT.t, BENT.xy, "known"), CODE) == forward


def test_resolution_ends_at_a_quarter_pixel():
    path = Trajectory.straight(10.0)
    check_resolved(path, 40)
    with pytest.raises(ValueError, match="at most 40 can be resolved"):
        check_resolved(path, 41)
    check_resolved(Trajectory.straight(0.01), 1)


@pytest.mark.parametrize("length_px", [0.0, 1e-300, 1e-12])
def test_a_path_that_goes_nowhere_is_told_so(length_px):
    path = Trajectory.straight(length_px)
    check_resolved(path, 1)
    with pytest.raises(
        ValueError, match=r"stays in place, a code of 8 chips needs a motion of at least 2 px"
    ):
        check_resolved(path, 8)


def test_a_devices_limits_in_chips():
    slow = DeviceProfile(
        name="slow",
        min_on_ns=1_500,
        max_on_ns=5_999,
        on_bias_ns=200,
        tick_ns=100,
        min_off_ns=900,
        dead_time_ns=2_100,
        max_duty=0.5,
        max_pulses=4,
        max_rate_hz=150e3,
        max_chips=64,
    )
    runs = RunLimits(min_open=2, min_closed=3, max_pulses=4, max_open=5, min_period=7)
    assert limits_of_device(slow, chips=20, chip_ns=1_000) == (runs, 10)
    assert limits_of_device(DeviceProfile(name="any"), chips=20, chip_ns=1) == (RunLimits(), 20)


@pytest.mark.parametrize(
    ("limits", "line"),
    [
        ({"max_chips": 19}, "odd: plays at most 19 chips, 20 were asked for"),
        (
            {"max_on_ns": 999},
            "chip_ns: odd opens for 999 ns at most, a chip must not last longer, got 1000 ns",
        ),
        (
            {"min_on_ns": 1_100, "max_on_ns": 1_900},
            (
                "chip_ns: odd opens for 1100 to 1900 ns, no whole number of chips of 1000 ns does;"
                " shorter chips would"
            ),
        ),
        (
            {"max_duty": 0.04},
            "chips: odd may be open for 0.04 of the time at most, too little for 1 of 20 chips",
        ),
        (
            {"max_duty": 0.1, "min_on_ns": 2_500},
            "chips: odd may be open for 0.1 of the time at most, too little for 3 of 20 chips",
        ),
    ],
)
def test_a_device_that_cannot_play_any_such_code_is_named(limits, line):
    with pytest.raises(ValueError, match=r".") as caught:
        limits_of_device(DeviceProfile(name="odd", **limits), chips=20, chip_ns=1_000)
    assert str(caught.value) == line


def some_time(most):
    return st.none() | st.integers(1, most)


@given(
    st.fixed_dictionaries(
        {
            "tick_ns": st.sampled_from([1, 7, 50]),
            "min_on_ns": some_time(1_000),
            "max_on_ns": st.none() | st.integers(1_000, 4_000),
            "min_off_ns": some_time(2_000),
            # fractions and rates that codes meet exactly, and any
            "max_duty": (
                st.none()
                | st.sampled_from([k / n for n in (7, 10, 12) for k in range(1, n)])
                | st.floats(0.01, 1)
            ),
            "max_pulses": some_time(4),
            "max_rate_hz": (
                st.none()
                | st.builds(
                    lambda chips, chip_ns: 1e9 / (chips * chip_ns),
                    st.integers(1, 9),
                    st.integers(1, 9).map((350).__mul__),
                )
                | st.floats(1e-300, 1e9)
            ),
            "dead_time_ns": st.integers(0, 1_500),
            "on_bias_ns": st.integers(0, 500),
        }
    ),
    st.integers(1, 11),
    st.integers(1, 9).map((350).__mul__),
)
@settings(max_examples=250, deadline=None)
def test_codes_within_the_translated_limits_are_those_that_can_be_played(limits, chips, chip_ns):
    device = DeviceProfile(name="some", **limits)
    codes = np.array(list(itertools.product((0, 1), repeat=chips)), dtype=np.int8)[1:]
    played = np.array(
        [not device.check(Program("".join(map(str, code)), chip_ns=chip_ns)) for code in codes]
    )
    try:
        runs, most = limits_of_device(device, chips=chips, chip_ns=chip_ns)
        problem = SearchProblem(chips=chips, open_range=(1, most), runs=runs)
    except ValueError:
        problem = None
    if problem is None:
        assert not played.any()
        return
    assert np.array_equal(problem.satisfied(codes), played)
    drawn = problem.random_codes(5, rng=np.random.default_rng(0))
    assert not any(
        device.check(Program("".join(map(str, code)), chip_ns=chip_ns)) for code in drawn
    )


@pytest.mark.parametrize(
    ("chip_ns", "line"),
    [
        (
            1_250,
            (
                "whole ticks of 500 ns, from 1000 ns to 3000 ns, got 1250 ns; 1000 or 1500 ns"
                " would do"
            ),
        ),
        (700, "got 700 ns; 1000 ns would do"),
        (500, "got 500 ns; 1000 ns would do"),
        (3_400, "got 3400 ns; 3000 ns would do"),
        (9_000, "got 9000 ns; 3000 ns would do"),
    ],
)
def test_chip_times_are_whole_ticks_within_range(chip_ns, line):
    device = DeviceProfile(name="clock", tick_ns=500, min_chip_ns=900, max_chip_ns=3_400)
    for refused in (
        lambda: limits_of_device(device, chips=8, chip_ns=chip_ns),
        lambda: response_of_device(device, chip_ns),
    ):
        with pytest.raises(ValueError, match=r"^chip_ns: clock plays chips of") as caught:
            refused()
        assert str(caught.value).endswith(line)
    for played in (1_000, 1_500, 3_000):
        assert limits_of_device(device, chips=8, chip_ns=played)[0].min_open == 1
    free = DeviceProfile(name="free", tick_ns=300)
    with pytest.raises(ValueError, match="from 300 ns, got 1000 ns; 900 or 1200 ns would do"):
        limits_of_device(free, chips=8, chip_ns=1_000)


def test_a_devices_ramps():
    assert response_of_device(load_profile("generic"), 1_000) is None
    flc = response_of_device(load_profile("flc"), 200_000)
    assert flc == ShutterResponse(chip_ns=200_000, rise_ns=50_000, fall_ns=50_000)
    # whoever commands the device shortens its openings: no bias remains
    biased = DeviceProfile(name="biased", rise_ns=10, on_bias_ns=30)
    assert response_of_device(biased, 100) == ShutterResponse(chip_ns=100, rise_ns=10)
    assert response_of_device(DeviceProfile(name="biased", on_bias_ns=300), 100) is None
    with pytest.raises(
        ValueError, match=r"chip_ns: flc takes 50000 ns to open or close, .* got 40000 ns"
    ):
        response_of_device(load_profile("flc"), 40_000)


def test_a_shutter_slower_than_the_whole_code_is_named():
    with pytest.raises(
        ValueError, match=r"mechanical opens for at least 30 ms, a code of 52 chips lasts 10\.4 ms"
    ):
        limits_of_device(load_profile("mechanical"), chips=52, chip_ns=200_000)
