"""Maps: a soft map draws what its binary one does, and what cannot be traced is refused."""

import numpy as np
import pytest

from lab.evaluation.map_tracing import trace_map
from motdiff.trajectory import Trajectory


def figure_eight():
    t = np.linspace(0.05, 0.95, 600) * 2 * np.pi
    return np.column_stack([10 * np.sin(t), 6 * np.sin(2 * t)])


def test_a_soft_map_is_traced_as_its_binary_one():
    truth = Trajectory.from_samples(figure_eight())
    rng = np.random.default_rng(0)
    soft = 0.8 * truth.hr_map() + 0.15 * rng.random((256, 256))
    np.testing.assert_array_equal(trace_map(soft), trace_map(truth.hr_map()))


@pytest.mark.parametrize(
    "pixels", [[(130, 130)], [(130, 130), (130, 131)], [(0, 0), (0, 1), (1, 1)], [(255, 255)]]
)
def test_the_smallest_maps_give_short_paths(pixels):
    hr = np.zeros((256, 256))
    hr[tuple(np.transpose(pixels))] = 1
    path = trace_map(hr)
    assert path.shape[1] == 2
    assert np.isfinite(path).all()
    assert np.abs(4 * path + 129.5 - np.mean(pixels, axis=0)[::-1]).max() <= 1


@pytest.mark.parametrize(
    ("hr_map", "message"),
    [
        (np.zeros((256, 256)), "hr_map: nothing is drawn"),
        (np.ones((64, 64)), r"hr_map: must be \(256, 256\)"),
        (np.full((256, 256), np.nan), "hr_map: must be a finite"),
        (-np.ones((256, 256)), "hr_map: must be a finite, non-negative"),
    ],
)
def test_bad_maps_are_refused_in_one_line(hr_map, message):
    with pytest.raises(ValueError, match=f"^{message}") as caught:
        trace_map(hr_map)
    assert "\n" not in str(caught.value)
