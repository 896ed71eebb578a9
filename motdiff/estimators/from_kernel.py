"""Motion estimates from a kernel, which is cleaned, centred and traced, or from a path."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike

from motdiff.estimators.base import MotionEstimate
from motdiff.psf_frame import PSF_PX, centred, in_frame, without_faint_light, without_faint_parts
from motdiff.tracing import simplest_trajectory
from motdiff.trajectory import Trajectory

_FAINT = 0.01  # share of the peak: output of a generator off the path


def estimate_from_kernel(
    method: str, kernel: ArrayLike, details: Mapping[str, object]
) -> MotionEstimate:
    """Build an estimate from a kernel alone; its ``confidence`` is 0.

    Parameters
    ----------
    method : str
        Its name.
    kernel : (k, k) array_like
        Non-negative, with some light, anywhere in its frame. What is below a hundredth of the peak
        is dropped, and the centroid moves to the frame's middle, to whole pixels.
    details : mapping
        Figures for the report.
    """
    light = without_faint_light(kernel, below=_FAINT)
    psf = centred(light / light.sum())
    reach = int(np.abs(np.argwhere(psf) - np.array(psf.shape) // 2).max())
    psf = in_frame(psf, max(PSF_PX, 2 * (reach + 1)))
    trajectory = simplest_trajectory(without_faint_parts(psf))
    return MotionEstimate(
        method, (trajectory,), (1.0,), psf, confidence=0.0, details=dict(details)
    )


def as_estimate(result: MotionEstimate | Trajectory | ArrayLike, method: str) -> MotionEstimate:
    """Turn an estimator's result, an estimate, a trajectory or a PSF, into an estimate.

    Parameters
    ----------
    result : MotionEstimate, Trajectory, or (k, k) array_like
        A trajectory or a PSF says nothing of its confidence, which is then 0.
    method : str
        Name of the estimator.

    Raises
    ------
    ValueError
        If the result is of another kind, or no PSF.

    Examples
    --------
    >>> estimate = as_estimate([[0.0, 0, 0], [1, 1, 1], [0, 0, 0]], "mine")
    >>> estimate.psf.shape, estimate.best.xy.shape[1], estimate.confidence
    ((64, 64), 2, 0.0)
    """
    if isinstance(result, MotionEstimate):
        return result
    if isinstance(result, Trajectory):
        return MotionEstimate(
            method, (result,), (1.0,), result.psf(result.frame_size(PSF_PX)), confidence=0.0
        )
    psf = np.empty(0)  # no PSF, which is refused below
    with suppress(TypeError, ValueError):
        if not np.iscomplexobj(result):  # numpy would only warn, and drop the imaginary part
            psf = np.asarray(result, dtype=np.float64)
    if psf.ndim != 2 or not np.isfinite(psf).all() or psf.min(initial=0) < 0 or not psf.any():
        raise ValueError(
            "estimate(photo) must return a PSF (k x k, non-negative, with some light), a"
            f" Trajectory or a MotionEstimate, got {_kind(result)}"
        )
    return estimate_from_kernel(method, psf, {})


def _kind(result: object) -> str:
    if isinstance(result, np.ndarray):
        return f"{result.dtype} of shape {result.shape}"
    return type(result).__name__
