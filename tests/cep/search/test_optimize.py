"""One call from a problem to a code: what is searched, certified, compared, shown and saved."""

import dataclasses

import pytest

from cep.files.code_files import read_code
from cep.optics.camera import Camera
from cep.proofs.verify import verify
from cep.search.cost import CodeCost
from cep.search.limits import RunLimits
from cep.search.optimize import optimize
from cep.search.problem import OBJECTIVES, SearchProblem
from motdiff.trajectory import Trajectory

STRAIGHT = Trajectory.straight(16.0)
BENT = Trajectory.from_samples([[0, 0], [9, 3], [14, 12]])


def judge_of(problem):
    return CodeCost.fine(problem)


@pytest.mark.parametrize("objective", sorted({*OBJECTIVES} - {"min-mtf"}))
def test_along_a_straight_motion_only_the_minimum_is_searched_on_the_circle(objective):
    """Of the other objectives the cost told is the one along the path: the chips' own roll-off
    counts."""
    problem = SearchProblem.along(STRAIGHT, chips=16, objective=objective, open_range=(6, 10))
    best = optimize(problem, steps=2000)
    assert best.search.objective == pytest.approx(
        judge_of(problem).exact_cost(best.code), abs=1e-9
    )
    circle = dataclasses.replace(problem, scenarios=(), objective="noise")
    if objective == "noise":
        assert abs(best.search.objective - judge_of(circle).exact_cost(best.code)) > 0.1


def test_the_minimum_of_a_straight_motion_is_the_polynomial_s():
    best = optimize(SearchProblem.along(STRAIGHT, chips=16, open_range=(6, 10)), steps=2000)
    assert best.along is None
    assert best.certificate.unit == "chips"
    assert best.metrics.min_chip == pytest.approx(best.certificate.upper, rel=1e-6)
    assert verify(best.certificate)


def test_nothing_in_the_comparison_that_keeps_the_limits_is_better():
    problem = SearchProblem.along(
        BENT,
        chips=16,
        objective="mse",
        duty=(0.3, 0.6),
        runs=RunLimits(min_open=2),
        camera=Camera(2_000.0, 40.0),
    )
    best = optimize(problem, steps=1)
    judge = judge_of(problem)
    costs = [judge.exact_cost(row.code) for row in best.comparison if row.within_limits]
    assert costs[0] == min(costs)
    assert problem.allows(best.code)


def test_saved_and_read_back(tmp_path):
    problem = SearchProblem.along(BENT, chips=12, objective="mse", exposure_s=0.006)
    best = optimize(problem, steps=500, seed=3)
    best.save(tmp_path / "code.json")
    stored = read_code(tmp_path / "code.json")
    assert stored.code == best.code
    assert stored.code.chip_ns == 500_000
    assert stored.problem["seed"] == 3
    assert verify(stored.certificate, bits=stored.code.bits)
    assert best.code.bits in repr(best)
    assert "best snapshot" in repr(best)
    assert best._repr_png_().startswith(b"\x89PNG")


def test_a_device_and_an_exposure_set_chips_and_limits():
    problem = SearchProblem.along(
        BENT, chips=12, duty=(0.25, 0.75), exposure_s=0.12, device="lc-dual-frequency"
    )
    assert problem.chip_ns == 10_000_000
    assert problem.response is not None
    assert not problem.on_circle
    warnings = optimize(problem, steps=200).warnings
    assert any("opens at once" in line for line in warnings)
    for wrong in (
        {"duty": (0.1, 0.2), "open_range": (2, 3)},
        {"exposure_s": 1.0, "chip_ns": 5},
        {"exposure_s": 0.0},
    ):
        with pytest.raises(
            ValueError, match=r"^(duty and open_range|exposure_s and chip_ns|exposure_s): "
        ):
            SearchProblem.along(BENT, chips=12, **wrong)


def test_a_search_needs_a_motion_that_tells_its_chips_apart():
    with pytest.raises(ValueError, match=r"^scenarios: need a motion"):
        optimize(SearchProblem(chips=8))
    with pytest.raises(ValueError, match="at most 40 can be resolved"):
        optimize(SearchProblem.along(Trajectory.straight(10.0), chips=41))


def test_a_time_that_ends_the_search_is_told_with_its_moves():
    best = optimize(SearchProblem.along(BENT, chips=12), steps=10**12, time_s=0.01)
    assert best.search.stopped == "time"
    assert (
        "the limit of 0.01 s ended the search before its 1,000,000,000,000 moves"
        in best.warnings[0]
    )


@pytest.mark.parametrize(("wrong", "message"), [({"method": "magic"}, "^method: ")])
def test_an_unknown_method_is_refused_and_not_searched_by_another(wrong, message):
    with pytest.raises(ValueError, match=message):
        optimize(SearchProblem.along(BENT, chips=12), steps=10, **wrong)
