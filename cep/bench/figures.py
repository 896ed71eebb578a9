"""A benchmark's figure as files: PNG to look at, PDF to print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cep.plots.canvas import png_bytes, undated

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FIGURE_SUFFIXES", "write_figure"]

FIGURE_SUFFIXES = (".png", ".pdf")
"""What :func:`write_figure` writes."""

_PRINT_DPI = 300


def write_figure(figure: Figure, folder: Path, stem: str) -> None:
    """Write ``STEM.png`` and ``STEM.pdf`` into a folder; the same figure gives the same bytes.

    Raises
    ------
    OSError
        If a file cannot be written, as on a full disk.
    """
    (folder / f"{stem}.png").write_bytes(png_bytes(figure))
    (folder / f"{stem}.pdf").write_bytes(undated(figure, "pdf", dpi=_PRINT_DPI))
