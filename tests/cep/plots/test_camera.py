"""Figures of a camera's exposure: its edges are shown at their place, with the flashes around."""

import numpy as np
import pytest

from cep.plots.camera import exposure_window_figure

START_S = 200e-6
LENGTH_S = 3e-3
FLASH_S = 50e-6


@pytest.fixture(scope="module")
def panels():
    starts_s = np.array([150e-6, 190e-6, 1.5e-3, 3.17e-3, 3.3e-3])
    figure = exposure_window_figure(
        np.stack([starts_s, starts_s + FLASH_S], axis=1),
        np.array([0.0, 0.8, 1.0, 0.6, 0.0]),
        start_s=(START_S, START_S - 1e-6, START_S + 1e-6),
        length_s=(LENGTH_S, LENGTH_S - 1e-6, LENGTH_S + 1e-6),
    )
    return figure.axes


def test_the_whole_exposure_is_shown_in_ms(panels):
    window = panels[0]
    lower, upper = window.get_xlim()
    assert lower < 0.175 - 0.025  # the first flash begins before the exposure
    assert 3.2 < upper < 4
    assert window.get_xlabel().endswith("ms")
    (span,) = window.patches
    assert span.get_extents().transformed(window.transData.inverted()).intervalx == pytest.approx(
        [0.2, 3.2]
    )


@pytest.mark.parametrize(("index", "edge_us"), [(1, 200), (2, 3200)])
def test_an_edge_is_in_the_middle_of_two_flashes_to_either_side(panels, index, edge_us):
    axes = panels[index]
    assert axes.get_xlim() == pytest.approx([edge_us - 100, edge_us + 100])
    assert axes.get_xlabel().endswith("µs")
    (points, edge), (bars,) = axes.lines, axes.collections
    assert edge.get_xdata() == pytest.approx([edge_us] * 2)
    assert points.get_xdata() == pytest.approx([175, 215, 1525, 3195, 3325])
    assert points.get_ydata().tolist() == [0.0, 0.8, 1.0, 0.6, 0.0]
    # a bar from the flash's beginning to its end
    spans = [segment[:, 0] for segment in bars.get_segments()]
    assert spans[1] == pytest.approx([190, 240])
