"""Motion estimates from kernels or paths, with their confidences and warnings.

:func:`described` is for kernels that a search has judged, :func:`estimate_from_kernel` for one
kernel of unknown worth, :func:`as_estimate` for whatever an estimator of the user's own returns.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from motdiff.estimators.base import LOST, FoundKernels, MotionEstimate
from motdiff.metrics import mnc_subpixel
from motdiff.psf_frame import PSF_PX, centred, in_frame, without_faint_light, without_faint_parts
from motdiff.tracing.quadratic import plain_trajectory, simplest_trajectory
from motdiff.trajectory import Trajectory

# less than SAME_KERNEL_MNC: alternatives are other motions, not other estimates of one
_SAME_MOTION_MNC = 0.8
_MOST_MOTIONS = 3  # the best, and alternatives
_LEAST_CHANCE = 0.02  # of an alternative
# of plain paths whose kernel is good, the share that is right to within 1 px, in length and order
# (docs/decisions/tracing.md)
_PLAIN_RIGHT = 0.9
_BENT_TURNS = 1.3
_BENT_RIGHT = 0.3
_DRAWS = 8
_CLEAR_ORDER = 0.5  # below, the order is said to be uncertain
_FAINT = 0.01  # share of the peak: output of a generator off the path


@dataclass(frozen=True)
class _KernelPaths:
    """Paths of a kernel, orders in time, with their chances, and that of the first to be right."""

    orders: tuple[tuple[Trajectory, float], ...]
    right: float


def described(
    candidates: FoundKernels,
    *,
    method: str,
    factor: int,
    plain_mnc: float,
    uneven: str | None,
    details: Mapping[str, object],
    rng: np.random.Generator,
) -> MotionEstimate:
    """Describe the motion that kernels show.

    Parameters
    ----------
    method : str
        Name of the estimator.
    factor : int
        By how much the photo was made smaller before the search.
    plain_mnc : float
        From this likeness with the kernel on, a quadratic path is taken for it.
    uneven : str, optional
        Warning that the blur differs across the photo.
    details : mapping
        Other figures for the report.
    rng : Generator
        Of the paths drawn for a kernel.
    """
    kernels = candidates.kernels
    chosen = [candidates.best]  # then those that show other motions, likeliest first
    for i in np.argsort(-candidates.probabilities):
        if len(chosen) < _MOST_MOTIONS and all(
            mnc_subpixel(kernels[i], kernels[j]) < _SAME_MOTION_MNC for j in chosen
        ):
            chosen.append(int(i))
    best = _paths_of(candidates, plain_mnc, rng)
    motions = [(path, candidates.confidence * chance) for path, chance in best.orders]
    # the order along another kernel is no surer, and its noise would lengthen the path
    first_chance = best.orders[0][1]
    motions += [
        (
            simplest_trajectory(without_faint_parts(kernels[i])),
            float(candidates.probabilities[i]) * first_chance,
        )
        for i in chosen[1:]
    ]
    likely = [motion for motion in motions[1:] if motion[1] >= _LEAST_CHANCE]
    likely.sort(key=lambda motion: -motion[1])
    motions = [motions[0], *likely[: _MOST_MOTIONS - 1]]
    trajectories = [path.scaled(factor) if factor > 1 else path for path, _ in motions]
    weights = np.array([weight for _, weight in motions])
    weights = weights / weights.sum()
    psf = path_psf = trajectories[0].psf(trajectories[0].frame_size(PSF_PX))
    if factor == 1:
        kernel = candidates.best_kernel
        psf = in_frame(kernel, max(PSF_PX, len(kernel) + 1))
        psf = psf / psf.sum()
    of_the_kernel = [*candidates.warnings, *filter(None, [uneven])]
    of_the_path = []
    confidence = candidates.confidence
    if confidence >= LOST and best.right < _CLEAR_ORDER:
        of_the_path.append(
            "a blur kernel does not tell the order in time along this path: a code searched along"
            " it may be no better than a published one; the method gyro tells the order, and so"
            " do photos through known codes"
        )
    if confidence < LOST:
        of_the_path.append(
            f"the blind estimate is probably lost (confidence {confidence:.2f}): "
            "take a photo with more texture, or use the methods reference or point"
        )
    of_the_scale = []
    if factor > 1:
        of_the_scale.append(
            f"the motion was estimated on the photo at 1/{factor} of its size, where it"
            " shows better"
        )
    figures = {**details, "scale": 1 / factor, **candidates.details}
    if candidates.origins:
        figures["chosen"] = candidates.origins[candidates.best]
    if candidates.path_error_px is not None:
        figures["path_uncertainty_px"] = candidates.path_error_px * factor
    return MotionEstimate(
        method=method,
        trajectories=tuple(trajectories),
        weights=tuple(float(w) for w in weights),
        psf=psf,
        confidence=confidence,
        warnings=(*of_the_kernel, *of_the_path, *of_the_scale),
        details={
            **figures,
            "trajectory_psf_mnc": mnc_subpixel(psf, path_psf),
            "psf_confidence": candidates.confidence,
            "path_confidence": confidence * best.right,
        },
        psf_warnings=(*of_the_kernel, *of_the_scale),
    )


def _paths_of(
    candidates: FoundKernels, plain_mnc: float, rng: np.random.Generator
) -> _KernelPaths:
    """Paths of the best kernel: its own simple motion, a plain path, or drawn ones."""
    if candidates.path is not None:
        return _KernelPaths(((candidates.path, 1.0),), _PLAIN_RIGHT)
    kernel = candidates.best_kernel
    plain = plain_trajectory(without_faint_parts(kernel), least_mnc=plain_mnc)
    if plain is not None:
        bent = plain.length_px > _BENT_TURNS * plain.extent_px
        return _KernelPaths(((plain, 1.0),), _BENT_RIGHT if bent else _PLAIN_RIGHT)
    # these load torch, which takes a second
    from motdiff.network.path_drawing import draw_paths
    from motdiff.weights import load_path_denoiser

    orders = draw_paths(load_path_denoiser(), kernel, count=_DRAWS, rng=rng).orders()
    return _KernelPaths(tuple((order.path, order.chance) for order in orders), orders[0].right)


# -- estimates without a judgement -------------------------------------------------------------


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
