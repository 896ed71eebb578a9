"""Estimates of a motion: what they must hold."""

from dataclasses import replace

import numpy as np
import pytest

from motdiff.estimators.base import MotionEstimate
from motdiff.trajectory import Trajectory

PATHS = (Trajectory.straight(9.0), Trajectory.straight(9.0, angle_rad=1.0))
ESTIMATE = MotionEstimate("mine", PATHS, (0.7, 0.3), np.ones((1, 1)), confidence=0.5)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"trajectories": (), "weights": ()}, "trajectories"),
        ({"weights": (1.0,)}, "trajectories"),
        ({"weights": (0.7, 0.2)}, "weights"),
        ({"weights": (1.5, -0.5)}, "weights"),
        ({"confidence": 1.1}, "confidence"),
        ({"confidence": float("nan")}, "confidence"),
    ],
)
def test_what_is_no_estimate_is_refused(change, named):
    with pytest.raises(ValueError, match=f"^{named}: "):
        replace(ESTIMATE, **change)


@pytest.mark.parametrize(
    ("stated", "error_px"), [(0.3, 0.3), (0.0, None), (-1.0, None), ("0.3", None), (None, None)]
)
def test_the_error_of_the_path_is_a_length_or_unknown(stated, error_px):
    assert replace(ESTIMATE, details={"path_uncertainty_px": stated}).path_error_px == error_px
