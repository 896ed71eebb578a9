"""Codes of several frames: against every pair of short codes, plain sums of powers, and the search
of one code."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from cep.optics.band import band_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import open_path
from cep.optics.response import ShutterResponse
from cep.search.annealing.anneal import anneal
from cep.search.annealing.cooling import (
    cool,
    fresh_otf,
    new_chain,
    smallest_term,
    total_cost,
    worst_first,
)
from cep.search.annealing.proposals import LoopLimits
from cep.search.annealing.terms import BLOCK
from cep.search.cost import CodeCost
from cep.search.limits import RunLimits
from cep.search.problem import OBJECTIVES, SearchProblem
from lab.frames.annealing import anneal_frames, joint_cost, joint_figures, joint_tables
from motdiff.trajectory import Trajectory

MIX = (("noise", 1.0), ("flatness", 0.5))


def arc(length_px=6.0):
    angle = np.linspace(0, 2.2, 24) ** 1.4
    return Trajectory.from_samples(
        length_px / 3 * np.stack([np.cos(angle), np.sin(1.7 * angle)], 1)
    )


SHORT = {
    "circle": SearchProblem(chips=6, open_range=(3, 3)),
    "any light": SearchProblem(chips=6, open_range=(2, 4)),
    "curve": SearchProblem.along(arc(), chips=6, open_range=(3, 3), direction="unknown"),
    "ramps": SearchProblem.along(
        arc(),
        chips=6,
        open_range=(3, 3),
        response=ShutterResponse(chip_ns=1000, rise_ns=500, fall_ns=300),
    ),
}


def every_code(problem):
    codes = np.array(list(itertools.product((0, 1), repeat=problem.chips)), np.int8)
    return codes[problem.satisfied(codes)]


def every_pair(problem):
    codes = every_code(problem)
    return np.array([(one, other) for one in codes for other in codes])


@pytest.mark.parametrize("objective", ["noise", "min-mtf"])
@pytest.mark.parametrize("name", SHORT)
def test_no_pair_of_short_codes_is_better(name, objective):
    problem = replace(SHORT[name], objective=objective)
    fine = CodeCost.fine(problem)
    pairs = every_pair(problem)
    costs = np.concatenate([joint_cost(fine, pairs[i : i + 64]) for i in range(0, len(pairs), 64)])
    found = anneal_frames(
        problem, 2, rng=np.random.default_rng(0), steps=20_000, time_s=np.inf, threads=1
    )
    assert found.objective == pytest.approx(costs.min(), abs=1e-9)
    assert joint_cost(fine, np.array([[code.array for code in found.codes]]))[0] == pytest.approx(
        found.objective
    )
    assert found.stopped == "steps"
    figure = found.noise_gain_db if objective == "noise" else -20 * np.log10(found.minimum)
    assert figure == pytest.approx(found.objective)


def test_joint_powers_on_the_circle_are_sums_of_single_ones():
    problem = SearchProblem(chips=9, objective="noise")
    codes = (ShutterCode("110100010"), ShutterCode("100101110"), ShutterCode("101100111"))
    power = sum(np.abs(np.fft.fft(code.array, 2**14)) ** 2 for code in codes) / 81
    found = joint_figures(problem, codes)
    assert found.minimum == pytest.approx(np.sqrt(power.min()), rel=1e-4)
    assert found.noise_gain_db == pytest.approx(10 * np.log10((1 / power).mean()), abs=1e-3)


def test_joint_powers_along_a_curve_are_sums_of_single_ones():
    problem = SearchProblem.along(arc(9.0), chips=8, objective="noise", direction="unknown")
    codes = (ShutterCode("11010001"), ShutterCode("10010111"))
    samples = band_samples(arc(9.0))
    minima = []
    noise = []
    for path in (arc(9.0), arc(9.0).reversed()):
        power = sum(
            np.abs(open_path(path, code).otf(samples.fx, samples.fy)) ** 2 for code in codes
        )
        minima.append(np.sqrt(power.min()))
        noise.append(10 * np.log10(samples.weight @ (1 / power)))
    found = joint_figures(problem, codes)
    assert found.minimum == pytest.approx(min(minima), rel=1e-6)
    assert found.noise_gain_db == pytest.approx(max(noise), abs=1e-6)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_the_same_code_again_only_averages_noise(frames):
    code = ShutterCode("1100101011110001")
    problem = SearchProblem.along(Trajectory.straight(14.3), chips=16)
    single = problem.measure(code)
    found = joint_figures(problem, [code] * frames)
    assert found.noise_gain_db == pytest.approx(
        single.noise_gain_db - 10 * np.log10(frames), abs=1e-6
    )
    # sampled, so never below the continuum's
    assert single.min_mtf * np.sqrt(frames) <= found.minimum * (1 + 1e-9)
    assert found.minimum == pytest.approx(single.min_mtf * np.sqrt(frames), rel=1e-2)


def test_frames_see_what_one_of_them_is_blind_to():
    blind = ShutterCode("11110000")
    sees = ShutterCode("10000000")
    problem = SearchProblem(chips=8)
    assert joint_figures(problem, [blind, blind]).minimum < 1e-9
    assert joint_figures(problem, [blind, blind]).noise_gain_db > 100
    # the lone chip is flat
    assert joint_figures(problem, [blind, sees]).minimum == pytest.approx(1 / 8)


@pytest.mark.parametrize("objective", sorted({*OBJECTIVES} - {"min-mtf"}))
def test_one_frame_is_the_search_of_one_code(objective):
    problem = SearchProblem(chips=13, open_range=(6, 7), objective=objective)
    one = anneal(problem, rng=np.random.default_rng(0), steps=40_000, threads=1)
    frames = anneal_frames(problem, 1, rng=np.random.default_rng(0), steps=40_000, threads=1)
    assert frames.objective == pytest.approx(one.objective, abs=1e-6)
    assert len(frames.codes) == 1


@pytest.mark.parametrize("objective", ["noise", "min-mtf", "mse"])
@pytest.mark.parametrize(
    "limits",
    [
        {"open_range": (6, 6)},
        {"open_range": (5, 8), "runs": RunLimits(max_open=3)},
        {"open_range": (4, 9), "runs": RunLimits(min_open=2, min_closed=2, max_pulses=3)},
        {"open_range": (4, 9), "runs": RunLimits(max_open=3, min_period=4)},
    ],
)
def test_every_frame_keeps_the_limits(limits, objective):
    problem = SearchProblem(chips=16, objective=objective, **limits)
    found = anneal_frames(problem, 3, rng=np.random.default_rng(3), steps=30_000, threads=1)
    assert problem.satisfied(np.array([code.array for code in found.codes])).all()
    assert len(set(found.codes)) > 1


def test_no_start_beats_the_frames_returned():
    """Also where the coarse samples that rank the codes would drop it."""
    path = Trajectory.straight(17.3)
    problem = SearchProblem.along(path, chips=16, open_range=(6, 9), objective="min-mtf")
    fine = CodeCost.fine(problem)
    codes = problem.random_codes(60, rng=np.random.default_rng(2))
    starts = [[ShutterCode(code)] * 2 for code in codes]
    best = joint_cost(fine, np.repeat(codes[:, None], 2, axis=1)).min()
    found = anneal_frames(
        problem, 2, rng=np.random.default_rng(0), steps=8, start=starts, threads=1
    )
    assert found.objective <= best


def test_two_frames_beat_the_best_code_played_twice():
    problem = SearchProblem(chips=16, open_range=(8, 8), objective="noise")
    fine = CodeCost.fine(problem)
    best = fine.cost_of(every_code(problem)).min()
    found = anneal_frames(problem, 2, rng=np.random.default_rng(0), steps=60_000, threads=1)
    assert found.noise_gain_db < best - 10 * np.log10(2) - 0.3


def test_what_was_given_is_never_lost():
    problem = SearchProblem(chips=30, open_range=(15, 15), objective="noise")
    code = anneal(problem, rng=np.random.default_rng(0), steps=60_000, threads=1).code
    given = joint_figures(problem, [code, code]).noise_gain_db
    found = anneal_frames(
        problem, 2, rng=np.random.default_rng(0), steps=8, start=[[code, code]], threads=1
    )
    assert found.noise_gain_db <= given + 1e-9


def test_the_seed_decides_not_the_threads():
    problem = SearchProblem(chips=24, open_range=(10, 14), objective="mse")
    found = [
        anneal_frames(problem, 2, rng=np.random.default_rng(5), steps=50_000, threads=threads)
        for threads in (1, 3)
    ]
    assert found[0].codes == found[1].codes
    assert found[0].steps == found[1].steps >= 50_000


def test_ctrl_c_keeps_the_best():
    problem = SearchProblem(chips=20, open_range=(10, 10), objective="noise")

    def progress(_fraction, codes):
        assert len(codes) == 2
        raise KeyboardInterrupt

    found = anneal_frames(
        problem, 2, rng=np.random.default_rng(0), steps=10**9, progress=progress, threads=1
    )
    assert found.stopped == "interrupted"
    assert problem.satisfied(np.array([code.array for code in found.codes])).all()


@pytest.mark.parametrize(
    ("frames", "options", "message"),
    [
        (0, {}, "frames: must be at least 1"),
        (2, {"steps": 0}, "steps"),
        (2, {"time_s": 0.0}, "time_s"),
        (2, {"start": [[ShutterCode("101011")]]}, "start: every one must be 2 codes of 6 chips"),
        (1, {"start": [[ShutterCode("10101")]]}, "start"),
    ],
)
def test_bad_arguments_are_named(frames, options, message):
    with pytest.raises(ValueError, match=message):
        anneal_frames(SHORT["circle"], frames, rng=np.random.default_rng(0), **options)


# -- the compiled loops with several frames -------------------------------------------------------


def started(problem, frames, seed=0):
    """Coarse objective, its tables, and a chain of several frames."""
    coarse = CodeCost(problem, oversampling=8, dtype=np.float64)
    tables = joint_tables(coarse, frames)
    drawn = problem.random_codes(20 * frames, rng=np.random.default_rng(seed)).reshape(
        20, frames, -1
    )
    code = drawn[np.argsort(joint_cost(coarse, drawn))[4]].astype(np.int8).ravel()
    chain = new_chain(tables, code, 2 * seed + 1, frames=frames)
    fresh_otf(tables, chain.code, problem.chips, chain.otf)
    chain.cost[0] = total_cost(tables, problem.chips, chain.code, chain.otf)
    return coarse, tables, chain


@pytest.mark.parametrize("objective", [*OBJECTIVES, MIX])
@pytest.mark.parametrize("name", ["any light", "curve"])
def test_the_loop_judges_as_the_plain_arithmetic(name, objective):
    problem = replace(SHORT[name], objective=objective)
    coarse, tables, chain = started(problem, 3)
    if objective == "min-mtf":
        power = (coarse.otf(chain.code.reshape(3, -1)) ** 2).sum(axis=(0, 1))
        parts = [power[part.columns][part.samples.weight > 0] for part in coarse.parts]
        expected = max(2.5 * np.log10((part**-4.0).sum()) for part in parts)
        lowest = min(part.min() for part in parts)
        assert smallest_term(tables, chain.otf) == pytest.approx(lowest, rel=1e-3)
    else:
        expected = joint_cost(coarse, chain.code.reshape(1, 3, -1))[0]
    assert chain.cost[0] == pytest.approx(expected, abs=1e-2)
    worst_first(tables, chain.otf)
    assert total_cost(tables, problem.chips, chain.code, chain.otf) == pytest.approx(
        chain.cost[0], abs=1e-3
    )
    fresh_otf(tables, chain.code, problem.chips, chain.otf)
    assert total_cost(tables, problem.chips, chain.code, chain.otf) == pytest.approx(
        chain.cost[0], abs=1e-3
    )


@pytest.mark.parametrize("name", ["any light", "curve", "ramps"])
def test_moves_in_several_frames_keep_the_books(name):
    problem = replace(SHORT[name], objective="noise")
    _, tables, chain = started(problem, 2, seed=2)
    low, high = problem.open_limits
    limits = LoopLimits.of(problem)._replace(low=2 * low, high=2 * high)
    free = np.arange(2 * problem.chips)
    work = np.empty((3, BLOCK), np.float32)
    for _ in range(10):
        cool(tables, limits, chain, free, work, np.array([1.0, 0.5]), 40)
        claimed = chain.cost[0]
        otf = chain.otf.copy()
        fresh_otf(tables, chain.code, problem.chips, chain.otf)
        assert np.abs(otf - chain.otf).max() < 1e-4
        assert claimed == pytest.approx(
            total_cost(tables, problem.chips, chain.code, chain.otf), abs=2e-3
        )
        assert 2 * low <= chain.code.sum() <= 2 * high


# -- the command ----------------------------------------------------------------------------------
