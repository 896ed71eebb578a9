"""Snapshot and strobe against brute force, and the median random code."""

import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import min_chip
from cep.search.baselines import best_snapshot, best_strobe, median_random_code
from cep.search.cost import CodeCost
from cep.search.limits import RunLimits
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
STRAIGHT = Trajectory.straight(12.0, angle_rad=0.3)


def objective(path, chips, **options):
    return CodeCost(
        SearchProblem.along(path, chips=chips, **({"objective": "mse"} | options)), oversampling=8
    )


def least_cost(judge, codes):
    return judge.cost_of(np.array(codes, dtype=np.int8)).min()


def cost(judge, code):
    return judge.cost_of(code.array[None])[0]


@pytest.mark.parametrize("path", [BENT, STRAIGHT])
@pytest.mark.parametrize("wanted", ["mse", "min-mtf"])
def test_the_snapshot_is_the_best_of_all_runs(path, wanted):
    chips = 14
    judge = objective(path, chips, objective=wanted)
    every = [
        [first <= i < end for i in range(chips)]
        for end in range(1, chips + 1)
        for first in range(end)
    ]
    found = best_snapshot(judge)
    assert found.pulses == 1
    assert cost(judge, found) == pytest.approx(least_cost(judge, every), abs=1e-4)


def test_a_noisier_camera_wants_a_longer_snapshot():
    lengths = [
        best_snapshot(
            objective(STRAIGHT, 40, camera=Camera(photons_full_scale=1000, read_noise_e=noise))
        ).open_chips
        for noise in (1.0, 10.0, 100.0)
    ]
    assert lengths == sorted(lengths)
    assert lengths[0] < lengths[-1]


@pytest.mark.parametrize("path", [BENT, STRAIGHT])
def test_the_strobe_is_the_best_of_all_periodic_codes(path):
    chips = 15
    judge = objective(path, chips)
    every = {
        (("1" * width + "0" * (period - width)) * chips)[:chips]
        for period in range(2, chips)
        for width in range(1, period)
    }
    found = best_strobe(judge)
    assert found.bits in every
    assert found.pulses >= 2
    assert cost(judge, found) == pytest.approx(
        least_cost(judge, [[int(bit) for bit in code] for code in every]), abs=1e-4
    )


@pytest.mark.parametrize("chips", [12, 20, 30])
def test_whole_periods_have_true_zeros_along_a_straight_line(chips):
    """Why only "mse" ranks strobes everywhere: sum z^(jp) vanishes at roots of unity."""
    for period in (2, 3, 5, 6):
        if chips % period == 0:
            assert min_chip(ShutterCode(("1" + "0" * (period - 1)) * (chips // period))) < 1e-6


def test_two_chips_have_no_room_for_a_strobe():
    assert best_strobe(objective(BENT, 2)) is None


LIMITS = {
    "light": {"open_range": (5, 6)},
    "runs": {"open_range": (4, 9), "runs": RunLimits(min_open=2, min_closed=2, max_open=3)},
    "period": {"runs": RunLimits(min_period=5, max_pulses=2)},
}


@pytest.mark.parametrize("path", [BENT, STRAIGHT])
@pytest.mark.parametrize("limits", LIMITS.values(), ids=LIMITS)
def test_the_snapshot_within_limits_is_the_best_run_that_keeps_them(path, limits):
    chips = 14
    judge = objective(path, chips, **limits)
    every = np.array(
        [
            [first <= i < end for i in range(chips)]
            for end in range(1, chips + 1)
            for first in range(end)
        ]
    )
    allowed = every[judge.problem.satisfied(every)]
    found = best_snapshot(judge, within_limits=True)
    if not len(allowed):
        assert found is None
    else:
        assert judge.problem.allows(found)
        assert cost(judge, found) == pytest.approx(least_cost(judge, allowed), abs=1e-4)


@pytest.mark.parametrize("limits", LIMITS.values(), ids=LIMITS)
def test_the_strobe_within_limits_is_the_best_of_whole_pulses_that_keep_them(limits):
    chips = 14
    judge = objective(BENT, chips, **limits)
    every = set()
    for width in range(1, chips):
        for period in range(width + 1, chips):
            for pulses in range(2, chips):
                ends = [k * period + width for k in range(pulses)]
                if ends[-1] <= chips:
                    every.add(
                        tuple(any(end - width <= i < end for end in ends) for i in range(chips))
                    )
    allowed = np.array(sorted(every))
    allowed = allowed[judge.problem.satisfied(allowed)]
    found = best_strobe(judge, within_limits=True)
    assert judge.problem.allows(found)
    assert found.pulses >= 2
    assert cost(judge, found) == pytest.approx(least_cost(judge, allowed), abs=1e-4)


def test_where_one_pulse_is_all_there_may_be_no_strobe_keeps_the_limits():
    assert (
        best_strobe(objective(BENT, 14, runs=RunLimits(max_pulses=1)), within_limits=True) is None
    )


@pytest.mark.parametrize("count", [41, 40])
def test_the_random_code_is_the_median_of_codes_within_the_limits(count):
    judge = objective(BENT, 16, open_range=(6, 9), runs=RunLimits(min_open=2))
    code = median_random_code(judge, count, rng=np.random.default_rng(0))
    assert judge.problem.allows(code)
    drawn = judge.problem.random_codes(count, rng=np.random.default_rng(0))
    costs = np.sort(judge.cost_of(drawn))
    # of an even number, the worse of the two in the middle
    assert cost(judge, code) == pytest.approx(costs[count // 2], abs=1e-4)
