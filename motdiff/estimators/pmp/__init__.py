"""Blind estimation with the patch-wise minimal pixels prior (PMP)."""

from motdiff.estimators.pmp.estimator import PmpEstimator

__all__ = ["PmpEstimator"]
