"""SelfDeblur: an untrained network for the photo and one for the kernel, fitted to one blurred
photo.
"""

from lab.rivals.selfdeblur.config import SelfDeblurConfig
from lab.rivals.selfdeblur.estimator import SelfDeblurEstimator

__all__ = ["SelfDeblurConfig", "SelfDeblurEstimator"]
