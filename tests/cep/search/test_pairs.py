"""Codes of two cameras that record one exposure: against brute force and the closed form."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from cep.codes.published import published
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf
from cep.optics.response import ShutterResponse
from cep.optics.scene import noise_variance
from cep.search.annealing.anneal import anneal
from cep.search.annealing.proposals import LoopLimits, keeps_runs
from cep.search.baselines import compare
from cep.search.code_search import SearchOptions, search_code
from cep.search.cost import CodeCost
from cep.search.expected import joint_psnr_db, light_noise
from cep.search.limits import Limits, RunLimits
from cep.search.optimize import optimize
from cep.search.pairs import measure_pairs
from cep.search.problem import OBJECTIVES, SearchProblem
from cep.search.verdict import verdict
from motdiff.trajectory import Trajectory

CAMERA = Camera(photons_full_scale=10_000, read_noise_e=50)
STRAIGHT = Trajectory.straight(12.0)


def arc():
    t = np.linspace(0, 1, 40)
    return Trajectory.from_samples(np.stack([9 * t, 6 * t**2], axis=1), direction="known")


def pair(path=STRAIGHT, chips=10, **options):
    return SearchProblem.along(path, chips=chips, camera=CAMERA, frames=2, **options)


def every_code(problem):
    codes = np.array([*itertools.product((0, 1), repeat=problem.chips)], dtype=np.int8)
    return codes[problem.satisfied(codes)]


@pytest.mark.parametrize("objective", sorted(OBJECTIVES))
@pytest.mark.parametrize("path", [STRAIGHT, replace(arc(), direction="unknown")])
def test_the_search_finds_the_best_of_all_pairs(path, objective):
    problem = pair(path, objective=objective)
    lowest = CodeCost.fine(problem).cost_of(every_code(problem)).min()
    outcome = anneal(problem, rng=np.random.default_rng(0), steps=100_000)
    assert outcome.objective == pytest.approx(lowest, abs=1e-9)


@pytest.mark.parametrize("objective", sorted(OBJECTIVES))
def test_a_code_costs_as_much_as_its_complement(objective):
    problem = pair(arc(), objective=objective, direction="unknown")
    cost = CodeCost.fine(problem)
    codes = problem.random_codes(50, rng=np.random.default_rng(1))
    assert cost.cost_of(1 - codes) == pytest.approx(cost.cost_of(codes), abs=1e-9)


def test_the_cost_is_that_of_both_powers_at_half_of_the_light():
    problem = pair(arc(), objective="mse", direction="forward")
    cost = CodeCost.fine(problem)
    (part,) = cost.parts
    codes = [ShutterCode("1101000110"), ShutterCode("0010111001")]
    noise = noise_variance(CAMERA, 0.5)
    signal = sum(
        np.abs(coded_otf(arc(), code, part.samples.fx, part.samples.fy)) ** 2 / noise
        for code in codes
    )
    per_frequency = (cost.shares_across / (signal[:, None] + cost.priors)).sum(axis=1)
    expected_db = 10 * np.log10(part.samples.weight @ per_frequency)
    assert cost.cost_of(codes[0].array[None])[0] == pytest.approx(expected_db, abs=1e-9)
    # half open each: the figures of the two, each with its own noise, are the same
    (metrics,) = measure_pairs(problem, [(codes[0], codes[1])])
    variances = light_noise(CAMERA, codes)
    assert metrics.mse_db == pytest.approx(-joint_psnr_db(problem, codes, noise=variances)[0])
    assert metrics.mse_db == pytest.approx(expected_db, abs=0.02)
    root = np.sqrt(signal * noise / 2)
    assert metrics.min_mtf == pytest.approx(root.min())
    cost_db = cost.instead("min-mtf").cost_of(codes[0].array[None])[0]
    assert cost_db == pytest.approx(-20 * np.log10(root.min()))


def test_a_shutter_as_fast_to_open_as_to_close_has_the_exact_complement():
    response = ShutterResponse(chip_ns=1000, rise_ns=400, fall_ns=400)
    options = {"objective": "mse", "response": response, "chip_ns": 1000}
    codes = pair(arc(), **options).random_codes(20, rng=np.random.default_rng(3))
    codes = codes[:, [0, *range(10)]]  # alike at the ends, where a ramp may lie outside
    problem = pair(arc(), chips=11, **options)
    alone = CodeCost.fine(problem.of_one_camera)
    powers = [(alone.otf(chips) ** 2).sum(axis=1) for chips in (codes, 1 - codes)]
    both = CodeCost.fine(problem)
    power = (both.otf(codes) ** 2).sum(axis=1) + both.floor
    np.testing.assert_allclose(power, sum(powers) / 2, atol=1e-9)


def test_both_shutters_keep_the_limits():
    runs = RunLimits(min_open=2, min_closed=1, max_pulses=3, max_open=6, min_period=4)
    one = Limits(12, (3, 8), runs)
    both = Limits.of_pair(12, (3, 8), runs)
    codes = np.array([*itertools.product((0, 1), repeat=12)], dtype=np.int8)
    expected = one.satisfied(codes) & one.satisfied(1 - codes)
    np.testing.assert_array_equal(both.satisfied(codes), expected)
    problem = pair(chips=12, open_range=(3, 8), runs=runs)
    assert problem.open_limits == (4, 8)
    loop = LoopLimits.of(problem)
    light = (codes.sum(axis=1) >= 4) & (codes.sum(axis=1) <= 8)
    in_loop = np.array([keeps_runs(code, loop) for code in codes])
    np.testing.assert_array_equal(in_loop & light, expected)
    drawn = problem.random_codes(400, rng=np.random.default_rng(0))
    assert both.satisfied(drawn).all()
    assert len(np.unique(drawn, axis=0)) > 0.9 * expected.sum() * (
        1 - np.exp(-400 / expected.sum())
    )


def test_a_search_within_limits_returns_a_code_whose_complement_keeps_them():
    runs = RunLimits(min_open=2, max_open=5)
    problem = pair(arc(), chips=12, objective="mse", runs=runs)
    outcome = search_code(problem, SearchOptions(steps=50_000))
    alone = problem.of_one_camera
    assert alone.allows(outcome.code)
    assert alone.allows(outcome.code.complement())
    assert outcome.objective == pytest.approx(
        CodeCost.fine(problem).cost_of(every_code(problem)).min(), abs=1e-9
    )
    assert not any(row.name.startswith("open shutter") for row in outcome.baselines)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"frames": 3}, "frames: must be 1, or 2"),
        ({"frames": 0}, "frames: must be 1, or 2"),
        ({"open_range": (2, 4)}, "open_range, min_open and frames: conflict"),
        ({"runs": RunLimits(max_open=2, min_closed=3)}, "frames|conflict"),
    ],
)
def test_bad_pairs_are_refused(options, line):
    with pytest.raises(ValueError, match=line):
        SearchProblem.along(STRAIGHT, chips=10, **{"frames": 2, **options})


def test_no_proof_covers_a_pair():
    problem = pair(objective="min-mtf")
    with pytest.raises(ValueError, match="frames"):
        search_code(problem, SearchOptions(method="exact"))
    with pytest.raises(ValueError, match="frames"):
        compare(problem, ShutterCode("1101000110"))
    outcome = search_code(problem, SearchOptions(steps=20_000))
    assert outcome.proof is None
    assert outcome.stopped != "proven"


def test_an_optimised_pair_beats_raskars_code_and_has_no_certificate():
    problem = SearchProblem.along(
        Trajectory.straight(36.0), chips=52, objective="mse", camera=CAMERA, frames=2
    )
    best = optimize(problem, steps=300_000, photographs=[])
    raskar = published("raskar-52").code
    designed, classic = measure_pairs(
        problem, [(code, code.complement()) for code in (best.code, raskar)]
    )
    assert 0.4 < classic.mse_db - designed.mse_db < 2.5
    assert best.certificate is None
    assert best.bound is None
    assert best.verdict.choice == "code"
    assert best.complement == best.code.complement()
    open_row = next(row for row in best.comparison if row.name == "two open shutters")
    single = problem.of_one_camera
    # two photos of one kind have half of the noise of one
    halved = joint_psnr_db(single, [open_row.code], noise=light_noise(CAMERA, [open_row.code]) / 2)
    assert open_row.metrics.mse_db == pytest.approx(-halved[0])


@pytest.mark.slow(reason="restores some forty photos")
def test_a_pair_is_measured_as_it_is_restored():
    """A run beside its rest is not the run in both cameras."""
    few = [np.random.default_rng(k).random((200, 200)) * 0.5 + 0.2 for k in range(2)]
    bright = Camera(photons_full_scale=1e6, bits=16)
    problem = SearchProblem.along(STRAIGHT, chips=12, objective="mse", camera=bright, frames=2)
    run = ShutterCode("111111000000")
    judged = verdict(problem, run, photographs=few)
    assert judged.photographs == 2
    assert judged.is_pair
    halves = judged.exposures[-1]
    assert (halves.kind, halves.code.bits) == ("code", run.bits)
    assert halves.psnr_db > judged.exposures[0].psnr_db + 1
    assert len(halves.photo_psnr_db) == 2
