"""What a code is compared with: each baseline is what its name says, on the same problem."""

from types import SimpleNamespace

import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import anneal
from cep.search.problem import SearchProblem
from cep.workflows.compare import compare
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])


def named(problem, code, **options):
    rows = compare(problem, code, rng=np.random.default_rng(1), **options)
    assert rows[0].name == "this code"
    assert rows[0].code == code
    return {row.name: row for row in rows}


def test_every_baseline_is_measured():
    problem = SearchProblem.along(Trajectory.straight(11.0), chips=13, open_range=(7, 9), objective="noise")
    code = anneal(problem, rng=np.random.default_rng(0), steps=5000).code
    rows = named(problem, code)
    assert set(rows) == {
        "this code", "open shutter", "best snapshot", "published: barker-13", "length-only code", "random code, median",
    }  # fmt: skip
    assert rows["open shutter"].code.duty == 1
    for name in ("length-only code", "random code, median"):
        assert 7 <= rows[name].code.open_chips <= 9
    for row in rows.values():
        assert row.metrics.noise_gain_db == pytest.approx(problem.measure(row.code).noise_gain_db)
    gains = {name: row.metrics.noise_gain_db for name, row in rows.items()}
    assert gains["this code"] <= min(gains["published: barker-13"], gains["random code, median"])
    # along a straight line the length is all there is to know
    assert gains["length-only code"] == pytest.approx(gains["this code"], abs=0.5)


@pytest.mark.parametrize("objective", ["mse", "noise"])
@pytest.mark.parametrize("chips", [9, 40])
def test_no_other_single_run_beats_the_snapshot(objective, chips):
    """Also where only some of the runs are looked at first."""
    problem = SearchProblem.along(BENT, chips=chips, open_range=(3, 6), objective=objective)
    found = named(problem, ShutterCode("1" * chips))["best snapshot"]
    assert found.code.pulses == 1
    field = {"mse": "mse_db", "noise": "noise_gain_db"}[objective]
    starts = range(0, chips, 1 if chips == 9 else 7)
    runs = [
        ShutterCode(("0" * first + "1" * length).ljust(chips, "0"))
        for first in starts
        for length in range(1, chips - first + 1, 1 if chips == 9 else 4)
    ]
    best = min(getattr(problem.measure(run, budget=0), field) for run in runs)
    assert getattr(found.metrics, field) <= best + 0.01


def test_the_random_code_is_the_middle_one():
    problem = SearchProblem.along(BENT, chips=9, open_range=(3, 6), objective="mse")
    rows = named(problem, ShutterCode("110100011"))
    drawn = problem.random_codes(100, rng=np.random.default_rng(5))
    errors = [problem.measure(ShutterCode.from_array(bits), budget=0).mse_db for bits in drawn]
    low, high = np.percentile(errors, (10, 90))
    assert low <= rows["random code, median"].metrics.mse_db <= high


@pytest.mark.parametrize(("given", "used"), [({}, 60.0), ({"time_s": 7.0}, 7.0), ({"time_s": 0.1}, 3.0)])
def test_the_search_among_the_baselines_keeps_the_time_limit_and_says_what_it_ended(monkeypatch, given, used):
    limits = []

    def cut_short(_length_px, chips, *, time_s, **_options):
        limits.append(time_s)
        return SimpleNamespace(code=ShutterCode("1" * chips), stopped="interrupted")

    monkeypatch.setattr("cep.workflows.compare.dnf_search", cut_short)
    rows = named(SearchProblem.along(BENT, chips=9), ShutterCode("110100011"), **given)
    assert limits == [used]
    assert [name for name, row in rows.items() if row.stopped_early] == ["length-only code"]


def test_known_figures_and_the_chip_time_are_kept():
    problem = SearchProblem.along(BENT, chips=9)
    code = ShutterCode("110100011", 250_000)
    metrics = problem.measure(code)
    rows = named(problem, code, metrics=metrics)
    assert rows["this code"].metrics is metrics
    assert {row.code.chip_ns for row in rows.values()} == {250_000}
