"""Motion with its order in time, from photos of one motion taken through known codes."""

from motdiff.estimators.coded.estimator import CodedEstimator, check_codes

__all__ = ["CodedEstimator", "check_codes"]
