"""Sweeps: moves within the limits, costs that are accepted, the deepest codes kept, and the best
one found."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.optics.response import ShutterResponse
from cep.proofs.certify.minimum import min_chip
from cep.search.annealing.anneal import anneal, run_chains
from cep.search.annealing.sweeps import can_sweep, sweep_chain, sweep_loop, sweep_tables
from cep.search.cost import CodeCost
from cep.search.limits import RunLimits
from cep.search.optima import proven_optimum
from cep.search.problem import Scenario, SearchProblem
from motdiff.trajectory import Trajectory

SLOWING = Trajectory.from_samples([[0, 0], [6, 3], [14, 7]])
PROBLEMS = {
    "circle": SearchProblem(chips=20, open_range=(6, 14)),
    "fixed light": SearchProblem(chips=17, open_range=(8, 8)),
    "any light of many chips": SearchProblem(chips=33, open_range=(12, 20)),
    "straight": SearchProblem.along(SLOWING, chips=18, direction="forward"),
}


def fine_powers(objective, codes):
    otf = objective.otf(codes.astype(float))
    return (otf**2).sum(axis=1).min(axis=1) * codes.shape[1] ** 2


@pytest.mark.parametrize("name", PROBLEMS)
def test_moves_keep_the_limits_and_the_deepest_codes(name):
    problem = PROBLEMS[name]
    assert can_sweep(problem)
    judge = CodeCost.fine(problem)
    tables = sweep_tables(CodeCost(problem, oversampling=8), judge)
    random = np.array([77], np.uint64)
    code = problem.random_codes(1, rng=np.random.default_rng(0))[0].astype(np.int8)
    deepest = np.zeros(1)
    visited = {code.tobytes()}
    for _ in range(60):
        best = np.zeros((5, problem.chips), np.int8)
        found = np.zeros(1, np.int64)
        before = deepest[0]
        assert (
            300
            <= sweep_loop(tables, code, random, 0.5, 300, deepest, best, found)
            < 300 + problem.chips
        )
        assert problem.satisfied(code[None])[0]
        visited.add(code.tobytes())
        kept = best[: found[0]]
        if len(kept):
            powers = fine_powers(judge, kept)
            assert problem.satisfied(kept).all()
            assert (np.diff(powers) > 0).all()
            assert powers[0] > before - 1e-4
            assert powers[-1] == pytest.approx(deepest[0], rel=1e-3, abs=1e-4)
        assert fine_powers(judge, code[None])[0] <= deepest[0] + 1e-3
    assert len(visited) > 10


def test_a_cold_sweep_only_improves():
    problem = PROBLEMS["circle"]
    judge = CodeCost.fine(problem)
    tables = sweep_tables(CodeCost(problem, oversampling=8), judge)
    random = np.array([5], np.uint64)
    code = problem.random_codes(1, rng=np.random.default_rng(3))[0].astype(np.int8)
    costs = []
    for _ in range(40):
        otf = np.einsum("n,npf->pf", code.astype(float), tables.by_chip.astype(float))
        costs.append(2.5 * np.log10(((otf**2).sum(axis=0) ** -4.0).sum()))
        sweep_loop(
            tables,
            code,
            random,
            1e-9,
            40,
            np.zeros(1),
            np.zeros((1, 20), np.int8),
            np.zeros(1, np.int64),
        )
    assert (np.diff(costs) <= 1e-3).all()
    assert costs[-1] < costs[0] - 3


def test_a_zero_between_the_samples_of_the_moves_is_seen():
    """At 8 samples per 1 / chips a code with a zero may look better than each code with a true
    minimum as large."""
    problem = SearchProblem(chips=52, open_range=(26, 26))
    objective = CodeCost(problem, oversampling=8)
    judge = CodeCost(problem, oversampling=64)
    tables = sweep_tables(objective, judge)
    codes = []
    chains = [
        sweep_chain(problem, tables, moves=2**16, temperature_db=0.22, seed=seed)
        for seed in range(60)
    ]
    run_chains(chains, lambda _moves: True, codes.append, threads=1)
    for some in codes:
        minima = [min_chip(ShutterCode(code)) for code in some]
        assert minima[-1] >= max(minima) - 0.1


@pytest.mark.parametrize("light", [(1, 12), (5, 5)])
def test_the_best_of_all_codes_is_found(light):
    problem = SearchProblem(chips=12, open_range=light)
    every = np.array(list(product((0, 1), repeat=12)), np.int8)
    every = every[problem.satisfied(every)]
    best = fine_powers(CodeCost.fine(problem), every).max() ** 0.5
    found = anneal(problem, rng=np.random.default_rng(1), steps=400_000, threads=1)
    assert min_chip(found.code) == pytest.approx(best, rel=1e-3)


@pytest.mark.parametrize("chips", [26, 29])
def test_proven_optima_are_found_without_their_table(chips):
    problem = SearchProblem(chips=chips)
    found = anneal(problem, rng=np.random.default_rng(0), steps=2**26)
    assert min_chip(found.code) >= 0.98 * proven_optimum(problem).minimum.lower


def test_the_seed_decides_not_the_threads():
    problem = SearchProblem(chips=40, open_range=(18, 24))
    objective = CodeCost(problem, oversampling=8)
    judge = CodeCost(problem, oversampling=64)
    offered = []
    for threads in (1, 3):
        codes = []
        tables = sweep_tables(objective, judge)
        chains = [
            sweep_chain(problem, tables, moves=300_000, temperature_db=0.3, seed=seed)
            for seed in (1, 2, 3)
        ]
        run_chains(chains, lambda _moves: True, codes.append, threads=threads)
        offered.append(codes)
    for one, three in zip(*offered, strict=True):
        assert len(one)
        assert np.array_equal(one, three)


@pytest.mark.parametrize(
    "problem",
    [
        replace(PROBLEMS["circle"], objective="noise"),
        replace(PROBLEMS["circle"], objective=(("min-mtf", 1.0), ("noise", 0.1))),
        replace(PROBLEMS["circle"], runs=RunLimits(min_open=2)),
        replace(PROBLEMS["straight"], direction="unknown"),
        replace(
            PROBLEMS["straight"], response=ShutterResponse(chip_ns=1000, rise_ns=500, fall_ns=300)
        ),
        replace(
            PROBLEMS["straight"], scenarios=(Scenario(SLOWING), Scenario(Trajectory.straight(9.0)))
        ),
        SearchProblem.along(Trajectory.from_samples([[0, 0], [6, 1], [9, 5]]), chips=18),
        SearchProblem(chips=65),
    ],
)
def test_other_problems_are_searched_as_before(problem):
    assert not can_sweep(problem)
