"""From a photo and physics maps of it to one condition on the PSF's grid, shared by all that is drawn from it."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from motdiff.network.aggregation import LocalEmphasis, StepwiseAggregation
from motdiff.network.config import NetworkConfig
from motdiff.network.physics import GRID, PhysicsEncoder
from motdiff.network.pvt import PyramidVisionTransformer

__all__ = ["ConditionNetwork", "PhotoEncoder"]

_IMAGENET_MEAN = (0.485, 0.456, 0.406)
_IMAGENET_STD = (0.229, 0.224, 0.225)
_STRIDE = 32  # of the coarsest feature


class PhotoEncoder(nn.Module):
    """Photo (B, 3, H, W), display values 0..1, to z1 (B, width, H / 4, W / 4): PVT v2, local emphasis, aggregation.

    Parameters
    ----------
    config : NetworkConfig
        With a backbone "b0" .. "b5". For features "f2" only two of the backbone's stages are built.

    References
    ----------
    Choi et al., "MoTDiff", arXiv 2510.26173, equations 2-4.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        used = {"multi": (0, 1, 2, 3), "f2": (1,), "f4": (3,)}[config.features]
        self.used = used
        self.backbone = PyramidVisionTransformer(config.backbone, stages=used[-1] + 1)
        self.emphasis = nn.ModuleList(LocalEmphasis(self.backbone.channels[i], config.width) for i in used)
        self.aggregation = StepwiseAggregation(len(used), config.width)
        self.register_buffer("mean", torch.tensor(_IMAGENET_MEAN)[:, None, None], persistent=False)
        self.register_buffer("std", torch.tensor(_IMAGENET_STD)[:, None, None], persistent=False)

    def forward(self, photo: Tensor) -> Tensor:
        """Encode photos (B, 3, 32 m, 32 n) as z1 (B, width, H / 4, W / 4); ValueError for another shape."""
        sides = photo.shape[-2:]
        if photo.ndim != 4 or photo.shape[1] != 3 or any(side == 0 or side % _STRIDE for side in sides):
            wanted = f"(B, 3, H, W) with sides that are multiples of {_STRIDE}"
            raise ValueError(f"photo has shape {tuple(photo.shape)}; it must be {wanted}")
        features = self.backbone((photo - self.mean) / self.std)
        size = (sides[0] // 4, sides[1] // 4)
        emphasised = [emphasis(features[i], size) for i, emphasis in zip(self.used, self.emphasis, strict=True)]
        z1: Tensor = self.aggregation(emphasised)
        return z1


class ConditionNetwork(nn.Module):
    """Photo and physics maps to the condition; what is drawn from it comes in subclasses.

    Parameters
    ----------
    config : NetworkConfig
        Sizes; kept as `config`.

    Attributes
    ----------
    photo : PhotoEncoder or None
        `photo.backbone` takes ImageNet weights, see `motdiff.network.pvt.load_backbone`.
    physics : PhysicsEncoder or None
        Encoder of the physics maps.
    fusion : Conv2d or None
        1x1 convolution that joins both where there are both.
    condition_channels : int
        Channels of the condition: `width`, or `physics_width` without a photo encoder.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.photo = None if config.backbone == "none" else PhotoEncoder(config)
        self.physics = (
            PhysicsEncoder(config.physics_channels, config.physics_width, config.physics_depth, config.physics_patch)
            if config.physics_channels
            else None
        )
        both = self.photo is not None and self.physics is not None
        self.fusion = nn.Conv2d(config.width + config.physics_width, config.width, 1) if both else None
        self.condition_channels = config.physics_width if self.photo is None else config.width

    def condition(self, photo: Tensor | None, physics: Tensor | None) -> Tensor:
        """Encode photos, once each.

        Parameters
        ----------
        photo : (B, 3, H, W) float, display values 0..1
            Blurred photo, sides multiples of 32; 256x256 together with physics maps. None without a photo encoder.
        physics : (B, P, 64, 64) float
            Physics maps; None if the network takes none.

        Returns
        -------
        (B, C, H / 4, W / 4) float
            C is `width`, or `physics_width` without a photo encoder.

        Raises
        ------
        ValueError
            If an input is missing, not wanted or of the wrong shape.
        """
        _check_presence("photo", photo, wanted=self.photo is not None)
        _check_presence("physics", physics, wanted=self.physics is not None)
        if photo is not None and physics is not None and photo.shape[-2:] != (4 * GRID, 4 * GRID):
            raise ValueError(f"photo has shape {tuple(photo.shape)}; with physics maps it must be (B, 3, 256, 256)")
        parts: list[Tensor] = []
        if self.photo is not None:
            parts.append(self.photo(photo))  # (B, width, H/4, W/4)
        if self.physics is not None:
            parts.append(self.physics(physics))  # (B, physics_width, 64, 64)
        if self.fusion is None:
            return parts[0]
        return functional.relu(self.fusion(torch.cat(parts, dim=1)))  # (B, width, 64, 64)


def _check_presence(name: str, value: Tensor | None, *, wanted: bool) -> None:
    if (value is not None) != wanted:
        raise ValueError(f"{name} {'is None; this network needs it' if wanted else 'must be None for this network'}")
