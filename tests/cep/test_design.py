"""Judging codes for motions that may run backwards, and translating a shutter's limits."""

import numpy as np
import pytest

from cep.camera import Camera
from cep.code import ShutterCode
from cep.design import check_resolved, expected_psnr_db, judge, limits_of_device, response_of_device
from cep.mtf import measure
from cep.response import ShutterResponse
from cep.search.problem import SearchProblem
from hw.device import DeviceProfile, load_profile
from hw.program import Program
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
CODE = ShutterCode("110100011")


def test_an_unknown_direction_is_judged_by_the_worse_one():
    forward, reverse = measure(BENT, CODE), measure(BENT.reversed(), CODE)
    assert forward.mse_db != pytest.approx(reverse.mse_db)
    judged = judge(BENT, CODE)
    assert judged.mse_db == max(forward.mse_db, reverse.mse_db)
    assert judged.min_mtf == min(forward.min_mtf, reverse.min_mtf)
    assert judge(Trajectory(BENT.t, BENT.xy, "known"), CODE) == forward


def test_resolution_ends_at_a_quarter_pixel():
    path = Trajectory.straight(10.0)
    check_resolved(path, 40)
    with pytest.raises(ValueError, match="at most 40 can be resolved"):
        check_resolved(path, 41)
    check_resolved(Trajectory.straight(0.01), 1)


def test_expected_psnr_is_that_of_the_metrics():
    problem = SearchProblem.along(BENT, chips=9, objective="mse", camera=Camera())
    codes = [CODE, ShutterCode("1" * 9)]
    table = expected_psnr_db(problem, codes, photons=(1e3, 1e4))
    assert table.shape == (2, 2)
    for row, code in zip(table, codes, strict=True):
        assert -row[1] == pytest.approx(judge(BENT, code, camera=Camera()).mse_db, abs=0.02)
        assert row[1] > row[0]  # more light never hurts


def test_a_devices_limits_in_chips():
    slow = DeviceProfile(
        name="slow", min_on_ns=1_500, on_bias_ns=200, tick_ns=100, min_off_ns=900, dead_time_ns=2_100, max_duty=0.5,
        max_pulses=4, max_chips=64,
    )  # fmt: skip
    limits = limits_of_device(slow, chips=20, chip_ns=1_000)
    assert limits == {"min_open": 2, "min_closed": 3, "max_pulses": 4, "max_open": 10}
    with pytest.raises(ValueError, match="at most 64 chips"):
        limits_of_device(slow, chips=65, chip_ns=1_000)
    assert limits_of_device(DeviceProfile(name="any"), chips=20, chip_ns=1) == {
        "min_open": 1, "min_closed": 1, "max_pulses": None, "max_open": None,
    }  # fmt: skip


def test_codes_within_the_translated_limits_can_be_played():
    slow = DeviceProfile(name="slow", min_on_ns=1_500, dead_time_ns=2_100, max_pulses=3, max_duty=0.6)
    limits = limits_of_device(slow, chips=24, chip_ns=1_000)
    problem = SearchProblem(
        chips=24, open_range=(1, limits["max_open"]), min_open=limits["min_open"], min_closed=limits["min_closed"],
        max_pulses=limits["max_pulses"],
    )  # fmt: skip
    for chips in problem.random_codes(40, rng=np.random.default_rng(0)):
        program = Program.from_bits(chips.tolist(), chip_ns=1_000)
        assert slow.check(program) == ()


@pytest.mark.parametrize(
    ("chip_ns", "line"),
    [
        (1_250, "whole ticks of 500 ns, from 1000 ns to 3000 ns, got 1250 ns; 1000 or 1500 ns would do"),
        (700, "got 700 ns; 1000 ns would do"),
        (500, "got 500 ns; 1000 ns would do"),
        (3_400, "got 3400 ns; 3000 ns would do"),
        (9_000, "got 9000 ns; 3000 ns would do"),
    ],
)
def test_chip_times_are_whole_ticks_within_range(chip_ns, line):
    device = DeviceProfile(name="clock", tick_ns=500, min_chip_ns=900, max_chip_ns=3_400)
    for refused in (lambda: limits_of_device(device, chips=8, chip_ns=chip_ns),
                    lambda: response_of_device(device, chip_ns)):  # fmt: skip
        with pytest.raises(ValueError, match=r"^chip_ns: clock plays chips of") as caught:
            refused()
        assert str(caught.value).endswith(line)
    for played in (1_000, 1_500, 3_000):
        assert limits_of_device(device, chips=8, chip_ns=played)["min_open"] == 1
    free = DeviceProfile(name="free", tick_ns=300)
    with pytest.raises(ValueError, match="from 300 ns, got 1000 ns; 900 or 1200 ns would do"):
        limits_of_device(free, chips=8, chip_ns=1_000)


def test_a_devices_ramps():
    assert response_of_device(load_profile("generic"), 1_000) is None
    flc = response_of_device(load_profile("flc"), 200_000)
    assert flc == ShutterResponse(chip_ns=200_000, rise_ns=50_000, fall_ns=50_000)
    biased = DeviceProfile(name="biased", rise_ns=10, on_bias_ns=30)
    assert response_of_device(biased, 100) == ShutterResponse(chip_ns=100, rise_ns=10, on_bias_ns=30)
    assert response_of_device(biased, 100, bias_corrected=True) == ShutterResponse(chip_ns=100, rise_ns=10)
    with pytest.raises(ValueError, match=r"chip_ns: flc takes 50000 ns to open or close, .* got 40000 ns"):
        response_of_device(load_profile("flc"), 40_000)
