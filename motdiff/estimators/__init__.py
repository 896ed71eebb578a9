"""Estimators of the motion, all behind :class:`motdiff.estimators.base.Estimator`."""
