"""The search: against brute force, within its limits, reproducible, interruptible; and its
bounds."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.codes.published import PUBLISHED
from cep.optics.code import ShutterCode
from cep.proofs.certify.minimum import min_chip
from cep.proofs.measure import measure
from cep.search.annealing.anneal import anneal
from cep.search.annealing.proposals import LoopLimits, keeps_runs
from cep.search.bounds import bound
from cep.search.cost import CodeCost
from cep.search.limits import RunLimits
from cep.search.problem import OBJECTIVES, Scenario, SearchProblem, open_range_of_duty
from motdiff.trajectory import Trajectory


def arc(length_px=12.0, samples=24):
    angle = np.linspace(0, 2.2, samples) ** 1.4
    return Trajectory.from_samples(
        length_px / 3 * np.stack([np.cos(angle), np.sin(1.7 * angle)], 1)
    )


def all_codes(problem):
    n = problem.chips
    everything = ((np.arange(1, 2**n)[:, None] >> np.arange(n)) & 1).astype(np.int8)
    return everything[problem.satisfied(everything)]


def brute_force(problem):
    """Best exact cost over every code; those whose sampled cost is already hopeless are
    skipped."""
    fine = CodeCost.fine(problem)
    codes = all_codes(problem)
    # a continuum minimum only raises the cost
    sampled = fine.cost_of(codes)
    best = np.inf
    for index in np.argsort(sampled):
        if sampled[index] >= best:
            break
        best = min(best, fine.exact_cost(ShutterCode(codes[index])))
    return best


@pytest.mark.slow  # brute force
@pytest.mark.parametrize("objective", [*OBJECTIVES, (("noise", 1.0), ("min-mtf", 0.5))])
@pytest.mark.parametrize("where", ["circle", "straight", "limits", "long runs", "fast pulses"])
def test_agrees_with_brute_force(objective, where):
    options = {
        "circle": {"chips": 12, "open_range": (4, 9)},
        "straight": {
            "chips": 11,
            "open_range": (6, 6),
            "scenarios": (Scenario(Trajectory.straight(14.0)),),
        },
        "limits": {
            "chips": 12,
            "open_range": (5, 8),
            "runs": RunLimits(min_open=2, min_closed=2, max_pulses=3),
        },
        "long runs": {"chips": 12, "open_range": (4, 9), "runs": RunLimits(max_open=2)},
        "fast pulses": {
            "chips": 12,
            "open_range": (3, 8),
            "runs": RunLimits(max_open=4, min_period=4),
        },
    }[where]
    problem = SearchProblem(objective=objective, **options)
    found = anneal(problem, rng=np.random.default_rng(0), steps=200_000, time_s=np.inf)
    assert found.objective == pytest.approx(brute_force(problem), abs=1e-6)


@pytest.mark.parametrize("objective", sorted({*OBJECTIVES} - {"min-mtf"}))
@pytest.mark.parametrize("direction", ["unknown", "forward"])
def test_agrees_with_brute_force_on_a_curve(objective, direction):
    problem = SearchProblem.along(
        arc(), chips=10, open_range=(5, 5), objective=objective, direction=direction
    )
    found = anneal(problem, rng=np.random.default_rng(0), steps=100_000, time_s=np.inf)
    assert found.objective == pytest.approx(brute_force(problem), abs=1e-6)


def test_cost_is_what_measure_says():
    """The search's own arithmetic against the measuring one, both directions, worst case."""
    path = arc()
    code = ShutterCode("1110111001")
    for name, field, factor in (("noise", "noise_gain_db", 1), ("mse", "mse_db", 1)):
        problem = SearchProblem.along(path, chips=10, objective=name, direction="unknown")
        cost = CodeCost.fine(problem).exact_cost(code)
        measured = [getattr(measure(p, code, budget=0), field) for p in (path, path.reversed())]
        assert cost == pytest.approx(factor * max(measured), abs=1e-9)
        assert getattr(problem.measure(code, budget=0), field) == pytest.approx(
            max(measured), abs=1e-12
        )
    straight = SearchProblem.along(Trajectory.straight(14.3), chips=10)
    cost = CodeCost.fine(straight).exact_cost(code)
    assert cost == pytest.approx(
        -20 * np.log10(measure(Trajectory.straight(14.3), code).min_mtf), abs=1e-6
    )
    circle = CodeCost.fine(SearchProblem(chips=10)).exact_cost(code)
    assert circle == pytest.approx(-20 * np.log10(min_chip(code) / 10), abs=1e-6)


def test_scenarios_combine_by_rule_and_in_any_order():
    paths = (Scenario(arc(8.0), 3.0), Scenario(Trajectory.straight(11.0), 1.0))
    codes = np.random.default_rng(0).integers(0, 2, (20, 10)).astype(np.int8)
    codes[:, 0] = 1

    def costs(scenarios, rule):
        problem = SearchProblem(chips=10, scenarios=scenarios, objective="noise", rule=rule)
        return CodeCost.fine(problem).cost_of(codes)

    single = np.array([costs((path,), "worst") for path in paths])
    assert np.allclose(costs(paths, "worst"), single.max(axis=0))
    assert np.allclose(costs(paths, "mean"), 0.75 * single[0] + 0.25 * single[1])
    assert np.allclose(costs(paths[::-1], "worst"), costs(paths, "worst"))


RUN_LIMITS = st.fixed_dictionaries(
    {
        "min_open": st.integers(1, 3),
        "min_closed": st.integers(1, 3),
        "max_pulses": st.none() | st.integers(1, 4),
        "max_open": st.none() | st.integers(3, 6),
        "min_period": st.integers(1, 8),
    }
)


@given(st.text("01", min_size=8, max_size=24), RUN_LIMITS)
@settings(max_examples=300, deadline=None)
def test_limits_mean_what_the_runs_say(bits, limits):
    bits = "1" + bits
    problem = SearchProblem(chips=len(bits), runs=RunLimits(**limits))
    code = ShutterCode(bits)
    inner = ShutterCode(bits.strip("0")).runs
    # of a pulse and the gap after it, but for the last pulse
    periods = [inner[at][1] + inner[at + 1][1] for at in range(0, len(inner) - 1, 2)]
    kept = (
        all(
            length >= (limits["min_open"] if bit else limits["min_closed"])
            for bit, length in inner
        )
        and all(length <= (limits["max_open"] or len(bits)) for bit, length in inner if bit)
        and all(period >= limits["min_period"] for period in periods)
        and code.pulses <= (limits["max_pulses"] or len(bits))
        and code.open_chips >= limits["min_open"]
    )
    assert problem.satisfied(code.array[None])[0] == kept
    # the compiled loops keep the same, here of two frames
    pair = np.concatenate([code.array, code.array]).astype(np.int8)
    assert keeps_runs(pair, LoopLimits.of(problem)) == kept


@given(st.integers(0, 99), st.integers(6, 16), RUN_LIMITS)
@settings(max_examples=25, deadline=None)
def test_results_keep_the_limits(seed, chips, limits):
    try:
        problem = SearchProblem(chips=chips, runs=RunLimits(**limits), open_range=(3, chips - 2))
    except ValueError:
        return  # no code keeps such limits
    found = anneal(problem, rng=np.random.default_rng(seed), steps=5000)
    assert problem.satisfied(found.code.array[None])[0]


def test_same_seed_same_code_and_starting_points_help():
    problem = SearchProblem(chips=52, open_range=(26, 26))
    first, second = (anneal(problem, rng=np.random.default_rng(7), steps=5000) for _ in range(2))
    assert (first.code, first.objective) == (second.code, second.objective)
    assert first.stopped == "steps"
    assert first.steps >= 5000
    started = anneal(
        problem, rng=np.random.default_rng(7), steps=64, start=[PUBLISHED["raskar-52"]]
    )
    assert min_chip(started.code) >= min_chip(PUBLISHED["raskar-52"]) - 1e-9
    assert min_chip(first.code) > 1.2


def test_interrupt_returns_the_best_so_far():
    problem = SearchProblem(chips=30, open_range=(15, 15), objective="noise")
    seen = []

    def progress(fraction, best):
        seen.append((fraction, best))
        if len(seen) == 3:
            raise KeyboardInterrupt

    found = anneal(problem, rng=np.random.default_rng(0), steps=10**9, progress=progress)
    assert found.stopped == "interrupted"
    assert 0 < found.steps < 10**9
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions)
    fine = CodeCost.fine(problem)
    assert found.objective <= fine.exact_cost(seen[-1][1]) + 1e-4


def test_time_limit_ends_a_search():
    problem = SearchProblem(chips=20)
    found = anneal(problem, rng=np.random.default_rng(0), steps=10**9, time_s=0.05)
    assert found.stopped == "time"
    assert found.steps < 10**9


def test_a_search_without_a_number_of_moves_goes_on_for_its_time(monkeypatch):
    """However many moves that is: the clock runs by a fiftieth of the time with each look at it by
    the caller."""
    clock = [0.0]
    told = []
    monkeypatch.setattr("cep.search.annealing.anneal.time.monotonic", lambda: clock[0])

    def progress(fraction, _best):
        told.append(fraction)
        clock[0] += 2.0

    found = anneal(
        SearchProblem(chips=12),
        rng=np.random.default_rng(0),
        steps=None,
        time_s=100.0,
        progress=progress,
    )
    assert found.stopped == "time"
    assert sum(fraction < 0.9 for fraction in told) >= 49
    assert found.steps > 0
    # without a limit on the time the moves end it, whatever the clock says
    clock[0] = 0.0
    found = anneal(
        SearchProblem(chips=12),
        rng=np.random.default_rng(0),
        steps=90_000,
        time_s=np.inf,
        progress=progress,
    )
    assert found.stopped == "steps"
    assert found.steps >= 90_000


def test_nothing_to_choose_is_complete():
    found = anneal(
        SearchProblem(chips=6, open_range=(6, 6)),
        rng=np.random.default_rng(0),
        steps=None,
        time_s=60.0,
    )
    assert (found.code.bits, found.steps, found.stopped) == ("111111", 0, "complete")


@pytest.mark.parametrize("ends", ["in time", "late", "ctrl-c"])
def test_a_polish_ends_with_the_time_or_ctrl_c(monkeypatch, ends):
    problem = SearchProblem(chips=40, open_range=(20, 20))
    clock = [0.0]
    told = []
    monkeypatch.setattr("cep.search.annealing.anneal.time.monotonic", lambda: clock[0])

    def progress(fraction, best):
        told.append((fraction, best))
        if fraction >= 0.9 and ends == "late":
            clock[0] = 11.5  # the limit and a tenth is 11
        if fraction > 0.9 and ends == "ctrl-c":
            raise KeyboardInterrupt

    found = anneal(
        problem, rng=np.random.default_rng(0), steps=2000, time_s=10.0, progress=progress
    )
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert found.stopped == {"in time": "steps", "late": "time", "ctrl-c": "interrupted"}[ends]
    assert fractions[-1] == 1.0 if ends != "ctrl-c" else 0.9 < fractions[-1] < 1.0
    # what the polish had reached is kept
    fine = CodeCost.fine(problem)
    assert found.objective == fine.exact_cost(found.code)
    assert found.code == told[-1][1]
    inside = sum(0.9 <= fraction < 1.0 for fraction in fractions)
    assert inside > 5 if ends == "in time" else inside >= 1
    if ends == "late":
        assert inside <= 2  # the last tick of the moves may tell 0.9 as well


def test_all_open_is_all_there_is():
    found = anneal(
        SearchProblem(chips=6, open_range=(6, 6)), rng=np.random.default_rng(0), steps=100
    )
    assert found.code.bits == "111111"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"chips": 0}, "chips: must be a whole number"),
        ({"chips": 10, "open_range": (6, 4)}, "fewest 6 is above most 4"),
        ({"chips": 10, "open_range": (2, 11)}, r"within 1..10 chips"),
        (
            {"chips": 10, "open_range": (2, 4), "runs": RunLimits(min_open=5)},
            "min_open: .*conflict.*at most 4.*open_range",
        ),
        ({"chips": 4, "runs": RunLimits(min_open=5)}, "min_open: .*do not fit a code of 4"),
        ({"chips": 4, "objective": "sharp"}, "objective: must be one of min-mtf"),
        ({"chips": 4, "objective": (("noise", -1.0),)}, "weight of noise"),
        ({"chips": 4, "objective": ()}, "at least one objective"),
        ({"chips": 4, "direction": "sideways"}, "direction: must be one of"),
        ({"chips": 4, "rule": "median"}, "rule: must be one of"),
        ({"chips": 4, "scenarios": (Scenario(Trajectory.straight(3), 0.0),)}, "every weight"),
    ],
)
def test_bad_problems_are_named(options, message):
    with pytest.raises(ValueError, match=message) as caught:
        SearchProblem(**options)
    assert "\n" not in str(caught.value)


def test_bad_searches_are_named():
    problem = SearchProblem(chips=5)
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="steps"):
        anneal(problem, rng=rng, steps=0)
    with pytest.raises(ValueError, match="time_s"):
        anneal(problem, rng=rng, time_s=0)
    with pytest.raises(ValueError, match=r"start: .*5 chips"):
        anneal(problem, rng=rng, start=[ShutterCode("111")])
    with pytest.raises(ValueError, match="code: must have 5 chips"):
        problem.measure(ShutterCode("111"))


def test_duty_becomes_a_range_of_chips():
    assert open_range_of_duty(52, 0.5, 0.5) == (26, 26)
    assert open_range_of_duty(10, 0.25, 0.75) == (3, 7)
    for low, high, message in (
        (0.51, 0.52, "no whole number"),
        (0.6, 0.4, "LOW:HIGH"),
        (0.5, 1.5, "LOW:HIGH"),
    ):
        with pytest.raises(ValueError, match=message):
            open_range_of_duty(10, low, high)


@pytest.mark.parametrize("chips", [6, 8])
def test_bound_holds_for_every_code(chips):
    everything = [
        ShutterCode("".join("1" if i in chosen else "0" for i in range(chips)))
        for k in (3, 5)
        for chosen in combinations(range(chips), k)
    ]
    circle = bound(SearchProblem(chips=chips, open_range=(3, 5)))
    best = max(min_chip(code) for code in everything)
    assert best <= circle.min_chip <= np.sqrt(5) + 1e-9
    for path in (Trajectory.straight(1.3 * chips), Trajectory.straight(2.0)):
        straight = bound(SearchProblem.along(path, chips=chips, open_range=(3, 5)))
        best = max(measure(path, code, budget=0).min_mtf for code in everything)
        assert best <= straight.min_mtf <= 5 / chips + 1e-9
