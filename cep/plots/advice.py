"""Figure of what snapshot, strobe and code gain over the open shutter at each light level."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cep.plots.canvas import COLOURS, LINES, new_figure, plain_ticks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cep.search.advise import Advice

EXPOSURE_NAMES = {
    "snapshot": "best single exposure",
    "strobe": "best even pulses",
    "code": "best code",
}


def advice_figure(advice: Advice) -> Figure:
    """Draw expected gains over the open shutter against the light; shaded where a code pays."""
    figure = new_figure(7.2, 4.6)
    axes = figure.subplots()
    light = [level.camera.photons_full_scale for level in advice.levels]
    axes.axhline(0.0, color="black", linewidth=1.0)
    label = "open shutter"
    full = [level.camera.photons_full_scale for level in advice.levels if level.open_saturates]
    if full:  # levels rise
        label += f"; at {full[0]:,.0f} and more it saturates"
    axes.annotate(
        label,
        (light[-1], 0.0),
        xytext=(0, -3),
        textcoords="offset points",
        fontsize=9,
        ha="right",
        va="top",
    )
    for (kind, name), colour, line in zip(EXPOSURE_NAMES.items(), COLOURS, LINES, strict=False):
        points = [
            (photons, level.gains_db[kind])
            for photons, level in zip(light, advice.levels, strict=True)
            if kind in level.gains_db
        ]
        if points:
            axes.plot(
                *zip(*points, strict=True),
                color=colour,
                linestyle=line,
                marker="o",
                markersize=4,
                label=name,
            )
    for low, high in advice.crossover:  # None: beyond the levels that were tried
        axes.axvspan(low or light[0], high or light[-1], color=COLOURS[2], alpha=0.12, linewidth=0)
    axes.axvline(advice.here.camera.photons_full_scale, color="grey", linewidth=1.0, linestyle=":")
    axes.annotate(
        "your light",
        (advice.here.camera.photons_full_scale, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(4, -12),
        textcoords="offset points",
        fontsize=9,
        color="dimgrey",
    )
    axes.set_xscale("log")
    plain_ticks(axes.xaxis)
    axes.set_xlabel("light: photo-electrons at full scale of the open exposure")
    axes.set_ylabel("expected gain after restoration, dB")
    axes.set_title(
        "shaded: a code pays" if advice.crossover else "a code pays at none of these", fontsize=10
    )
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:  # a shutter may leave no other way than to be open
        axes.legend(fontsize=9)
    return figure
