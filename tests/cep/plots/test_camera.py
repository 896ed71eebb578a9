"""Figures of a camera's exposure: its edges are shown at their place, with the flashes around."""

import numpy as np
import pytest

from cep.optics.photon_transfer import CodeRange, PhotonTransfer, TransferPoint
from cep.plots.camera import exposure_window_figure, photon_transfer_figure

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


def test_the_fitted_line_is_shot_noise_over_the_read_noise():
    points = [
        TransferPoint(signal_dn, signal_dn / 2.5 + 16.0, "fitted") for signal_dn in (100.0, 2000.0)
    ]
    transfer = PhotonTransfer(
        2.5, 0.1, 10.0, 0.1, None, "", 64.0, CodeRange(12), "linear", tuple(points)
    )
    (axes,) = photon_transfer_figure(transfer).axes
    (fit,) = (line for line in axes.lines if str(line.get_label()).startswith("fit"))
    signal_dn, variance_dn2 = fit.get_data()
    # 10 electrons of read noise are 4 code values
    np.testing.assert_allclose(variance_dn2, signal_dn / 2.5 + 16.0)
    # half of the variance is read noise at 40 code values: the line begins a little below
    assert 4 < signal_dn.min() < 40
    assert signal_dn.max() > 2000
