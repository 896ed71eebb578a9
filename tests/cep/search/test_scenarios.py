"""Motions that may occur: their physics and their weights."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_rows, coded_otf
from cep.optics.response import ShutterResponse
from cep.search.problem import SearchProblem, speed_range
from motdiff.trajectory import Trajectory

CODE = ShutterCode("1011000101")
BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]], t=[0, 0.3, 0.5, 1])
F = np.linspace(0, 0.5, 60)
FX, FY = np.random.default_rng(2).uniform(-0.5, 0.5, (2, 30))


def otf(scenario, fx=F, fy=0.0):
    return coded_otf(scenario.trajectory, CODE, fx, fy)


@given(st.floats(0.3, 1), st.floats(1, 3), st.integers(2, 5))
def test_another_speed_stretches_the_frequencies(low, high, count):
    path = Trajectory.straight(14.0)
    for scenario, factor in zip(
        speed_range(path, low, high, count), np.linspace(low, high, count), strict=True
    ):
        assert scenario.weight == pytest.approx(1 / count)
        assert np.abs(otf(scenario) - coded_otf(path, CODE, factor * F, 0.0)).max() < 1e-12


@pytest.mark.parametrize(
    "response", [None, ShutterResponse(chip_ns=10, rise_ns=4, fall_ns=5, on_bias_ns=2)]
)
def test_the_reversed_path_plays_the_code_in_its_own_order(response):
    for path in SearchProblem.along(BENT, chips=10, direction="unknown").directed_paths():
        rows = chip_rows(path, 10, FX, FY, response=response)
        assert rows.shape == (10, 2, 2, FX.size)
        bits = [0, *CODE.array.astype(int), 0]
        total = sum(
            rows[k, bits[k], 0] for k in range(10) if bits[k + 1]
        )  # from the first: the right one is closed yet
        assert np.abs(total - coded_otf(path, CODE, FX, FY, response=response)).max() < 1e-12
    mirrored = chip_rows(BENT, 10, FX, FY, response=response)[::-1].transpose(0, 2, 1, 3)
    assert (np.abs(rows - mirrored).max() < 1e-12) == (response is None)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: speed_range(BENT, 0.0, 1.0, 2), "factors must be above 0"),
        (lambda: speed_range(BENT, 2.0, 1.0, 2), "in order"),
        (lambda: speed_range(BENT, 1.0, 2.0, 1), "at least 2"),
    ],
)
def test_bad_scenarios_are_named(make, words):
    with pytest.raises(ValueError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)
