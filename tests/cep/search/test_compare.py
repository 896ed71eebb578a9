"""The table beside a code: figures of the same motions, and what is outside the limits is
marked."""

import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.search.baselines import compare, find_baselines
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory

BENT = Trajectory.from_samples([[0, 0], [6, 1], [9, 5], [10, 11]])


def test_every_row_is_measured_and_marked():
    problem = SearchProblem.along(
        Trajectory.straight(11.0), chips=13, open_range=(7, 9), objective="noise"
    )
    code = ShutterCode("1111100110101")
    first, *others = compare(
        problem, code, baselines=find_baselines(problem, rng=np.random.default_rng(1))
    )
    assert (first.name, first.code, first.within_limits) == ("this code", code, True)
    for row in (first, *others):
        assert row.metrics.noise_gain_db == pytest.approx(problem.measure(row.code).noise_gain_db)
        assert row.within_limits == (7 <= row.code.open_chips <= 9)
        assert (row.label == row.name) == row.within_limits
    assert {row.name for row in others if not row.within_limits} >= {"open shutter"}


def test_the_chip_time_is_kept():
    problem = SearchProblem.along(BENT, chips=9)
    code = ShutterCode("110100011", 250_000)
    rows = compare(problem, code, baselines=find_baselines(problem, rng=np.random.default_rng(1)))
    assert rows[0].metrics == problem.measure(code)
    assert {row.code.chip_ns for row in rows} == {250_000}
