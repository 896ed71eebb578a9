"""The table of measured gains: what it holds, and how the nearest cases count."""

import csv
import math
from types import SimpleNamespace

import pytest

from cep.optics.camera import Camera
from cep.search.advise import advise, shifted
from cep.search.measured import GAINS_TABLE, shifts_db
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory


def measured_gains():
    with GAINS_TABLE.open(encoding="utf-8", newline="") as stream:
        return [
            SimpleNamespace(
                **{name: text if name == "motion" else float(text) for name, text in row.items()}
            )
            for row in csv.DictReader(stream)
        ]


def test_every_case_is_a_motion_with_light_and_four_finite_gains():
    cases = measured_gains()
    assert len({(case.motion, case.photons, case.read_noise_e) for case in cases}) == len(cases)
    for case in cases:
        assert all(math.isfinite(x) for name, x in vars(case).items() if name != "motion")


def test_a_case_of_the_table_counts_most_where_it_was_measured():
    case = next(case for case in measured_gains() if case.straight and case.extent_px == 20)
    camera = Camera(photons_full_scale=case.photons, read_noise_e=case.read_noise_e, bits=16)
    shifts = shifts_db(Trajectory.straight(case.extent_px), camera)
    lack = case.code_measured_db - case.code_model_db
    others = [other.code_measured_db - other.code_model_db for other in measured_gains()]
    spread = max(others) - min(others)
    assert shifts["code"] == pytest.approx(lack, abs=0.25 * spread)
    assert shifts["open"] == 0


def test_coarse_code_values_count_as_noise():
    path = Trajectory.straight(20.0)
    noisy = Camera(photons_full_scale=50_000, read_noise_e=100, bits=16)
    step_e = 100 * math.sqrt(12)
    coarse = Camera(
        photons_full_scale=50_000, read_noise_e=1, bits=round(math.log2(50_000 / step_e))
    )
    assert shifts_db(path, coarse)["code"] == pytest.approx(
        shifts_db(path, noisy)["code"], abs=0.2
    )


def test_an_advice_is_shifted_at_every_light_and_stays_about():
    path = Trajectory.straight(20.0)
    problem = SearchProblem.along(path, chips=12, camera=Camera(read_noise_e=20))
    model = advise(problem, levels=[1_000.0], photographs=())
    moved = shifted(model)
    assert moved.here in moved.levels
    assert moved.here.photographs == 0
    assert "about" in moved.sentence
    for before, after in zip(model.levels, moved.levels, strict=True):
        shifts = shifts_db(path, before.camera)
        for old, new in zip(before.exposures, after.exposures, strict=True):
            assert new.psnr_db == pytest.approx(old.psnr_db + shifts[old.kind])
