"""Judging codes for motions that may run backwards, and translating a shutter's limits."""

import numpy as np
import pytest

from cep.camera import Camera
from cep.code import ShutterCode
from cep.design import check_resolved, expected_psnr_db, judge, limits_of_device
from cep.mtf import measure
from cep.search.problem import SearchProblem
from hw.device import DeviceProfile
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
