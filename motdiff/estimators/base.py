"""Motion estimates, kernels of a blind search, and the protocol of estimators."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from motdiff.files.plugins import load_object
from motdiff.trajectory import Trajectory

LOST = 0.5
"""Confidence below which a kernel is likelier wrong than good."""


@dataclass(frozen=True)
class MotionEstimate:
    """The motion found in one photo.

    Attributes
    ----------
    method : str
        Name of the estimator.
    trajectories : tuple of Trajectory
        Best first; alternatives follow.
    weights : tuple of float
        Probability of each trajectory; they sum to 1.
    psf : (S, S) float
        The blur kernel as this method estimates it: non-negative, sum 1, zero displacement at
        index ``S // 2``.
    confidence : float
        0..1, how likely the estimate is good rather than lost.
    warnings : tuple of str
        Warnings for the user, one sentence each.
    details : dict
        Figures behind the estimate (JSON-able), for the report.
    psf_warnings : tuple of str
        Those of the ``warnings`` that are for users of the PSF, too, whatever its path and
        confidence are.
    draws : tuple of (S, S) float
        Kernels drawn at random, each as likely as the others; empty for a method that draws none.
    """

    method: str
    trajectories: tuple[Trajectory, ...]
    weights: tuple[float, ...]
    psf: NDArray[np.float64]
    confidence: float
    warnings: tuple[str, ...] = ()
    details: dict[str, object] = field(default_factory=dict)
    psf_warnings: tuple[str, ...] = ()
    draws: tuple[NDArray[np.float64], ...] = ()

    @property
    def best(self) -> Trajectory:
        """The likeliest trajectory."""
        return self.trajectories[0]

    @property
    def path_error_px(self) -> float | None:
        """Expected error of the likeliest trajectory, px rms over time; None if not estimated."""
        # an estimator of the user's own may put anything there
        uncertainty_px = self.details.get("path_uncertainty_px")
        if isinstance(uncertainty_px, float) and uncertainty_px > 0:
            return uncertainty_px
        return None

    def __post_init__(self) -> None:
        if not self.trajectories or len(self.trajectories) != len(self.weights):
            raise ValueError("trajectories: need at least one, and as many weights")
        if not np.isclose(sum(self.weights), 1) or min(self.weights) < 0:
            raise ValueError(f"weights: must be non-negative and sum to 1, got {self.weights}")
        if not 0 <= self.confidence <= 1:
            raise ValueError(f"confidence: must lie within 0..1, got {self.confidence}")


@dataclass(frozen=True)
class FoundKernels:
    """Kernels that a search found in the crops of one photo.

    Attributes
    ----------
    kernels : tuple of (k, k) float, odd k, sum 1
        Candidates.
    probabilities : (K,) float
        Of each to be good: sub-pixel MNC of 0.7 or more.
    best : int
        The chosen one.
    details : dict
        Figures for the report.
    warnings : tuple of str
        Warnings for the user, one sentence each.
    origins : tuple of K str
        Where each kernel comes from; the report gives that of the best (``chosen``), or nothing
        where this is empty.
    path : Trajectory or None
        Path whose PSF the best kernel is, where a simple motion explains the photo.
    path_error_px : float or None, px
        Its expected error, rms over time.
    corrected : tuple of K (k, k) float
        The kernels corrected, where the search needed that; else empty.
    """

    kernels: tuple[NDArray[np.float64], ...]
    probabilities: NDArray[np.float64]
    best: int
    details: dict[str, object] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    origins: tuple[str, ...] = ()
    path: Trajectory | None = None
    path_error_px: float | None = None
    corrected: tuple[NDArray[np.float64], ...] = ()

    @property
    def best_kernel(self) -> NDArray[np.float64]:
        """The chosen kernel."""
        return self.kernels[self.best]

    @property
    def confidence(self) -> float:
        """Probability that the chosen kernel is good."""
        return float(self.probabilities[self.best])


@runtime_checkable
class Estimator(Protocol):
    """Turns a blurred photo into a motion estimate; a user's own may return a PSF instead."""

    def estimate(self, photo: NDArray[np.float64]) -> MotionEstimate:
        """Estimate the motion from ``photo``, (H, W) or (H, W, 3) float, linear light 0..1."""
        ...


def load_estimator(reference: str) -> Estimator:
    """Return an estimator of the user's own.

    Parameters
    ----------
    reference : str
        ``module:name`` of an estimator, or of a class or function that makes one without
        arguments.

    Raises
    ------
    ValueError
        If there is no such object, or it is no estimator.
    """
    loaded = load_object(reference)
    try:
        # an estimator's class has its methods, too: only an instance is used as it is
        if callable(loaded) and (isinstance(loaded, type) or not isinstance(loaded, Estimator)):
            loaded = loaded()
    except TypeError as error:
        raise ValueError(f"{reference}: cannot be made without arguments ({error})") from None
    if not isinstance(loaded, Estimator):
        raise ValueError(f"{reference}: has no method estimate(photo)")
    return loaded
