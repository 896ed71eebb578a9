"""Kernels in the corners of pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from motdiff.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def show_inset(axes: Axes, psf: FloatArray, *, share: float, cmap: str) -> None:
    """Draw the square root of a PSF, which shows faint parts, in the upper left corner.

    It is ``share`` of the axes wide.
    """
    corner = axes.inset_axes((0, 1 - share, share, share))
    corner.imshow(np.sqrt(np.maximum(psf, 0)), cmap=cmap, interpolation="nearest")
    corner.set_xticks([])
    corner.set_yticks([])
