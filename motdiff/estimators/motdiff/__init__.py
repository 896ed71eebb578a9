"""MoTDiff: the motion drawn from a conditional diffusion model, checked and refined with the
photo.
"""

from motdiff.estimators.motdiff.estimator import MotDiffEstimator

__all__ = ["MotDiffEstimator"]
