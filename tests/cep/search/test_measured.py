"""Gains measured on photographs: what is stated is what the photographs show."""

import re
from dataclasses import replace

import numpy as np
import pytest

import cep
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.scene import PHOTO, SCENES
from cep.photographs.scenes import photographs
from cep.photographs.trial import PhotoTrial
from cep.search.cost import CodeCost
from cep.search.exposures import CODED, Exposure, gain_range_db, kind_of
from cep.search.measured import LONGEST_PX, corrected, corrections_db
from cep.search.problem import SearchProblem
from cep.search.verdict import verdict
from motdiff.trajectory import Trajectory

NOISY = Camera(photons_full_scale=10_000, read_noise_e=50, bits=16)
QUIET = Camera(photons_full_scale=10_000, read_noise_e=2, bits=16)
CODE = ShutterCode("110100101011")


@pytest.fixture(scope="module")
def few():
    return photographs()[:2]


@pytest.fixture(scope="module")
def problem():
    return SearchProblem.along(Trajectory.straight(12.0), chips=12, camera=NOISY)


@pytest.fixture(scope="module")
def judged(problem, few):
    return verdict(problem, CODE, photographs=few)


def test_every_figure_is_one_that_photographs_show(problem, few, judged):
    trial = PhotoTrial([Trajectory.straight(12.0)], few, camera=NOISY)
    assert judged.photographs == 2
    in_full = [way for way in judged.exposures if len(way.photo_psnr_db) == 2]
    assert {"open", "code", "snapshot"} <= {way.kind for way in in_full}
    for way in (judged.exposures[0], judged.user_code, judged.best("snapshot")):
        levels = trial.psnr_db([way.code])[0]
        assert way.photo_psnr_db == pytest.approx(levels.tolist())
        assert way.psnr_db == pytest.approx(levels.mean())


def test_the_sentence_states_the_measured_gain_and_its_range(judged):
    code = judged.best("code")
    single = judged.best("snapshot")
    gains = np.subtract(code.photo_psnr_db, single.photo_psnr_db)
    said = re.search(
        r"([\d.]+) dB over the best single exposure"
        r" \((-?[\d.]+) to (-?[\d.]+) on 2 photographs\)",
        judged.sentence,
    )
    figures = [gains.mean(), gains.min(), gains.max()]
    assert [float(figure) for figure in said.groups()] == pytest.approx(figures, abs=0.051)
    assert "Gains are means over 2 photographs, restored at 10,000" in judged.sentence
    assert "about" not in judged.sentence
    document = judged.to_dict()
    assert document["photographs"] == 2
    assert document["code_gain_range_db"] == pytest.approx((gains.min(), gains.max()))


@pytest.mark.slow(reason="searches and dozens of restorations")
def test_a_code_that_photographs_do_not_bear_out_is_advised_against():
    """Straight motion, much read noise in bright light: what the model calls the best code loses
    to a single exposure in photos of their size."""
    camera = Camera(photons_full_scale=100_000, read_noise_e=200, bits=16)
    problem = SearchProblem.along(Trajectory.straight(40.0), chips=40, camera=camera)
    code = ShutterCode("1111110001001100010101001011001011000100")
    modelled, measured = (
        verdict(problem, code, photographs=scenes) for scenes in ((), photographs()[:3])
    )
    assert modelled.advised is modelled.user_code
    assert modelled.user_code.psnr_db > modelled.best("snapshot").psnr_db + 2
    assert measured.advised is not measured.user_code
    assert measured.user_code.psnr_db < measured.best("snapshot").psnr_db - 1


@pytest.mark.slow(reason="searches and dozens of restorations")
def test_photographs_choose_among_the_codes_and_the_noise_is_of_the_seed(problem, few):
    first, second, other = (
        cep.advise(problem, levels=[], photographs=few[:1], seed=seed) for seed in (0, 0, 1)
    )
    assert first.to_dict() == second.to_dict()
    levels = [advice.here.exposures[0].photo_psnr_db for advice in (first, other)]
    assert levels[0] != levels[1]


@pytest.mark.slow(reason="searches and dozens of restorations")
def test_other_light_is_shifted_towards_what_was_measured(problem, few):
    modelled, measured = (
        cep.advise(problem, levels=[9_000, 100_000], photographs=scenes)
        for scenes in ((), few[:1])
    )
    shifts = [
        after.gains_db["snapshot"] - before.gains_db["snapshot"]
        for before, after in zip(modelled.levels, measured.levels, strict=True)
    ]
    near, here, far = shifts
    assert near == pytest.approx(here, abs=0.2 + 0.1 * abs(here))
    assert abs(far) < abs(near)


def test_corrections_are_of_the_best_exposure_of_each_kind():
    model = [
        Exposure("open", ShutterCode("11"), 20.0, 20.0),
        Exposure("snapshot", CODE, 24.0, 25.0),
    ]
    measured = [
        Exposure("open", ShutterCode("11"), 21.0, 21.0),
        Exposure("snapshot", CODE, 23.0, 24.0),
    ]
    shifts = corrections_db(model, measured)
    assert shifts == {"open": 1.0, "snapshot": -1.0}
    assert corrected(model[1], shifts, 0.5).psnr_db == 23.5
    strobe = Exposure("strobe", CODE, 22.0, 22.0)
    assert corrected(strobe, shifts, 1.0).psnr_db == 22.0  # not measured: the mean of the others


def test_a_range_leaves_out_the_least_and_the_greatest_of_many():
    code, single = (
        Exposure("code", CODE, 0.0, 0.0, photo_psnr_db=levels)
        for levels in ((1.0, 5.0, 3.0, 9.0, 2.0), (0.0,) * 5)
    )
    assert gain_range_db(code, single) == (2.0, 5.0)
    assert gain_range_db(code, Exposure("open", CODE, 0.0, 0.0, photo_psnr_db=(0.0, 0.0))) == (
        1.0,
        5.0,
    )
    assert gain_range_db(code, Exposure("open", CODE, 0.0, 0.0)) is None


def test_a_motion_longer_than_photographs_is_left_to_the_model(few):
    problem = SearchProblem.along(Trajectory.straight(LONGEST_PX + 10), chips=8, camera=NOISY)
    judged = verdict(problem, photographs=few)
    assert judged.photographs == 0
    assert "a model of photographs" in judged.sentence
    assert " about " in judged.sentence


@pytest.mark.slow(reason="searches and dozens of restorations")
def test_optimize_returns_the_code_that_photographs_prefer(problem, few):
    def along(chips):
        return SearchProblem.along(
            Trajectory.straight(12.0), chips=chips, camera=NOISY, objective="mse"
        )

    best = cep.optimize(along(12), steps=2_000, photographs=few[:1])
    assert best.verdict.user_code.code.bits == best.code.bits
    codes = [way for way in best.verdict.exposures if way.kind == "code" and way.possible]
    assert best.verdict.user_code.psnr_db == max(way.psnr_db for way in codes)
    # still no worse by the objective than the codes that it is compared with
    costs = [
        row.metrics.mse_db
        for row in best.comparison
        if row.within_limits and kind_of(row.code) in CODED
    ]
    assert costs[0] <= min(costs[1:]) + 1e-3


def test_optimize_returns_a_code_where_the_objective_prefers_a_single_exposure():
    problem = SearchProblem.along(
        Trajectory.straight(40.0),
        chips=40,
        camera=Camera(photons_full_scale=500, read_noise_e=2),
        objective="mse",
    )
    # on this picture a code gains 1.7 dB
    best = cep.optimize(problem, steps=20_000, photographs=photographs()[9:10])
    single = next(row for row in best.comparison if row.name == "best snapshot")
    assert single.metrics.mse_db < best.comparison[0].metrics.mse_db
    assert best.verdict.choice == kind_of(best.code) == "code"
    assert best.verdict.user_code.code.bits == best.code.bits


@pytest.mark.parametrize(("camera", "advised"), [(NOISY, "code"), (QUIET, "snapshot")])
def test_a_single_exposure_gives_way_only_to_a_code_that_is_advised(problem, few, camera, advised):
    single = ShutterCode("000001100000")
    judged = verdict(replace(problem, camera=camera), single, rivals=[CODE], photographs=few)
    assert judged.choice == advised
    # of a single exposure of the user's own nothing is said
    taken = judged.user_code and judged.user_code.code.bits
    assert taken == {"code": CODE.bits, "snapshot": None}[advised]


def test_a_scene_of_another_name_claims_no_photographs(problem, few):
    text = replace(problem, scene=SCENES["text"])
    modelled = verdict(text, CODE)
    assert modelled.photographs == 0
    assert "a model of text" in modelled.sentence
    assert "photograph" not in modelled.sentence
    own = replace(problem, scene=replace(PHOTO, name="belt.png"))
    measured = verdict(own, CODE, photographs=few)
    assert measured.photographs == 2
    assert "2 parts of belt.png" in measured.sentence
    assert "photograph" not in measured.sentence
    assert measured.to_dict()["scene"] == "belt.png"


@pytest.mark.parametrize("scene", SCENES.values())
def test_search_measure_and_verdict_expect_the_same_of_a_scene(problem, scene):
    designed = replace(problem, objective="mse", scene=scene)
    cost_db = CodeCost.fine(designed).cost_of(CODE.array[None])[0]
    assert designed.measure(CODE).mse_db == pytest.approx(cost_db, abs=0.05)
    expected_db = verdict(designed, CODE, photographs=()).user_code.psnr_db
    assert expected_db == pytest.approx(-cost_db, abs=0.05)
