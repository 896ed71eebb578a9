"""Codes near one: their OTF and the cheapest of them against the plain arithmetic over all of
them."""

from dataclasses import replace

import numpy as np
import pytest

from cep.optics.response import ShutterResponse
from cep.search.annealing.polish import cheapest, neighbours, otf_nearby, polish
from cep.search.cost import CodeCost
from cep.search.problem import OBJECTIVES, Scenario, SearchProblem
from motdiff.trajectory import Trajectory


def arc(length_px=12.0):
    angle = np.linspace(0, 2.2, 24) ** 1.4
    return Trajectory.from_samples(
        length_px / 3 * np.stack([np.cos(angle), np.sin(1.7 * angle)], 1)
    )


PROBLEMS = {
    "circle": SearchProblem(chips=30, open_range=(12, 18)),
    "both ways": SearchProblem.along(arc(), chips=12, open_range=(4, 8), direction="unknown"),
    "mean": SearchProblem(
        chips=12,
        scenarios=(Scenario(arc(), 3.0), Scenario(Trajectory.straight(9.0))),
        rule="mean",
        open_range=(4, 8),
    ),
    "ramps": SearchProblem.along(
        arc(),
        chips=12,
        open_range=(4, 8),
        response=ShutterResponse(chip_ns=1000, rise_ns=500, fall_ns=300),
    ),
}


def started(problem):
    judge = CodeCost.fine(problem)
    code = problem.random_codes(1, rng=np.random.default_rng(3))[0].astype(np.int8)
    return judge, code, neighbours(problem, code, swaps=True)


@pytest.mark.parametrize("name", PROBLEMS)
def test_otf_of_neighbours(name):
    judge, code, codes = started(PROBLEMS[name])
    codes = np.concatenate(
        [codes, code[None], 1 - code[None]]
    )  # the code itself, and one that differs everywhere
    assert (
        np.abs(otf_nearby(judge, code, judge.otf(code[None])[0], codes) - judge.otf(codes)).max()
        < 1e-12
    )


@pytest.mark.parametrize("objective", [*OBJECTIVES, (("noise", 1.0), ("min-mtf", 0.5))])
@pytest.mark.parametrize("name", PROBLEMS)
def test_cheapest_neighbours(name, objective):
    judge, code, codes = started(replace(PROBLEMS[name], objective=objective))
    costs = judge.cost_of(codes)
    for below in (np.inf, np.sort(costs)[2] + 1e-9, costs.min() - 1.0):
        *_, found = cheapest(judge, code, codes, count=5, below=below)
        expected = np.sort(costs[costs < below])[:5]
        assert np.allclose(costs[found], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("objective", ["min-mtf", "noise"])
def test_a_polished_code_has_no_better_neighbour(objective):
    problem = SearchProblem(chips=20, open_range=(10, 10), objective=objective)
    ranked = problem.random_codes(3, rng=np.random.default_rng(0)).astype(np.int8)
    fine = CodeCost.fine(problem)
    told = list(polish(fine, ranked))
    costs = [one.cost for one in told]
    fractions = [one.done for one in told]
    assert fractions == sorted(fractions)
    # the best of the codes as they come in, then ever better
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[2]
    near = neighbours(problem, told[-1].code.array.astype(np.int8), swaps=True)
    hopeful = near[fine.cost_of(near) < costs[-1]]
    assert all(fine.exact_cost(type(told[-1].code)(one)) >= costs[-1] - 1e-9 for one in hopeful)
