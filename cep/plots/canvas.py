"""Common parts of figures: colours, figures without global state, photos on axes, files."""

from __future__ import annotations

import io
import textwrap
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from motdiff.files.outputs import new_file
from motdiff.photo_values import to_display
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Line colours that stay apart for colour-blind readers and in grey print.

References
----------
Okabe and Ito, "Color universal design", 2008.
"""

# so that curves stay apart without colour
LINES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (7, 2)))

PRINTED_IN = 7.0  # width of print on a page: wider figures are shrunk to it, with their texts
_DPI = 144
_LEAST_PT = 7.0  # in print
_LETTER = 2 / 3  # mean width of a letter over its size


def least_pt(width_in: float) -> float:
    """Font size, pt, that is 7 pt in print in a figure of this width: no text is smaller."""
    return _LEAST_PT * max(1.0, width_in / PRINTED_IN)


def in_lines(text: str, width_in: float, size_pt: float) -> str:
    """Break a text into lines that fit a width."""
    letters = int(width_in * 72 / (_LETTER * size_pt))  # 72 pt are an inch
    return textwrap.fill(text, max(letters, 8), break_long_words=False)


def plain_ticks(axis: Axis) -> None:
    """Write the ticks of a logarithmic axis as numbers: exponents are smaller than other texts."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_major_formatter(
        FuncFormatter(lambda value, _: f"{value:,.0f}" if value >= 1 else f"{value:g}")
    )
    axis.set_minor_formatter(NullFormatter())


def new_figure(width_in: float, height_in: float) -> Figure:
    """Make an empty figure on the Agg canvas, sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as FigureClass

    figure = FigureClass(figsize=(width_in, height_in), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def png_bytes(figure: Figure, *, dpi: int = _DPI) -> bytes:
    """Render a figure as PNG; the same figure gives the same bytes."""
    # the lowest compression takes half the time and an eighth more bytes
    quick = {"compress_level": 1}
    # matplotlib would name its version in the file
    return _rendered(figure, format="png", dpi=dpi, metadata={"Software": None}, pil_kwargs=quick)


def check_figure_name(path: Path | str) -> None:
    """Check, before any work is done, that :func:`save` writes such files, else ValueError."""
    if Path(path).suffix.lower() not in (".png", ".pdf", ".svg"):
        raise ValueError(f"{path}: figures are written as .png, .pdf or .svg")


def save(figure: Figure, path: Path | str) -> None:
    """Write a figure as .png, .pdf or .svg, whole or not at all."""
    target = Path(path)
    check_figure_name(target)
    content = undated(figure, target.suffix[1:].lower())
    with new_file(target) as temporary:
        temporary.write_bytes(content)


def undated(figure: Figure, kind: str, *, dpi: int = _DPI) -> bytes:
    """Render a figure as "png", "pdf" or "svg" reproducibly: the same figure gives the same bytes.

    The date is left out, and in SVG element names are fixed. Text stays text: in SVG in a font of
    the viewer's, in PDF with the font embedded. It is rendered in memory, because on a full disk
    matplotlib's PDF writer hides the error behind another one.
    """
    from matplotlib import rc_context

    if kind == "png":
        return png_bytes(figure, dpi=dpi)
    dates = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    with rc_context(
        # without a salt an SVG's ids are random; type 42 and "none" keep text as text in print
        {"svg.hashsalt": "coded-exposure", "svg.fonttype": "none", "pdf.fonttype": 42}
    ):
        return _rendered(figure, format=kind, dpi=dpi, metadata=dates.get(kind))


def _rendered(figure: Figure, **options: Any) -> bytes:
    """Render a figure; characters of names that its font lacks are boxes, without a warning."""
    stream = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure.savefig(stream, **options)
    return stream.getvalue()


def show_photo(axes: Axes, image: FloatArray) -> None:
    """Draw a photo, linear light 0..1, as a screen shows it and without ticks."""
    axes.imshow(
        to_display(np.clip(image, 0, 1)), cmap="gray", vmin=0, vmax=1, interpolation="nearest"
    )
    axes.set_xticks([])
    axes.set_yticks([])


def thumbnail(image: ArrayLike, longest_px: int) -> FloatArray:
    """Shrink by whole-number box means: of linear light, so that it stays as bright."""
    pixels = np.asarray(image, dtype=np.float64)
    factor = -(-max(pixels.shape[:2]) // longest_px)
    if factor == 1:
        return pixels
    rows, columns = (length // factor for length in pixels.shape[:2])
    boxes = pixels[: rows * factor, : columns * factor].reshape(
        rows, factor, columns, factor, *pixels.shape[2:]
    )
    return np.asarray(boxes.mean(axis=(1, 3)))
