"""Figures of codes: the strip of chips, and MTFs in one and two dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from cep.files.foreign_text import plot_text
from cep.files.formatting import duration
from cep.optics.code import ShutterCode
from cep.optics.exposure import mtf
from cep.plots.canvas import COLOURS, LINES, least_pt, new_figure, plain_ticks
from cep.proofs.mtf_curves import main_axis, mtf_curve
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FLOOR_DB = -40.0  # of the maps' colours: an MTF of 0.01
_STRIP_IN = 10.0  # width of a strip
_MOST_LINED = 128  # chips: lines between more would hide them
_MAP_IN = 2.9  # width of a map, and how many stand side by side
_MAPS = 3
_DIP = 1e-6  # in place of a zero, which has no logarithm


def code_strips(codes: Mapping[str, ShutterCode]) -> Figure:
    """Draw codes by their names as strips of open (light) and closed (dark) chips."""
    figure = new_figure(_STRIP_IN, 0.55 + 0.75 * len(codes))
    rows = np.atleast_1d(figure.subplots(len(codes), 1))
    for axes, (name, code) in zip(rows, codes.items(), strict=True):
        axes.imshow(
            code.array[None, :],
            cmap="cividis",
            vmin=0,
            vmax=1,
            aspect="auto",
            extent=(0, code.chips, 0, 1),
            interpolation="nearest",
        )
        if code.chips <= _MOST_LINED:
            axes.set_xticks(np.arange(code.chips + 1), minor=True)
            axes.grid(which="minor", axis="x", color="0.5", linewidth=0.4)
            axes.tick_params(which="minor", length=0)
        axes.set(yticks=[], xlim=(0, code.chips))
        axes.set_ylabel(plot_text(name), rotation=0, ha="right", va="center")
        axes.text(
            1.01,
            0.5,
            f"{code.open_chips} of {code.chips} open\n{code.duty:.0%} of the light",
            transform=axes.transAxes,
            va="center",
            fontsize=least_pt(_STRIP_IN),
            color="0.3",
        )
    rows[-1].set_xlabel(
        f"time, chips of {duration(next(iter(codes.values())).chip_ns * 1e-9, digits=4)}; yellow ="
        " open"
    )
    return figure


def mtf_figure(
    trajectory: Trajectory, codes: Mapping[str, ShutterCode | None], *, grid: int = 101
) -> Figure:
    """Draw MTFs: a curve per code along the motion's main axis, and a map of the band for each.

    Parameters
    ----------
    codes : mapping of name to ShutterCode, or to None for the shutter open all the time
    grid : int
        Frequencies per side of a map.
    """
    columns = min(max(2, len(codes)), _MAPS)
    rows = -(-len(codes) // columns)
    figure = new_figure(max(7.5, _MAP_IN * columns), 3.75 + 3.25 * rows)
    layout = figure.add_gridspec(1 + rows, columns, height_ratios=(1.15, *(1.0,) * rows))
    curves = figure.add_subplot(layout[0, :])
    axis = main_axis(trajectory)
    for index, (name, code) in enumerate(codes.items()):
        freq_cy_px, curve = mtf_curve(trajectory, code)
        style = {"color": COLOURS[index % len(COLOURS)], "linestyle": LINES[index % len(LINES)]}
        curves.semilogy(
            freq_cy_px, np.maximum(curve, _DIP), linewidth=1.9, label=plot_text(name), **style
        )
    angle_deg = float(np.degrees(np.arctan2(axis[1], axis[0]))) % 180
    curves.set(
        xlim=(0, 0.5),
        ylim=(1e-3, 1.2),
        xlabel=(
            f"frequency along the motion's main axis ({angle_deg:.0f} deg from x towards y),"
            " cycles/px"
        ),
        ylabel="MTF, light-true",
        title="MTF along the main axis: a dip is detail that no restoration brings back",
    )
    plain_ticks(curves.yaxis)
    curves.grid(color="0.9", which="both", linewidth=0.6)
    # the lower limit cuts deep dips
    curves.legend(loc="upper right", ncols=min(3, len(codes)), framealpha=0.9)

    maps = []
    for index, (name, code) in enumerate(codes.items()):
        axes = figure.add_subplot(layout[1 + index // columns, index % columns])
        level_db = 20 * np.log10(np.maximum(_mtf_map(trajectory, code, grid), _DIP))
        heatmap = axes.imshow(
            level_db,
            cmap="cividis",
            vmin=_FLOOR_DB,
            vmax=0,
            extent=(-0.5, 0.5, 0.5, -0.5),
            interpolation="nearest",
        )
        axes.set(
            title=plot_text(name),
            xlabel="x, cycles/px",
            xticks=(-0.5, 0, 0.5),
            yticks=(-0.5, 0, 0.5),
        )
        axes.tick_params(labelleft=index % columns == 0)
        if index % columns == 0:
            axes.set_ylabel("y, cycles/px")
        maps.append(axes)
    figure.colorbar(heatmap, ax=maps, label="MTF, dB", shrink=0.9, pad=0.02, extend="min")
    return figure


def _mtf_map(trajectory: Trajectory, code: ShutterCode | None, grid: int) -> FloatArray:
    """MTF (grid, grid) over the band; |H(-f)| = |H(f)|, so half of it is computed."""
    line = np.linspace(-0.5, 0.5, grid)
    fx, fy = np.meshgrid(line, line[: (grid + 1) // 2])
    half = mtf(trajectory, code, fx, fy)
    return np.concatenate([half, half[: grid // 2][::-1, ::-1]])
