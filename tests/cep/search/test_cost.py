"""Costs of codes: sampled as the problem says, and shared only between problems of one basis."""

from dataclasses import replace

import numpy as np
import pytest

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.response import ShutterResponse
from cep.optics.scene import SCENES
from cep.search.cost import CodeCost
from cep.search.limits import RunLimits
from cep.search.problem import Scenario, SearchProblem
from motdiff.trajectory import Trajectory

CODES = np.array([ShutterCode(bits).array for bits in ("11010010", "10110001", "00111000")])
SLOW = ShutterResponse(chip_ns=1_000_000, rise_ns=9_000, fall_ns=9_000)
PROBLEM = SearchProblem.along(Trajectory.straight(9.0), chips=8, objective="mse")


@pytest.mark.parametrize(
    "change",
    [
        {"objective": "noise"},
        {"camera": Camera(photons_full_scale=300, read_noise_e=40)},
        {"runs": RunLimits(min_open=2)},
        {"open_range": (2, 5)},
        {"scenarios": (Scenario(Trajectory.straight(9.0)),)},
    ],
)
def test_a_cost_on_shared_samples_is_that_of_its_own(change):
    changed = replace(PROBLEM, **change)
    shared = CodeCost.fine(PROBLEM).for_problem(changed).cost_of(CODES)
    assert shared == pytest.approx(CodeCost.fine(changed).cost_of(CODES))
    assert CodeCost.fine(PROBLEM).instead("noise").problem.objective == "noise"


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"scene": SCENES["text"]}, "scene"),
        ({"scenarios": (Scenario(Trajectory.straight(12.0)),)}, "scenarios"),
        ({"frames": 2}, "frames"),
        ({"direction": "unknown"}, "direction"),
        ({"chips": 9}, "chips"),
        ({"response": SLOW}, "response"),
    ],
)
def test_samples_of_another_problem_are_refused(changed, named):
    with pytest.raises(ValueError, match=f"^{named}: "):
        CodeCost.fine(PROBLEM).for_problem(replace(PROBLEM, **changed))
