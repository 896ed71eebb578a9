"""A kernel that nothing judges, taken as its method gives it: put into the usual frame, and its path traced."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.blind import without_faint_parts
from motdiff.tracing import simplest_trajectory

__all__ = ["unjudged_estimate"]

_FRAME_PX = 64
_DUST = 0.01


def unjudged_estimate(method: str, kernel: ArrayLike, details: Mapping[str, object]) -> MotionEstimate:
    """Make an estimate of a kernel alone; its ``confidence`` is 0.

    Parameters
    ----------
    method : str
        Its name.
    kernel : (k, k) array_like
        Non-negative, with some light, anywhere in its frame. What is below a hundredth of the peak is dropped, and the
        centroid moves to the frame's middle, to whole pixels.
    details : mapping
        Figures for the report.
    """
    light = np.asarray(kernel, dtype=np.float64)
    light = np.where(light < _DUST * light.max(), 0.0, light)
    psf = _centred(light / light.sum())
    trajectory = simplest_trajectory(without_faint_parts(psf))
    return MotionEstimate(method, (trajectory,), (1.0,), psf, confidence=0.0, details=dict(details))


def _centred(kernel: NDArray[np.float64]) -> NDArray[np.float64]:
    at = np.argwhere(kernel)
    at = at - np.rint(kernel[kernel > 0] @ at).astype(np.intp)
    side = max(_FRAME_PX, 2 * (int(np.abs(at).max()) + 1))
    psf = np.zeros((side, side))
    psf[tuple((at + side // 2).T)] = kernel[kernel > 0]
    return psf
