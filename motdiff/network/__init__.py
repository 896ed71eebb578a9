"""MoTDiff network: a small diffusion denoiser of path maps, conditioned by a blurred photo."""

from motdiff.network.config import NetworkConfig
from motdiff.network.denoiser import MotDiffNetwork

__all__ = ["MotDiffNetwork", "NetworkConfig"]
