"""The MoTDiff network: a blurred photo (or physics maps of it) conditions a small diffusion denoiser of path maps."""

from motdiff.network.config import NetworkConfig
from motdiff.network.model import MotDiffNetwork

__all__ = ["MotDiffNetwork", "NetworkConfig"]
