"""Tabu walks: every move judged as the objective judges it, within the light, and out of local minima."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.search import anneal as annealing
from cep.search.objective import Objective
from cep.search.problem import Scenario, SearchProblem
from cep.search.tabu import TabuWalk, fits
from motdiff.trajectory import Trajectory


def all_moves(code, low, high):
    """Codes one flip or one swap away whose light is allowed."""
    near = [code ^ np.eye(code.size, dtype=np.int8)[i] for i in range(code.size)]
    for i in np.flatnonzero(code):
        for j in np.flatnonzero(code == 0):
            swapped = code.copy()
            swapped[[i, j]] = swapped[[j, i]]
            near.append(swapped)
    return {tuple(c) for c in near if low <= c.sum() <= high}


@pytest.mark.parametrize("objective", ["min-mtf", "mse", "flatness"])
@pytest.mark.parametrize("light", [(6, 6), (4, 7)])
def test_a_step_takes_the_best_of_all_moves(objective, light):
    straight = (Scenario(Trajectory.straight(14.0)),)
    problem = SearchProblem(chips=12, open_range=light, objective=objective, scenarios=straight)
    search = Objective(problem, oversampling=8, dtype=np.float64)
    start = np.array([1, 1, 0, 1, 0, 0, 0, 1, 0, 1, 0, 1], dtype=np.int8)
    walk = TabuWalk(search, start[None])
    opened, closed = np.flatnonzero(start), np.flatnonzero(start == 0)
    on, off, costs = walk._neighbours(start, opened, closed, *light)
    moved = np.repeat(start[None], costs.size, axis=0)
    for code, i, j in zip(moved, on, off, strict=True):
        code[np.unique([i, j])] ^= 1
    assert {tuple(code) for code in moved} == all_moves(start, *light)
    otf = search.otf(moved)
    again = search.cost(otf, moved.sum(axis=1, dtype=np.intp), soft=True)
    # beyond 100 dB there is a zero, and only rounding differs
    np.testing.assert_allclose(np.minimum(costs, 100), np.minimum(again, 100), atol=1e-8)


@given(st.integers(0, 1000), st.integers(2, 14), st.data())
@settings(max_examples=12, deadline=None)
def test_walks_keep_the_light_and_repeat(seed, chips, data):
    low = data.draw(st.integers(1, chips - 1))
    problem = SearchProblem(chips=chips, open_range=(low, data.draw(st.integers(low, chips))))
    search = Objective(problem, oversampling=8)
    start = problem.random_codes(3, rng=np.random.default_rng(seed))

    def walked():
        rng, walk, offered = np.random.default_rng(seed), TabuWalk(search, start), []
        moves = [sum(walk.walk(rng, offered.extend)) for _ in range(2)]
        return moves, np.array(offered)

    (moves, offered), (again, same) = walked(), walked()
    assert min(moves) > 0
    assert problem.satisfied(offered).all()
    assert moves == again
    np.testing.assert_array_equal(offered, same)


def test_walks_leave_local_minima_behind():
    """Walks find the best code of a brute force, where most plain descents end earlier."""
    problem = SearchProblem(chips=14, open_range=(7, 7))
    search = Objective(problem, oversampling=8)
    everything = ((np.arange(1, 2**14)[:, None] >> np.arange(14)) & 1).astype(np.int8)
    everything = everything[problem.satisfied(everything)]
    best = search.cost(search.otf(everything), everything.sum(axis=1, dtype=np.intp), soft=True).min()
    reached = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        walk, seen = TabuWalk(search, problem.random_codes(1, rng=rng)), []
        for _ in range(12):
            list(walk.walk(rng, seen.extend))
        codes = np.array(seen)
        reached.append(search.cost(search.otf(codes), codes.sum(axis=1, dtype=np.intp), soft=True).min())
    np.testing.assert_allclose(reached, best, atol=1e-3)


def test_only_small_free_problems_are_walked():
    free = SearchProblem(chips=16)
    assert fits(Objective(free, oversampling=8))
    assert not fits(Objective(SearchProblem(chips=16, min_open=2), oversampling=8))
    assert not fits(Objective(SearchProblem(chips=16, open_range=(16, 16)), oversampling=8))
    bent = Trajectory.from_samples([[0, 0], [20, 4], [30, 30]])
    assert not fits(Objective(SearchProblem.along(bent, chips=60), oversampling=8))
    assert annealing.standard_moves(free) > annealing.standard_moves(SearchProblem(chips=16, min_open=2))


def test_a_search_walks_after_its_first_round(monkeypatch):
    monkeypatch.setattr(annealing, "_ROUND", 40)
    problem = SearchProblem(chips=52, open_range=(26, 26))
    annealed = annealing.anneal(problem, rng=np.random.default_rng(0), steps=2000)
    walked, again = (annealing.anneal(problem, rng=np.random.default_rng(0), steps=200_000) for _ in range(2))
    assert walked.code == again.code
    assert walked.objective < annealed.objective - 0.5  # dB
