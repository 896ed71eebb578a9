"""Parametric baseline: a network predicts one quadratic path from the photo."""

from __future__ import annotations

from pathlib import Path

from numpy.typing import ArrayLike

from lab.rivals.conditioning import conditioning_maps
from motdiff.estimators.base import MotionEstimate
from motdiff.psf_frame import PSF_PX
from motdiff.tracing.quadratic import QuadraticPath


class ParametricEstimator:
    """Blind estimator of Motion-ETR's class: one quadratic path, predicted directly and not
    refined.

    It has the condition network of the shipped MoTDiff and started from its former weights. Its
    output and its training differ: the shipped one saw 16,016 samples drawn from 704 prepared
    ones, MoTDiff 209,600 from 13,376. The limit of the class is
    :func:`~lab.evaluation.quadratic_limits.most_alike_quadratic`.

    Parameters
    ----------
    weights : path, optional
        A file from ``python -m motdiff export`` of a run with target "path"; the shipped one when
        omitted.

    References
    ----------
    Zhang, Wang, Maybank, Tao, "Exposure trajectory recovery from motion blur", TPAMI 2022.
    """

    def __init__(self, *, weights: Path | str | None = None) -> None:
        from lab.rivals.path_network import load_path_network
        from lab.weights import PATH_WEIGHTS

        self._network = load_path_network(PATH_WEIGHTS if weights is None else weights)

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Predict the path in ``photo``, (H, W) or (H, W, 3), linear light 0..1; see
        :func:`conditioning_maps`.

        The path is not scored: ``confidence`` is 0.
        """
        import torch

        with torch.no_grad():
            drift, bend = self._network(None, conditioning_maps(photo))[0].double().numpy()
        path = QuadraticPath(drift, bend)
        trajectory = path.trajectory()
        return MotionEstimate(
            "parametric",
            (trajectory,),
            (1.0,),
            trajectory.psf(trajectory.frame_size(PSF_PX)),
            confidence=0.0,
            details={"a_px": path.a.tolist(), "b_px": path.b.tolist()},
        )
