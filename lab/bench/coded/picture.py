"""Figure of coded photos in the paper's layout: photo, coded photo with its code and PSF, restored
photo, MTF.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cep.files.foreign_text import plot_text
from cep.plots.canvas import PRINTED_IN, in_lines, least_pt, new_figure, show_photo
from cep.proofs.mtf_curves import mtf_curve
from lab.bench.coded.designs import design_of
from lab.bench.coded.stages import pictures_of
from lab.bench.inset import show_inset
from motdiff.photo_values import to_linear
from motdiff.psf_frame import PSF_PX
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_TILE_IN = (1.0, 1.9)  # between these all columns are as wide as a page
_MARGIN_IN = 0.4
_INSET = 0.3


def coded_figure(
    pictured: Mapping[str, Mapping[str, Any]], scores: Mapping[str, str], *, linear: bool
) -> Figure:
    """Draw one photo and motion: the sharp photo with the motion's PSF, then a column per design.

    Parameters
    ----------
    pictured : mapping from design to its arguments
        Of :func:`lab.bench.coded.stages.pictures_of`; at least one design.
    scores : mapping from design to the caption below its restored photo
    linear : bool
        Whether the photo is light, or code values, which are shown unchanged.
    """
    names: Sequence[str] = tuple(pictured)
    tile_in = float(np.clip((PRINTED_IN - _MARGIN_IN) / (len(names) + 1), *_TILE_IN))
    width_in = tile_in * (len(names) + 1) + _MARGIN_IN
    figure = new_figure(width_in, 3 * tile_in + 1.3)
    size_pt = least_pt(width_in)
    axes = np.atleast_2d(figure.subplots(3, len(names) + 1, squeeze=False))
    for empty in axes[1:, 0]:
        empty.set_axis_off()
    for column, name in enumerate(names, 1):
        arguments = pictured[name]
        pictures = pictures_of(**arguments)
        exposure = arguments["exposure"]
        code, motion = exposure.code, exposure.motion
        if column == 1:  # every design has the same photo and motion
            _show(axes[0, 0], pictures.target, linear=linear)
            axes[0, 0].set_title(
                in_lines("photo, and PSF without a code", tile_in, size_pt),
                fontsize=size_pt,
                pad=14,
            )
            show_inset(axes[0, 0], motion.psf(PSF_PX), share=_INSET, cmap="inferno")
        light_true = (
            pictures.photo / max(code.duty, 1e-3) if exposure.light_true else pictures.photo
        )
        _show(axes[0, column], light_true, linear=linear)
        _show(axes[1, column], pictures.restored, linear=linear)
        axes[0, column].set_title(
            in_lines(plot_text(design_of(name).label), tile_in, size_pt), fontsize=size_pt, pad=14
        )
        strip = axes[0, column].inset_axes([0, 1.02, 1, 0.05])
        strip.imshow(
            code.array[None, :],
            cmap="gray",
            aspect="auto",
            vmin=0,
            vmax=1,
            interpolation="nearest",
        )
        strip.set_xticks([])
        strip.set_yticks([])
        show_inset(axes[0, column], pictures.psf, share=_INSET, cmap="inferno")
        axes[1, column].set_xlabel(scores.get(name, ""), fontsize=size_pt)
        frequency, modulus = mtf_curve(motion, code)
        axes[2, column].plot(frequency, modulus / code.duty, linewidth=0.9)
        axes[2, column].set_ylim(0, 1.02)
        axes[2, column].set_xticks((0, 0.25, 0.5), ("0", "¼", "½"))
        axes[2, column].tick_params(labelsize=size_pt)
        axes[2, column].set_xlabel("cycles/px", fontsize=size_pt)
        if column > 1:
            axes[2, column].set_yticklabels([])
    axes[2, 1].set_ylabel("MTF / duty,\nalong the motion", fontsize=size_pt)
    return figure


def _show(axes: Axes, image: FloatArray, *, linear: bool) -> None:
    light = np.clip(image, 0, 1)
    show_photo(axes, light if linear else to_linear(light))
