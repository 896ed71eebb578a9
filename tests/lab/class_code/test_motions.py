"""Motions of a class are of the length that was asked for."""

import numpy as np
import pytest

from lab.class_code.motions import draw_motions
from motdiff.gyro import GyroTrace


def test_drawn_motions_are_of_the_length_asked_for():
    rng = np.random.default_rng(0)
    for path in draw_motions(3, length_px=25.0, rng=rng):
        assert path.length_px == pytest.approx(25, abs=0.3)  # thinned
    t = np.linspace(0, 2, 400)
    trace = GyroTrace(t, np.column_stack([np.sin(9 * t), np.cos(7 * t), 0 * t]))
    for path in draw_motions(3, length_px=25.0, rng=rng, gyro=trace, exposure_s=0.1):
        assert path.extent_px == pytest.approx(25, abs=0.1)
        assert path.direction == "known"
