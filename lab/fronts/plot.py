"""Figure of a Pareto front in minimum, noise and light, with the published codes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cep.files.foreign_text import plot_text
from cep.plots.canvas import COLOURS, least_pt, new_figure
from cep.proofs.measure import HOPELESS_DB
from lab.fronts.front import Front, FrontPoint, knees
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOUR_MAP = "viridis"
_WIDTH_IN = 9.5
_WIDEST_DB = 14.0  # beyond the least noise: farther codes are named in a corner
_REACH_PT = (9.0, 16.0, 26.0, 40.0, 58.0, 80.0, 110.0, 150.0)  # between a point and its label
_AROUND = 24  # directions tried for a label
_GAP_PX = 3.0
_NEAR_PX = 6.0  # from a point to a label's line
_UNITS = {
    "chips": "smallest |P| over the unit circle, chips",
    "light-true": "smallest |H| over the band, light-true",
    "light-true, sampled": "smallest |H| over the samples, light-true",
}


def pareto_figure(
    front: Front, published: Mapping[str, FrontPoint] | None = None, *, title: str = ""
) -> Figure:
    """Draw minimum against noise gain, coloured by light; along curved paths light against noise
    gain.

    Thin lines join the best codes of equal light, large dots are the front, crosses the published
    codes.

    Parameters
    ----------
    front : Front
        With at least one point.
    published : mapping of name to FrontPoint, optional
        Codes to compare with, measured by :func:`lab.fronts.search.front_points`.
    title : str

    Raises
    ------
    ValueError
        If the front has no points.
    """
    if not front.points:
        raise ValueError("front: has no points to draw")
    figure = new_figure(_WIDTH_IN, 6.4)
    axes = figure.subplots()
    counts = {p.open_chips for p in front.points}
    beaten = [
        point
        for count, curve in front.curves.items()
        for point in curve
        if point not in front.points and (front.sampled or count in counts)
    ]
    limit_db = min(p.noise_db for p in front.points) + _WIDEST_DB
    in_view = [p for p in front.points if p.noise_db <= limit_db]
    scales = _Scales(front)
    _lines(axes, front, scales)
    beaten = [p for p in beaten if p.noise_db <= limit_db]
    small: dict[str, Any] = {
        "s": 12,
        "linewidth": 0,
        "zorder": 2,
        "label": "beaten by a brighter code",
    }
    large: dict[str, Any] = {
        "s": 46,
        "edgecolor": "black",
        "linewidth": 0.8,
        "zorder": 4,
        "label": "beaten by none found",
    }
    for points, style in ((beaten, small), (in_view, large)):
        if points:
            x, y = scales.place(points)
            bar = axes.scatter(x, y, c=[scales.colour(p) for p in points], **scales.style, **style)
    references = published or {}
    visible = {name: p for name, p in references.items() if p.noise_db <= limit_db}
    if visible:
        x, y = scales.place(list(visible.values()))
        axes.scatter(
            x, y, marker="x", s=60, color=COLOURS[1], linewidth=1.8, zorder=5, label="published"
        )
    axes.set(
        xlabel="noise gain, dB, light-true (left is better)",
        ylabel=f"{scales.height_label} (up is better)",
    )
    axes.grid(color="0.92", linewidth=0.6)
    axes.margins(0.09, 0.09)
    figure.colorbar(bar, ax=axes, label=scales.colour_label, pad=0.02)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=least_pt(_WIDTH_IN))
    hidden = [f"{name} ({_db(p)})" for name, p in references.items() if name not in visible]
    if len(in_view) < len(front.points):
        hidden.append(f"{len(front.points) - len(in_view)} codes of the front")
    heading = f"{scales.title} that codes of {front.problem.chips} chips have together"
    pad_pt = None
    if hidden:
        pad_pt = 18  # the line of the hidden ones stands below the title
        text = f"noisier than shown: {', '.join(hidden)}"
        axes.text(
            1.0,
            1.005,
            text,
            transform=axes.transAxes,
            ha="right",
            va="bottom",
            fontsize=least_pt(_WIDTH_IN),
            color="0.35",
        )
    axes.set_title(plot_text(title) or heading, pad=pad_pt)
    labelled = [
        (_names(point, front), point, "0.1")
        for point in dict.fromkeys(knees(front).values())
        if point in in_view
    ]
    _label(
        figure,
        axes,
        front,
        scales,
        [*labelled, *((name, point, COLOURS[1]) for name, point in visible.items())],
        beaten,
    )
    return figure


def _minimum(point: FrontPoint) -> float:
    return point.minimum


def _light(point: FrontPoint) -> float:
    return float(point.open_chips)


class _Scales:
    """Which figure is the height, and which the colour.

    Along curved paths the minimum is sampled alone: it is then the colour, which promises less.
    """

    def __init__(self, front: Front) -> None:
        minimum = (_minimum, _UNITS[front.unit])
        light = (_light, f"light, open chips of {front.problem.chips}")
        self.height, self.height_label = minimum
        self.colour, self.colour_label = light
        self.title = "Minimum, noise and light"
        if front.sampled:
            self.height, self.height_label = light
            self.colour, self.colour_label = minimum
            self.title = "Noise and light"
        values = [self.colour(point) for point in front.points]
        low = min(values)
        high = max(values)
        if high <= low:  # a single colour, and matplotlib asks for a range
            high = low + 1
        self.style: dict[str, Any] = {"cmap": _COLOUR_MAP, "vmin": low, "vmax": high}

    def place(self, points: Sequence[FrontPoint]) -> tuple[list[float], list[float]]:
        """Return noise gains and heights."""
        return [p.noise_db for p in points], [self.height(p) for p in points]


def _lines(axes: Axes, front: Front, scales: _Scales) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import Normalize

    thin: dict[str, Any] = {"linewidth": 0.8, "zorder": 1}
    if front.sampled:
        axes.plot(*scales.place(front.points), color="0.6", **thin)
        return
    scale = Normalize(scales.style["vmin"], scales.style["vmax"], clip=True)
    counts = {p.open_chips for p in front.points}
    lines = list[Any]()
    for count, curve in front.curves.items():
        if count in counts and len(curve) > 1:
            colour = colormaps[_COLOUR_MAP](scale(count))
            lines += axes.plot(*scales.place(curve), color=colour, **thin)
    if lines:
        lines[0].set_label("of equal light")  # one entry of the legend for all of them


def _names(point: FrontPoint, front: Front) -> str:
    names = [name for name, knee in knees(front).items() if knee == point]
    return f"{', '.join(names)}: {point.open_chips} open"


def _db(point: FrontPoint) -> str:
    if point.noise_db > HOPELESS_DB:
        return "has a zero"
    return f"{point.noise_db:.0f} dB"


def _label(
    figure: Figure,
    axes: Axes,
    front: Front,
    scales: _Scales,
    labels: Sequence[tuple[str, FrontPoint, str]],
    dots: Sequence[FrontPoint],
) -> None:
    """Write labels beside their points, each where it covers no point, no other label and as few
    lines as can be.
    """
    figure.draw_without_rendering()
    frame = axes.get_window_extent()
    all_points = [*front.points, *dots, *(point for _, point, _ in labels)]
    occupied = axes.transData.transform(np.column_stack(scales.place(all_points)))
    lines = [axes.transData.transform(line.get_xydata()) for line in axes.lines]
    steps = np.linspace(0, 1, 24)[:, None]
    along = [
        polyline[:-1, None] + (polyline[1:] - polyline[:-1])[:, None] * steps
        for polyline in lines
        if len(polyline) > 1
    ]
    crossed = np.concatenate([np.empty((0, 2)), *(points.reshape(-1, 2) for points in along)])
    boxes: list[FloatArray] = []
    for text, point, colour in labels:
        (x,), (y,) = scales.place([point])
        note = axes.annotate(
            text,
            (x, y),
            (0, 0),
            textcoords="offset points",
            fontsize=least_pt(_WIDTH_IN),
            color=colour,
            zorder=6,
            ha="center",
            va="center",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.6},
        )
        size = note.get_window_extent()
        half = np.array([size.width, size.height]) / 2 + _GAP_PX
        at = axes.transData.transform((x, y))
        best = np.zeros(2)
        fewest = np.inf
        for shift in _shifts(half, figure.dpi):
            box = np.array([at + shift - half, at + shift + half])
            outside = (box[0] < frame.min).any() or (box[1] > frame.max).any()
            hits = 1000 * outside + 3 * _within(box, occupied) + 0.2 * _within(box, crossed)
            leader = at + shift * np.linspace(0, 1, 12)[:, None]
            candidates = (
                np.hypot(*(leader[:, None] - occupied[None]).transpose(2, 0, 1)).min(axis=0)
                < _NEAR_PX
            )
            hits += 2 * int((candidates & (np.hypot(*(occupied - at).T) > _NEAR_PX)).sum())
            hits += 100 * sum(
                bool(((box[0] <= rival_box[1]) & (rival_box[0] <= box[1])).all())
                for rival_box in boxes
            )
            if hits < fewest:
                best = shift
                fewest = hits
        boxes.append(np.array([at + best - half, at + best + half]))
        note.set_position(tuple(best * 72 / figure.dpi))


def _within(box: FloatArray, points: FloatArray) -> int:
    return int(((box[0] <= points) & (points <= box[1])).all(axis=1).sum())


def _shifts(half: FloatArray, dpi: float) -> list[FloatArray]:
    """Return places of a label's middle relative to its point, px, nearest first."""
    angles = 2 * np.pi * np.arange(_AROUND) / _AROUND
    return [
        np.array([np.cos(angle), np.sin(angle)]) * (half + reach * dpi / 72 - _GAP_PX)
        for reach in _REACH_PT
        for angle in angles
    ]
