"""Figures of photos: before and after, with an enlarged detail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cep.files.foreign_text import plot_text
from cep.plots.canvas import COLOURS, new_figure, show_photo, thumbnail
from motdiff.crops import centre_crop, luminance
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
        top.add_patch(_frame(corner, side * scale))
        show_photo(bottom, cut[row : row + side, column : column + side])
    return figure


def _frame(corner: Sequence[float], side: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle(
        (corner[0], corner[1]), side, side, fill=False, edgecolor=COLOURS[4], linewidth=1.4
    )


def busiest(image: FloatArray, side: int) -> tuple[int, int]:
    """Return the corner of the window with most gradient, clear of the restoration's borders."""
    grey = luminance(image)
    energy = sum(np.abs(gradient) for gradient in np.gradient(grey))
    # a window's sum from four entries of the summed-area table (Crow 1984)
    totals = np.pad(np.cumsum(np.cumsum(energy, axis=0), axis=1), ((1, 0), (1, 0)))
    margin = min(_BORDER_PX, (min(grey.shape) - side) // 2)
    step = max(1, side // 4)  # neighbours overlap by three quarters: none falls between two
    corners = [
        (row, column)
        for row in range(margin, grey.shape[0] - side - margin + 1, step)
        for column in range(margin, grey.shape[1] - side - margin + 1, step)
    ]

    def structure(corner: tuple[int, int]) -> float:
        top, west = corner
        bottom = top + side
        east = west + side
        return float(
            totals[bottom, east] - totals[top, east] - totals[bottom, west] + totals[top, west]
        )

    return max(corners, key=structure)
