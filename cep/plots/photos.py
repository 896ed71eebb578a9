"""Figures of photos: their motion, before and after with an enlarged detail; and PSFs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cep.files.foreign_text import plot_text
from cep.plots.canvas import COLOURS, new_figure, show_photo, thumbnail
from motdiff.crops import centre_crop
from motdiff.photo_values import luminance
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TIME_MAP = "cividis"  # of even lightness, for colour-blind readers too
_VISIBLE = 0.01  # of a PSF's peak
_SHOWN_PX = 1200  # longest side of a whole photo: more than a figure's pixels are not seen
_BORDER_PX = 32


def before_after(
    images: Mapping[str, ArrayLike], *, zoom_px: int = 128, detail_of: ArrayLike | None = None
) -> Figure:
    """Draw photos side by side, and below each the same enlarged detail.

    Parameters
    ----------
    images : mapping of title to (H, W) or (H, W, 3) array_like, linear light 0..1, about one size
    zoom_px : int
        Side of the detail.
    detail_of : array_like, optional
        Image whose most structured window is the detail; the last one when omitted.
    """
    from matplotlib.patches import Rectangle

    pictures = {
        title: np.clip(np.asarray(image, dtype=np.float64), 0, 1)
        for title, image in images.items()
    }
    height, width = (min(image.shape[axis] for image in pictures.values()) for axis in (0, 1))
    side = min(zoom_px, height, width)
    chooser = list(pictures.values())[-1]
    if detail_of is not None:
        chooser = np.asarray(detail_of, dtype=np.float64)
    row, column = busiest(centre_crop(chooser, height, width), side)
    width_in = 4.0
    figure = new_figure(width_in * len(pictures), width_in * (height / width + 1.0) + 0.4)
    grid = figure.subplots(2, len(pictures), squeeze=False, height_ratios=(height / width, 1.0))
    for (title, image), top, bottom in zip(pictures.items(), grid[0], grid[1], strict=True):
        cut = centre_crop(image, height, width)
        small = thumbnail(cut, _SHOWN_PX)
        show_photo(top, small)
        top.set_title(plot_text(title))
        scale = small.shape[1] / width
        corner = (column * scale, row * scale)
        frame = Rectangle(
            corner, side * scale, side * scale, fill=False, edgecolor=COLOURS[4], linewidth=1.4
        )
        top.add_patch(frame)
        show_photo(bottom, cut[row : row + side, column : column + side])
    return figure


def busiest(image: FloatArray, side: int) -> tuple[int, int]:
    """Return the corner of the window with most gradient, clear of the restoration's borders."""
    grey = luminance(image)
    energy = sum(np.abs(gradient) for gradient in np.gradient(grey))
    # a window's sum from four entries of the summed-area table (Crow 1984)
    totals = np.pad(np.cumsum(np.cumsum(energy, axis=0), axis=1), ((1, 0), (1, 0)))
    margin = min(_BORDER_PX, (min(grey.shape) - side) // 2)
    step = max(1, side // 4)  # neighbours overlap by three quarters: none falls between two
    rows, columns = (np.arange(margin, n - side - margin + 1, step) for n in grey.shape)
    top, west = rows[:, None], columns
    bottom, east = top + side, west + side
    sums = totals[bottom, east] - totals[top, east] - totals[bottom, west] + totals[top, west]
    row, column = np.unravel_index(sums.argmax(), sums.shape)
    return int(rows[row]), int(columns[column])


def trajectory_figure(photo: ArrayLike, trajectory: Trajectory) -> Figure:
    """Draw the path over its photo, (H, W) or (H, W, 3) in linear light, and enlarged beside it,
    coloured by time.
    """
    small = thumbnail(photo, 1600)
    figure = new_figure(10.0, 4.6)
    photo_axes, path_axes = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    show_photo(photo_axes, small)
    photo_axes.set_title("Photo and its motion (same scale)")
    scale = small.shape[1] / np.asarray(photo).shape[1]
    centre = 0.5 * np.array([small.shape[1] - 1, small.shape[0] - 1])
    on_photo = trajectory.xy * scale + centre
    photo_axes.plot(*on_photo.T, color="white", linewidth=4.0, solid_capstyle="round")
    photo_axes.add_collection(_coloured_by_time(on_photo, trajectory.t, width=2.2))

    names = ("one end", "other end")
    note = "time, fraction of the exposure (or reversed)"
    if trajectory.direction == "known":
        names = ("start", "end")
        note = "time, fraction of the exposure"
    path_axes.plot(*trajectory.xy.T, color="0.85", linewidth=6.0, solid_capstyle="round", zorder=1)
    bar = path_axes.add_collection(_coloured_by_time(trajectory.xy, trajectory.t, width=3.0))
    even = trajectory.at(np.linspace(0, 1, 21))  # dots at even times show the speed
    path_axes.scatter(*even.T, s=14, color="white", edgecolor="black", linewidth=0.7, zorder=3)
    # the second end is drawn smaller, over the first: of a closed path both show
    for name, point, colour, marker, size in zip(
        names, trajectory.xy[[0, -1]], (COLOURS[2], COLOURS[1]), "os", (150, 52), strict=True
    ):
        path_axes.scatter(
            *point,
            s=size,
            marker=marker,
            color=colour,
            edgecolor="white",
            linewidth=1.2,
            zorder=4,
            label=name,
        )
    # above the axes: beside their ends the names would lie over each other, or over the path
    path_axes.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, handletextpad=0.2
    )
    half = 0.62 * max(trajectory.extent_px, 4.0)
    middle = 0.5 * (trajectory.xy.min(axis=0) + trajectory.xy.max(axis=0))
    path_axes.set(
        xlim=(middle[0] - half, middle[0] + half),
        ylim=(middle[1] + half, middle[1] - half),  # y runs down, as in the photo
        xlabel="x, px",
        ylabel="y (down), px",
        aspect="equal",
    )
    path_axes.set_title(
        f"Path: {trajectory.length_px:.1f} px long, {trajectory.extent_px:.1f} px wide", pad=26
    )
    path_axes.grid(color="0.92")
    path_axes.set_axisbelow(True)
    figure.colorbar(bar, ax=path_axes, label=note, shrink=0.85, pad=0.02)
    return figure


def psf_figure(psfs: Mapping[str, ArrayLike]) -> Figure:
    """Draw PSFs (S, S) by their titles, each on its own scale, with its zero displacement."""
    figure = new_figure(3.6 * len(psfs) + 0.2, 3.2)
    reach = max(_reach(psf) for psf in psfs.values()) + 2.5
    for axes, (title, psf) in zip(
        np.ravel(figure.subplots(1, len(psfs))), psfs.items(), strict=True
    ):
        kernel = np.asarray(psf, dtype=np.float64)
        rows, columns = kernel.shape
        start = -(rows // 2) - 0.5
        edges = (start, start + columns, start + rows, start)
        heatmap = axes.imshow(kernel, cmap="magma", extent=edges, interpolation="nearest")
        axes.plot(0, 0, "+", color="white", markersize=7, markeredgewidth=0.8)
        axes.set(
            title=plot_text(title),
            xlabel="x, px",
            ylabel="y (down), px",
            xlim=(-reach, reach),
            ylim=(reach, -reach),
        )
        axes.set_facecolor("black")
        figure.colorbar(heatmap, ax=axes, shrink=0.95, label="share of the light")
    return figure


def _coloured_by_time(points: FloatArray, t: FloatArray, *, width: float) -> Any:
    from matplotlib.collections import LineCollection

    # the path's own corners, and enough between them for the colours to run smoothly
    times = np.union1d(t, np.linspace(0, 1, 201))
    fine = np.stack([np.interp(times, t, points[:, axis]) for axis in (0, 1)], axis=1)
    lines = LineCollection(
        list(np.stack([fine[:-1], fine[1:]], axis=1)),
        cmap=_TIME_MAP,
        linewidths=width,
        capstyle="round",
        zorder=2,
    )
    lines.set_array(0.5 * (times[1:] + times[:-1]))
    lines.set_clim(0, 1)
    return lines


def _reach(psf: ArrayLike) -> int:
    """Largest displacement, px along either axis, that holds a visible share of the light."""
    kernel = np.asarray(psf, dtype=np.float64)
    bright = np.argwhere(kernel > _VISIBLE * kernel.max())
    return int(np.abs(bright - np.array(kernel.shape) // 2).max())
