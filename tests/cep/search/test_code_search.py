"""A search and its baselines: each is what its name says, and none within the limits beats the
code returned."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.response import ShutterResponse
from cep.search import baselines as baselines_module
from cep.search import code_search as search_module
from cep.search.baselines import find_baselines
from cep.search.code_search import SearchOptions, search_code
from cep.search.cost import CodeCost
from cep.search.limits import RunLimits
from cep.search.problem import OBJECTIVES, Scenario, SearchProblem
from cep.search.search_result import SearchResult
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])
STRAIGHT = Trajectory.straight(11.0)


def named(problem, **options):
    return {
        row.name: row for row in find_baselines(problem, rng=np.random.default_rng(1), **options)
    }


def test_the_baselines_of_a_straight_line():
    problem = SearchProblem.along(STRAIGHT, chips=13, open_range=(7, 9), objective="noise")
    rows = named(problem)
    assert set(rows) == {
        "open shutter",
        "best snapshot",
        "best snapshot within the limits",
        "best strobe",
        "best strobe within the limits",
        "published: barker-13",
        "length-only code",
        "random code, median",
    }
    judge = CodeCost.fine(problem)
    for row in rows.values():
        assert row.cost_db == judge.exact_cost(row.code)
        assert row.within_limits == (7 <= row.code.open_chips <= 9)
    assert rows["open shutter"].code.duty == 1
    found = search_code(problem, SearchOptions(steps=5000))
    # along a straight line the length is all there is to know
    assert rows["length-only code"].cost_db == pytest.approx(found.objective, abs=0.5)


@pytest.mark.parametrize("objective", ["mse", "noise"])
@pytest.mark.parametrize("chips", [9, 40])
def test_no_other_single_run_beats_the_snapshot(objective, chips):
    """Also where only some of the runs are looked at first."""
    problem = SearchProblem.along(BENT, chips=chips, open_range=(3, 6), objective=objective)
    found = named(problem)["best snapshot"]
    assert found.code.pulses == 1
    judge = CodeCost.fine(problem)
    starts = range(0, chips, 1 if chips == 9 else 7)
    best = min(
        judge.exact_cost(ShutterCode(("0" * first + "1" * length).ljust(chips, "0")))
        for first in starts
        for length in range(1, chips - first + 1, 1 if chips == 9 else 4)
    )
    assert found.cost_db <= best + 0.01


def test_the_random_code_is_the_middle_one():
    problem = SearchProblem.along(BENT, chips=9, open_range=(3, 6), objective="mse")
    judge = CodeCost.fine(problem)
    low, high = np.percentile(
        judge.cost_of(problem.random_codes(100, rng=np.random.default_rng(5))), (10, 90)
    )
    assert low <= named(problem)["random code, median"].cost_db <= high


def test_the_length_only_code_has_a_quarter_of_the_time_and_says_what_it_ended(monkeypatch):
    limits = []

    def cut_short(problem, *, time_s, **_options):
        limits.append(time_s)
        return SimpleNamespace(code=ShutterCode("1" * problem.chips), stopped="time")

    monkeypatch.setattr(baselines_module, "anneal", cut_short)
    rows = named(SearchProblem.along(BENT, chips=9), time_s=8.0)
    assert limits == [2.0]
    assert [name for name, row in rows.items() if row.stopped_early] == ["length-only code"]


def test_what_the_baselines_take_is_off_the_time_but_for_half_of_it(monkeypatch):
    limits = []
    now = [0.0]
    slept = iter((2.0, 9.0))

    def slow(problem, **_options):
        now[0] += next(slept)
        return SimpleNamespace(code=ShutterCode("1" * problem.chips), stopped="steps")

    def searched(problem, *, time_s, **_options):
        limits.append(time_s)
        return SearchResult(ShutterCode("110100011"), 0.0, 0.1, 1, "time")

    monkeypatch.setattr(baselines_module, "anneal", slow)
    monkeypatch.setattr(search_module, "anneal", searched)
    monkeypatch.setattr(search_module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    for _ in range(2):
        search_code(SearchProblem.along(BENT, chips=9), SearchOptions(time_s=10.0))
    assert limits == [8.0, 5.0]


@pytest.mark.parametrize("at", ["best_snapshot", "anneal", "median_random_code"])
def test_ctrl_c_among_the_baselines_returns_the_best_so_far(monkeypatch, at):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    problem = SearchProblem.along(BENT, chips=9, open_range=(3, 9), objective="mse")
    whole = tuple(find_baselines(problem, rng=np.random.default_rng(0)))
    monkeypatch.setattr(baselines_module, at, interrupted)
    monkeypatch.setattr(search_module, "anneal", None)  # not called
    found = search_code(problem, SearchOptions())
    assert found.stopped == "interrupted"
    assert len(found.baselines) < len(whole)
    assert problem.allows(found.code)
    assert all(row.cost_db >= found.objective for row in found.baselines if row.within_limits)


# -- the code returned never loses to a row of its own table --------------------------------------


def test_a_search_that_ends_worse_than_a_baseline_returns_it(monkeypatch):
    problem = SearchProblem.along(BENT, chips=9, open_range=(3, 6), objective="mse")
    poor = SearchResult(ShutterCode("101010000"), 99.0, 0.1, 1, "steps")
    monkeypatch.setattr(search_module, "anneal", lambda _problem, **_options: poor)
    found = search_code(problem, SearchOptions())
    kept = {row.code: row.cost_db for row in found.baselines if row.within_limits}
    assert found.objective == kept[found.code] == min(kept.values())


@st.composite
def problems(draw):
    """Small problems: limits on light and runs, ramps, motions that may differ, all
    objectives."""
    chips = draw(st.integers(8, 20))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    paths = [
        STRAIGHT,
        BENT,
        BENT.scaled(0.7),
        Trajectory.from_samples(rng.normal(size=(5, 2)).cumsum(axis=0) * 3),
    ]
    kept = draw(st.lists(st.sampled_from(range(4)), min_size=0, max_size=2, unique=True))
    low = draw(st.integers(1, chips // 2))
    limits = {"open_range": (low, draw(st.integers(low, chips)))}
    if draw(st.booleans()):
        limits["runs"] = RunLimits(
            min_open=draw(st.integers(1, 3)),
            min_closed=draw(st.integers(1, 3)),
            max_pulses=draw(st.none() | st.integers(1, 4)),
            max_open=draw(st.none() | st.integers(3, 6)),
            min_period=draw(st.integers(1, 5)),
        )
    if kept and draw(st.booleans()):
        limits["response"] = ShutterResponse(chip_ns=1000, rise_ns=400, fall_ns=300)
    mix = (("min-mtf", 0.3), ("noise", 1.0))
    try:
        return SearchProblem(
            chips=chips,
            scenarios=tuple(Scenario(paths[index], weight=1.0 + index) for index in kept),
            objective=draw(
                # the expected error is that of a photo along a motion
                st.sampled_from([*(name for name in OBJECTIVES if kept or name != "mse"), mix])
            ),
            direction=draw(st.sampled_from(["auto", "unknown", "forward"])),
            rule=draw(st.sampled_from(["worst", "mean"])),
            camera=Camera(photons_full_scale=draw(st.sampled_from([1e3, 1e5])), read_noise_e=5.0),
            **limits,
        )
    except ValueError:  # limits that no code keeps
        return SearchProblem(chips=chips)


@pytest.mark.slow(reason="searches forty problems, each with its baselines")
@settings(max_examples=40, deadline=None)
@given(problems(), st.integers(1, 400), st.integers(0, 9))
def test_no_baseline_within_the_limits_beats_the_code(problem, steps, seed):
    found = search_code(problem, SearchOptions(steps=steps, seed=seed), threads=1)
    assert problem.allows(found.code)
    judge = CodeCost.fine(problem)
    assert found.objective == judge.exact_cost(found.code)
    for row in found.baselines:
        assert row.within_limits == problem.allows(row.code)
        # a code and the same one shifted may differ in the last bits of their costs
        assert not row.within_limits or judge.exact_cost(row.code) >= found.objective - 1e-9


def test_the_same_seed_and_moves_give_the_same_code_and_table():
    problem = SearchProblem.along(BENT, chips=16, open_range=(6, 9), objective="mse")
    one, other = (
        search_code(problem, SearchOptions(steps=2000, seed=5), threads=threads)
        for threads in (1, 2)
    )
    assert (one.code, one.objective, one.baselines) == (
        other.code,
        other.objective,
        other.baselines,
    )


def test_a_stopped_proof_returns_a_baseline_that_is_better(monkeypatch):
    """Its best yet may be anything."""
    problem = SearchProblem(chips=13)

    def stop(_fraction, _best):
        raise KeyboardInterrupt

    found = search_code(problem, SearchOptions(method="exact"), progress=stop)
    assert found.stopped == "interrupted"
    assert found.objective <= min(row.cost_db for row in found.baselines if row.within_limits)
    assert search_code(problem, SearchOptions(method="exact")).code.bits == "1111100110101"
