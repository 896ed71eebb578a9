"""Condition network: a photo and its physics maps to one condition on the PSF's grid, shared by
all samples.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from motdiff.network.aggregation import LocalEmphasis, StepwiseAggregation
from motdiff.network.config import NetworkConfig
from motdiff.network.pvt import PyramidVisionTransformer
from motdiff.network.unet import GridUNet, silence
from motdiff.psf_frame import PSF_PX

_IMAGENET_MEAN = (0.485, 0.456, 0.406)
_IMAGENET_STD = (0.229, 0.224, 0.225)
_STRIDE = 32  # of the coarsest feature, and of the condition, in photo pixels
_CONDITION_STRIDE = 4

PHOTO_PX = _CONDITION_STRIDE * PSF_PX
"""Side of the photo that goes with physics maps, px: its features then lie on the PSF's grid."""


class PhotoEncoder(nn.Module):
    """Photo (B, 3, H, W), display values 0..1, to z1 (B, width, H / 4, W / 4): PVT v2, local
    emphasis, aggregation.

    Parameters
    ----------
    config : NetworkConfig
        With a backbone "b0" .. "b5". For features "f2" only two of the backbone's stages are
        built. With `photo_pool` 2 all this happens at half the size, and z1 is interpolated.

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
        self.pool = config.photo_pool
        self.backbone = PyramidVisionTransformer(config.backbone, stages=used[-1] + 1)
        self.emphasis = nn.ModuleList(
            LocalEmphasis(self.backbone.channels[i], config.width) for i in used
        )
        self.aggregation = StepwiseAggregation(len(used), config.width)
        self.register_buffer("mean", torch.tensor(_IMAGENET_MEAN)[:, None, None], persistent=False)
        self.register_buffer("std", torch.tensor(_IMAGENET_STD)[:, None, None], persistent=False)

    def forward(self, photo: Tensor) -> Tensor:
        """Encode photos (B, 3, H, W), sides multiples of 32 `photo_pool`, as z1; ValueError for
        another shape.
        """
        sides = photo.shape[-2:]
        unit = _STRIDE * self.pool
        if (
            photo.ndim != 4
            or photo.shape[1] != 3
            or any(side == 0 or side % unit for side in sides)
        ):
            wanted = f"(B, 3, H, W) with sides that are multiples of {unit}"
            raise ValueError(f"photo has shape {tuple(photo.shape)}; it must be {wanted}")
        pooled = functional.avg_pool2d(photo, self.pool) if self.pool > 1 else photo
        features = self.backbone((pooled - self.mean) / self.std)
        fine = [side // (_CONDITION_STRIDE * self.pool) for side in sides]
        emphasised = [
            emphasis(features[i], fine)
            for i, emphasis in zip(self.used, self.emphasis, strict=True)
        ]
        z1: Tensor = self.aggregation(emphasised)
        return (
            functional.interpolate(z1, scale_factor=self.pool, mode="bilinear")
            if self.pool > 1
            else z1
        )


class ConditionNetwork(nn.Module):
    """Photo and physics maps to the condition; base class of the networks that predict from it.

    Parameters
    ----------
    config : NetworkConfig
        Sizes; kept as `config`.

    Attributes
    ----------
    photo : PhotoEncoder or None
        `photo.backbone` takes ImageNet weights, see `motdiff.network.pvt.load_backbone`.
    physics : GridUNet or None
        Encoder of the physics maps.
    fusion : Conv2d or None
        Where there are both: 1x1 convolution of the photo's features, added to those of the
        physics maps. It starts at zero, so that a photo encoder can be put on a trained network
        without changing what it draws.
    condition_channels : int
        Channels of the condition: `physics_width`, or `width` without physics maps.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.photo = None if config.backbone == "none" else PhotoEncoder(config)
        self.physics = (
            GridUNet(
                config.physics_channels,
                config.physics_width,
                config.physics_depth,
                config.physics_patch,
            )
            if config.physics_channels
            else None
        )
        both = self.photo is not None and self.physics is not None
        self.fusion = nn.Conv2d(config.width, config.physics_width, 1) if both else None
        if self.fusion is not None:
            silence(self.fusion)
        self.condition_channels = config.width if self.physics is None else config.physics_width

    def condition(self, photo: Tensor | None, physics: Tensor | None) -> Tensor:
        """Encode photos, once each.

        Parameters
        ----------
        photo : (B, 3, H, W) float, display values 0..1
            Blurred photo, sides multiples of 32 `photo_pool`; 256x256 together with physics maps.
            None without a photo encoder.
        physics : (B, P, 64, 64) float
            Physics maps; None if the network takes none.

        Returns
        -------
        (B, C, H / 4, W / 4) float
            C is `condition_channels`.

        Raises
        ------
        ValueError
            If an input is missing, not wanted or of the wrong shape.
        """
        _check_presence("photo", photo, wanted=self.photo is not None)
        _check_presence("physics", physics, wanted=self.physics is not None)
        if photo is not None and physics is not None and photo.shape[-2:] != (PHOTO_PX, PHOTO_PX):
            raise ValueError(
                f"photo has shape {tuple(photo.shape)}; with physics maps it must be (B, 3,"
                f" {PHOTO_PX}, {PHOTO_PX})"
            )
        parts: list[Tensor] = []
        if self.physics is not None:
            parts.append(self.physics(physics))  # (B, physics_width, 64, 64)
        if self.photo is not None:
            seen = self.photo(photo)  # (B, width, H/4, W/4)
            parts.append(seen if self.fusion is None else self.fusion(seen))
        return sum(parts[1:], start=parts[0])


def _check_presence(name: str, value: Tensor | None, *, wanted: bool) -> None:
    if (value is not None) != wanted:
        raise ValueError(
            f"{name}"
            f" {'is None; this network needs it' if wanted else 'must be None for this network'}"
        )
