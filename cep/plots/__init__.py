"""Figures: each function returns a matplotlib Figure, without pyplot, global state or windows."""

from cep.plots.canvas import COLOURS, check_figure_name, png_bytes, save
from cep.plots.codes import code_strips, main_axis, mtf_curve, mtf_figure
from cep.plots.photos import before_after, psf_figure, trajectory_figure

__all__ = [
    "COLOURS",
    "before_after",
    "check_figure_name",
    "code_strips",
    "main_axis",
    "mtf_curve",
    "mtf_figure",
    "png_bytes",
    "psf_figure",
    "save",
    "trajectory_figure",
]
