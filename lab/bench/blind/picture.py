"""Figure of blind estimates: photo, blurred photo, and each method's restoration with its kernel
in the corner.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cep.files.foreign_text import plot_text
from cep.plots.canvas import PRINTED_IN, in_lines, least_pt, new_figure, show_photo
from lab.bench.blind.cases import RealPhoto, make_case, real_pair
from lab.bench.blind.cells import measure_levin, measure_simulated
from lab.bench.inset import show_inset
from lab.bench.psf_text import psf_from_text
from lab.evaluation.measure import restored
from lab.evaluation.metrics import laid_on
from lab.evaluation.sets import levin_photo
from lab.jobs.cells import Cell, Result
from motdiff.photo_values import luminance, to_linear
from motdiff.psf_frame import in_frame
from motdiff.threads import one_thread
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_TILE_IN = (0.9, 1.7)  # between these all columns are as wide as a page
_INSET = 0.34


@dataclass(frozen=True)
class Shown:
    """One row of the figure.

    Attributes
    ----------
    sharp : (H, W) or (H, W, 3) float, or None
    blurred : (H, W) or (H, W, 3) float
    truth : (S, S) float or None
        The true kernel.
    kernels : mapping from method to (S, S) float
    scores : mapping from method to the caption below its picture
    gamma : {"linear", "srgb"}
        "linear" where code values were used as light: they are shown unchanged.
    """

    sharp: FloatArray | None
    blurred: FloatArray
    truth: FloatArray | None
    kernels: Mapping[str, FloatArray]
    scores: Mapping[str, str]
    gamma: str


def shown(results: Sequence[Result], *, methods: Sequence[str], most: int = 4) -> list[Shown]:
    """Select the rows of a figure: one motion of each of the first photos, which are simulated
    again.

    Parameters
    ----------
    results : sequence of Result
        Of a blind table.
    methods : sequence of str
        The columns.
    most : int
        Rows at most.
    """
    by_photo: dict[str, dict[tuple[str, str], dict[str, Result]]] = {}
    for result in results:
        method, photo, shake, light = result.cell.name
        if method in methods and not result.finished.failure:
            by_photo.setdefault(photo, {}).setdefault((shake, light), {})[method] = result
    lines = []
    for index, groups in enumerate(list(by_photo.values())[:most]):
        group = list(groups.values())[index % len(groups)]  # not the same motion in every line
        cell = next(iter(group.values())).cell
        sharp, blurred, truth = _photos(cell)
        lines.append(
            Shown(
                sharp,
                blurred,
                truth,
                {
                    method: psf_from_text(str(result.finished.figures["psf"]))
                    for method, result in group.items()
                },
                {method: _score(result) for method, result in group.items()},
                _gamma(cell),
            )
        )
    return lines


def blind_figure(lines: Sequence[Shown], methods: Sequence[str]) -> Figure:
    """Draw the figure in the MoTDiff paper's layout; photos are restored in grey, kernels lie
    where the true one does.

    Parameters
    ----------
    lines : sequence of Shown, at least one
    methods : sequence of str
        The columns after photo and blurred photo; one without a kernel stays empty.
    """
    columns = ("photo", "blurred", *methods)
    tile_in = float(np.clip(PRINTED_IN / len(columns), *_TILE_IN))
    width_in = tile_in * len(columns)
    figure = new_figure(width_in, (tile_in + 0.3) * len(lines) + 0.25)
    size_pt = least_pt(width_in)
    grid = figure.subplots(len(lines), len(columns), squeeze=False)
    for axes, name in zip(grid[0], columns, strict=True):
        axes.set_title(in_lines(plot_text(name), tile_in, size_pt), fontsize=size_pt)
    for row, line in zip(grid, lines, strict=True):
        for axes in row:
            axes.set_axis_off()
        if line.sharp is not None:
            show_photo(row[0], _light(line.sharp, line.gamma))
            row[0].set_axis_on()
        if line.truth is not None:
            _inset(row[0], line.truth)
        show_photo(row[1], _light(line.blurred, line.gamma))
        row[1].set_axis_on()
        for axes, method in zip(row[2:], methods, strict=True):
            if method in line.kernels:
                psf = line.kernels[method]
                if line.truth is not None:
                    psf = laid_on(line.truth, psf)
                with one_thread():
                    show_photo(axes, _light(restored(luminance(line.blurred), psf), line.gamma))
                axes.set_axis_on()
                axes.set_xlabel(in_lines(line.scores[method], tile_in, size_pt), fontsize=size_pt)
                _inset(axes, psf)
    return figure


def _photos(cell: Cell) -> tuple[FloatArray | None, FloatArray, FloatArray | None]:
    arguments = cell.arguments
    if cell.work in (measure_simulated, measure_levin):
        levins = cell.work is measure_levin
        case = (
            levin_photo(arguments["photo"])
            if levins
            else make_case(arguments["photo"], arguments["motion"], arguments["shot"])
        )
        return case.sharp, case.photo, case.psf
    photo = RealPhoto("", "", arguments["blurred"], arguments["sharp"])
    blurred, sharp = real_pair(
        photo,
        crop_px=arguments["crop_px"],
        gamma=arguments["gamma"],
        crop_seed=arguments["crop_seed"],
    )
    return sharp, blurred, None


def _gamma(cell: Cell) -> str:
    """Return the gamma of a result's photo; Levin's photos are linear."""
    if cell.work is measure_simulated:
        return str(cell.arguments["shot"].gamma)
    return str(cell.arguments.get("gamma", "srgb"))


def _light(image: FloatArray, gamma: str) -> FloatArray:
    return to_linear(np.clip(image, 0, 1)) if gamma == "linear" else image


def _score(result: Result) -> str:
    figures = result.finished.figures
    mnc = figures.get("mnc_subpixel")
    psnr_db = figures.get("psnr_db")
    texts = [] if mnc is None else [f"MNC {mnc:.2f}"]
    return ", ".join(texts if psnr_db is None else [*texts, f"{psnr_db:.1f} dB"])


def _inset(axes: Axes, psf: FloatArray) -> None:
    """Draw the middle of a kernel, by the square root that shows faint parts, in the upper left
    corner.
    """
    show_inset(axes, in_frame(psf), share=_INSET, cmap="gray")
