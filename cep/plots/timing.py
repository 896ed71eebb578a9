"""Figure of a camera's exposure under flashes at known times."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cep.plots.canvas import COLOURS, new_figure
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_AROUND = 2.0  # flashes to either side of an edge


def exposure_window_figure(
    pulses_s: FloatArray,
    share: FloatArray,
    *,
    start_s: tuple[float, float, float],
    length_s: tuple[float, float, float],
) -> Figure:
    """Draw the window of row 0's exposure: whole, and at its start and its end.

    Parameters
    ----------
    pulses_s : (N, 2) float ndarray
        Flashes, one a frame.
    share : (N,) float ndarray
        Of each flash that the row collected.
    start_s, length_s : tuple of three floats
        Estimate and the ends of its interval.
    """
    figure = new_figure(7.2, 3.4)
    window, at_start, at_end = figure.subplots(1, 3, sharey=True)
    centre_us = 1e6 * pulses_s.mean(axis=1)
    half_us = 0.5e6 * np.diff(pulses_s, axis=1)[:, 0]
    start_us, end_us = 1e6 * start_s[0], 1e6 * (start_s[0] + length_s[0])
    flash_us = 2 * float(np.median(half_us))
    begin_us, finish_us = min(start_us, centre_us.min()), end_us + 0.1 * (end_us - start_us)
    views = (
        (window, "exposure", begin_us - 0.1 * (end_us - start_us), finish_us, 1e-3, "ms"),
        (at_start, "start", start_us - _AROUND * flash_us, start_us + _AROUND * flash_us, 1, "µs"),
        (at_end, "end", end_us - _AROUND * flash_us, end_us + _AROUND * flash_us, 1, "µs"),
    )
    for axes, title, lower, upper, unit, name in views:
        axes.axvspan(unit * start_us, unit * end_us, color=COLOURS[5], alpha=0.3, linewidth=0)
        axes.errorbar(
            unit * centre_us,
            share,
            xerr=unit * half_us,
            linestyle="",
            marker="o",
            markersize=3,
            color=COLOURS[0],
        )
        axes.set_xlim(unit * lower, unit * upper)
        axes.set_xlabel(f"time after the trigger, {name}")
        axes.set_title(title)
    at_start.axvline(start_us, color="black", linewidth=1)
    at_end.axvline(end_us, color="black", linewidth=1)
    window.set_ylabel("share of a flash collected")
    return figure
