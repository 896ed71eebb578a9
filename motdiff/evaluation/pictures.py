"""Pictures of an evaluation: photos with their estimated kernels, and reliability of the confidence."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from motdiff.evaluation.sets import Case
from motdiff.evaluation.tables import GOOD_MNC, Bin
from motdiff.metrics import laid_on, mnc_subpixel
from motdiff.psf_frame import in_frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["contact_sheet", "drawn_sheet", "reliability_plot"]

FloatArray = NDArray[np.float64]

_TILE_IN = 1.3


def reliability_plot(bins: Sequence[Bin]) -> bytes:
    """Plot the share of good estimates over their confidence, one line per method, as PNG.

    Bars are standard errors; on the diagonal the confidence is calibrated.
    """
    figure = _figure(5.0, 5.0)
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], "--", color="0.6")
    for method in dict.fromkeys(b.method for b in bins):
        own = [b for b in bins if b.method == method]
        # with one more hit and miss each, so that 3 of 3 has a bar too
        errors = [np.sqrt((s := (b.good * b.n + 1) / (b.n + 2)) * (1 - s) / (b.n + 2)) for b in own]
        axes.errorbar([b.said for b in own], [b.good for b in own], errors, marker="o", capsize=3, label=method)
        for b in own:
            axes.annotate(str(b.n), (b.said, b.good), xytext=(5, -12), textcoords="offset points", fontsize=7)
    axes.set(xlim=(0, 1), ylim=(-0.05, 1.05), xlabel="confidence said", ylabel=f"share with MNC >= {GOOD_MNC:g}")
    if bins:
        axes.legend()
    return _png(figure)


def contact_sheet(cases: Sequence[Case], kernels: Mapping[str, Mapping[str, FloatArray]]) -> bytes:
    """Lay out photos, true kernels and every method's kernels as PNG, one case per line.

    Kernels are shifted onto the true one and shown by the square root, so that faint parts are seen; the number is
    the sub-pixel MNC.

    Parameters
    ----------
    cases : sequence of Case, at least one
    kernels : mapping from method to a mapping from case name to PSF
        A method without a kernel for a case leaves an empty tile.
    """
    columns = ["photo", "truth", *kernels]
    figure = _figure(_TILE_IN * len(columns), _TILE_IN * len(cases) + 0.3)
    grid = figure.subplots(len(cases), len(columns), squeeze=False)
    for line, case in zip(grid, cases, strict=True):
        for axes in line:
            axes.set_xticks([])
            axes.set_yticks([])
        line[0].imshow(np.clip(case.photo, 0, 1), cmap="gray", vmin=0, vmax=1)
        line[0].set_ylabel(case.name, fontsize=7)
        line[1].imshow(np.sqrt(in_frame(case.psf)), cmap="magma")
        for axes, method in zip(line[2:], kernels, strict=True):
            psf = kernels[method].get(case.name)
            if psf is None:
                axes.set_axis_off()
                continue
            axes.imshow(np.sqrt(np.maximum(in_frame(laid_on(case.psf, psf)), 0)), cmap="magma")
            axes.set_xlabel(f"{mnc_subpixel(psf, case.psf):.2f}", fontsize=7, labelpad=1)
    for axes, name in zip(grid[0], columns, strict=True):
        axes.set_title(name, fontsize=8)
    return _png(figure)


def drawn_sheet(photo: FloatArray, classical: FloatArray, psfs: FloatArray) -> bytes:
    """Lay out a photo, the classical kernels given to the network, and its draws, as PNG; PSFs by the square root.

    Parameters
    ----------
    photo : (H, W) float, linear light
    classical : (Q, 64, 64) float
    psfs : (K, 64, 64) float
    """
    titles = ["photo", *["classical"] * len(classical), *[f"draw {i + 1}" for i in range(len(psfs))]]
    figure = _figure(_TILE_IN * len(titles), _TILE_IN + 0.3)
    pictures = [np.clip(photo, 0, 1) ** (1 / 2.2), *np.sqrt(classical), *np.sqrt(psfs)]
    for place, (title, picture) in enumerate(zip(titles, pictures, strict=True)):
        axes = figure.add_subplot(1, len(titles), place + 1)
        axes.imshow(picture, cmap="gray")
        axes.set_title(title, fontsize=8)
        axes.set_axis_off()
    return _png(figure)


def _figure(width_in: float, height_in: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    return stream.getvalue()
