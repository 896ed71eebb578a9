"""Whether the blur is the same all over a photo: whether one kernel explains every crop as well as its own does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from motdiff.crops import uniformity
from motdiff.estimators.judge import Judge, kernel_score
from motdiff.metrics import SAME_KERNEL_MNC, mnc_subpixel
from motdiff.psf_frame import in_frame

__all__ = ["uneven_blur_warning"]

FloatArray = NDArray[np.float64]

_CLEARLY = 0.02  # docs/decisions/motion-estimation.md


def uneven_blur_warning(crops: FloatArray, own: Sequence[FloatArray], shared: FloatArray) -> str | None:
    """Return a sentence for the user when no kernel explains every crop as well as that crop's own, else None.

    That the kernels of single crops differ says little: a search in one crop is lost more often than a blur differs.

    Parameters
    ----------
    crops : (C, H, W) float, grey
    own : sequence of C (k, k) float
        Kernel found in each crop alone.
    shared : (k, k) float, odd k, sum 1
        Kernel found in all of them together.
    """
    kernels = [shared, *(_odd(kernel) for kernel in own)]
    scores = np.stack([kernel_score(Judge(crop[None]).evidence(kernels)) for crop in crops])
    alike = np.array([[mnc_subpixel(one, other) for other in kernels] for one in kernels[1:]])
    # (crops, kernels): how much better a crop's own kernel explains it than another one does
    missing = np.where(alike < SAME_KERNEL_MNC, np.diagonal(scores, offset=1)[:, None] - scores, 0.0)
    best = int(np.argmin((missing > _CLEARLY).sum(axis=0)))
    differing = np.flatnonzero(missing[:, best] > _CLEARLY)
    if differing.size == 0:
        return None
    mutual = uniformity([kernels[best], *(kernels[1 + i] for i in differing)])
    return (
        f"The blur differs across the photo ({differing.size} of {len(crops)} crops have another one, mutual MNC "
        f"{mutual:.2f}): no single trajectory fits."
    )


def _odd(kernel: FloatArray) -> FloatArray:
    """Cut an even frame, whose first row and column are beyond the reach of its centre, to an odd one; sum 1."""
    cut = in_frame(kernel, (len(kernel) - 1) | 1)
    return np.asarray(cut / max(float(cut.sum()), 1e-12), dtype=np.float64)
