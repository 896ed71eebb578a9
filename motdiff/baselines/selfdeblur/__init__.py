"""SelfDeblur: an untrained network for the photo and one for the kernel, fitted to one blurred photo."""

from motdiff.baselines.selfdeblur.config import SelfDeblurConfig
from motdiff.baselines.selfdeblur.estimator import SelfDeblurEstimator

__all__ = ["SelfDeblurConfig", "SelfDeblurEstimator"]
