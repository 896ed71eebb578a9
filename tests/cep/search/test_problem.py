"""The search problem: limits that conflict, and what measuring under a real shutter
means."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.band import band_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf
from cep.optics.response import ShutterResponse
from cep.proofs.measure import measure, worst_of
from cep.search.limits import Limits, RunLimits, feasible
from cep.search.problem import Scenario, SearchProblem
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
CODE = ShutterCode("110100011")
SLOW = ShutterResponse(chip_ns=100, rise_ns=60, fall_ns=80, on_bias_ns=10)


@given(st.integers(0, 99), st.integers(4, 60), st.data())
@settings(max_examples=60, deadline=None)
def test_drawn_codes_keep_every_limit(seed, chips, data):
    low = data.draw(st.integers(1, chips))
    light = (low, data.draw(st.integers(low, chips)))
    runs = RunLimits(
        min_open=data.draw(st.integers(1, 3)),
        min_closed=data.draw(st.integers(1, 4)),
        max_pulses=data.draw(st.none() | st.integers(1, 6)),
        max_open=data.draw(st.none() | st.integers(1, 9)),
        min_period=data.draw(st.integers(1, 9)),
    )
    if not feasible(Limits(chips, light, runs)):
        with pytest.raises(ValueError, match=r"conflict|no code of"):
            SearchProblem(chips=chips, open_range=light, runs=runs)
        return
    problem = SearchProblem(chips=chips, open_range=light, runs=runs)
    codes = problem.random_codes(12, rng=np.random.default_rng(seed))
    assert codes.shape == (12, chips)
    assert problem.satisfied(codes).all()


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (
            {"open_range": (7, 9), "runs": RunLimits(max_open=3, min_period=5)},
            (
                "open_range 7..9, max_open 3 and min_period 5 conflict: no code of 9 chips keeps"
                " all 3"
            ),
        ),
        (
            {"open_range": (2, 4), "runs": RunLimits(min_open=5)},
            "min_open: runs of 5 open chips conflict with at most 4 open chips",
        ),
        ({"open_range": (2, 4.5)}, "open_range: must be two whole numbers, "),
        ({"open_range": 5}, "open_range: must be two whole numbers, "),
        ({"frames": True}, "frames: must be 1, or 2 for a pair"),
        ({"response": SLOW}, "response: needs a motion (scenarios)"),
    ],
)
def test_bad_problems_are_named(options, line):
    with pytest.raises(ValueError, match=r".") as caught:
        SearchProblem(chips=9, **options)
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("limit", "line"),
    [
        ({"max_open": 0}, "max_open: must be a whole number of at least 1, got 0"),
        ({"min_period": None}, "min_period: must be a whole number of at least 1, got None"),
    ],
)
def test_limits_on_runs_are_whole_numbers(limit, line):
    with pytest.raises(ValueError, match=f"^{line}$"):
        RunLimits(**limit)


def test_whole_numbers_of_numpy_and_lists_are_taken():
    runs = RunLimits(min_open=np.int64(2), max_pulses=np.int32(3))
    problem = SearchProblem(chips=np.int64(8), open_range=[np.int16(2), 6], runs=runs)
    assert problem == SearchProblem(
        chips=8, open_range=(2, 6), runs=RunLimits(min_open=2, max_pulses=3)
    )
    assert json.loads(json.dumps(asdict(problem.runs)))["min_open"] == 2


def test_measuring_counts_every_scenario_direction_and_the_shutter():
    known = Trajectory(BENT.t, BENT.xy, "known")
    problem = SearchProblem(chips=9, scenarios=(Scenario(known),))
    assert problem.measure(CODE) == measure(known, CODE)
    both = replace(problem, scenarios=(Scenario(BENT),), response=SLOW)
    ways = [measure(path, CODE, response=SLOW) for path in (BENT, BENT.reversed())]
    assert ways[0] != ways[1]
    assert both.measure(CODE) == worst_of(*ways)


def test_figures_under_a_slow_shutter():
    samples = band_samples(BENT)
    modulus = np.abs(coded_otf(BENT, CODE, samples.fx, samples.fy, response=SLOW))
    found = measure(BENT, CODE, response=SLOW)
    light = SLOW.open_time(CODE.array[None])[0]
    assert found.noise_gain_db == pytest.approx(10 * np.log10(samples.weight @ modulus**-2))
    assert found.dnf_db == pytest.approx(found.noise_gain_db + 20 * np.log10(light))
    assert 0 <= found.min_mtf_lower <= found.min_mtf <= modulus.min()
    assert found.min_over_duty == pytest.approx(found.min_mtf / light)
    straight = measure(Trajectory.straight(9.0), CODE, response=SLOW)
    assert 0 < 0.99 * straight.min_mtf < straight.min_mtf_lower <= straight.min_mtf
    assert straight.min_chip is None
    # the ramps are one more box over the path
    assert straight.noise_gain_db > measure(Trajectory.straight(9.0), CODE).noise_gain_db
