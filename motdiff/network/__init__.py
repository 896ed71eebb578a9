"""MoTDiff network: a small diffusion denoiser of path maps, conditioned by a blurred photo.

Two baselines use the same condition: a denoiser of PSFs, and one quadratic path.
"""

from motdiff.network.config import NetworkConfig
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.parametric import PathNetwork

__all__ = ["MotDiffNetwork", "NetworkConfig", "PathNetwork", "build_network"]


def build_network(config: NetworkConfig) -> MotDiffNetwork | PathNetwork:
    """Build the network for the target that the configuration names, with random weights."""
    return PathNetwork(config) if config.target == "path" else MotDiffNetwork(config)
