"""Figures of a measured camera: its photon-transfer curve, and its exposure under flashes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cep.plots.canvas import COLOURS, new_figure, plain_ticks
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cep.optics.photon_transfer import PhotonTransfer

# by the use of a flat pair: what the fit leaves out looks different
_MARKS: dict[str, dict[str, Any]] = {
    "fitted": {"marker": "o", "color": COLOURS[0]},
    "above the fit": {"marker": "o", "color": COLOURS[0], "markerfacecolor": "white"},
    "saturated": {"marker": "x", "color": COLOURS[1]},
}
_AROUND = 2.0  # flashes to either side of an edge of the exposure


def photon_transfer_figure(transfer: PhotonTransfer) -> Figure:
    """Draw variance against mean, both logarithmic, with the fit, its two terms and saturation.

    The photon-transfer method of Janesick (2007): variance = mean / gain + read noise, in code
    values.
    """
    figure = new_figure(7.2, 5.4)
    axes = figure.subplots()
    for use, style in _MARKS.items():
        points = [
            point for point in transfer.points if point.use == use and point.variance_dn2 > 0
        ]
        if points:
            axes.plot(
                [point.signal_dn for point in points],
                [point.variance_dn2 for point in points],
                linestyle="",
                zorder=3,
                label=f"flat pairs, {use}",
                **style,
            )
    slope = 1 / transfer.gain_e_per_dn
    floor = (transfer.read_noise_e / transfer.gain_e_per_dn) ** 2
    brightest = transfer.points[-1].signal_dn
    # from below the point where photon and read noise are equal, or 0.1 where there is none
    darkest = min(transfer.points[0].signal_dn, max(floor / slope, 0.1))
    signal = np.geomspace(darkest / 4, 1.4 * brightest, 200)
    fit = f"fit: {transfer.gain_e_per_dn:.3g} e⁻/DN"
    axes.plot(signal, slope * signal + floor, color="black", linewidth=1.2, label=fit)
    axes.plot(
        signal, slope * signal, color="0.5", linewidth=1, linestyle="--", label="photon noise"
    )
    axes.axhline(
        floor,
        color="0.5",
        linewidth=1,
        linestyle=":",
        label=f"read noise: {transfer.read_noise_e:.3g} e⁻",
    )
    if transfer.dark_variance_dn2 is not None and transfer.dark_variance_dn2 > 0:
        axes.plot(
            [0.0],
            [transfer.dark_variance_dn2],
            transform=axes.get_yaxis_transform(),  # at the border: 0 has no place on a log axis
            marker=">",
            clip_on=False,
            linestyle="",
            color=COLOURS[2],
            zorder=4,
            label="dark pair",
        )
    if transfer.full_well_e is not None:
        what = "pixel full" if transfer.full_well_is == "pixel" else "code range ends"
        axes.axvline(
            transfer.full_well_e * slope,
            color=COLOURS[1],
            linewidth=1,
            linestyle="-.",
            label=f"{what}: {transfer.full_well_e:.0f} e⁻",
        )
    # on log axes the two terms part: read noise is level, photon noise rises (Janesick)
    variances = [point.variance_dn2 for point in transfer.points if point.use != "saturated"]
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(signal[0], signal[-1]),
        ylim=(min(floor, *variances) / 3, 3 * max(*variances, slope * brightest)),
        xlabel="mean above black, code values",
        ylabel="variance over time, code values²",
        title="Photon-transfer curve",
    )
    for axis in (axes.xaxis, axes.yaxis):
        plain_ticks(axis)
    axes.grid(color="0.92", linewidth=0.6)
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


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
