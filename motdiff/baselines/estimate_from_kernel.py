"""Estimate from a kernel without a confidence score: the kernel is cleaned and centred, and its path traced."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.multiscale import without_faint_parts
from motdiff.psf_frame import PSF_PX, centred, in_frame, without_faint_light
from motdiff.tracing import simplest_trajectory

__all__ = ["estimate_from_kernel"]

_FAINT = 0.01  # share of the peak: output of a generator off the path


def estimate_from_kernel(method: str, kernel: ArrayLike, details: Mapping[str, object]) -> MotionEstimate:
    """Build an estimate from a kernel alone; its ``confidence`` is 0.

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
    light = without_faint_light(kernel, below=_FAINT)
    psf = centred(light / light.sum())
    reach = int(np.abs(np.argwhere(psf) - np.array(psf.shape) // 2).max())
    psf = in_frame(psf, max(PSF_PX, 2 * (reach + 1)))
    trajectory = simplest_trajectory(without_faint_parts(psf))
    return MotionEstimate(method, (trajectory,), (1.0,), psf, confidence=0.0, details=dict(details))
