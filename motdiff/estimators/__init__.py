"""Estimators of the motion: one file each, all behind
:class:`motdiff.estimators.base.Estimator`.
"""
