"""Condition network: features of a photo and its physics maps on the PSF's grid."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

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


class LocalEmphasis(nn.Module):
    """Two 3x3 convolutions with ReLU, then bilinear upsampling; each stage has its own.

    Parameters
    ----------
    inputs, width : int
        Channels of the feature and of the result.

    References
    ----------
    Choi et al., "MoTDiff", arXiv 2510.26173, equation 3; after SSFormer's progressive locality
    decoder.
    """

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.convs = nn.Sequential(
            nn.Conv2d(inputs, width, 3, 1, 1),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, 1, 1),
            nn.ReLU(),
        )

    def forward(self, f_s: Tensor, size: Sequence[int]) -> Tensor:
        """Feature f_s (B, C, h, w) of a stage to f_s_up (B, width, *size)."""
        f_s = self.convs(f_s)  # (B, width, h, w)
        if f_s.shape[-2:] == torch.Size(size):
            return f_s
        return functional.interpolate(f_s, tuple(size), mode="bilinear", align_corners=False)


class StepwiseAggregation(nn.Module):
    """z_4 = f_4_up, then z_s = ReLU(conv1x1(cat(z_{s+1}, f_s_up))) for s = 3, 2, 1.

    Neighbouring scales are joined first: no layer has to join global and local cues at once.

    Parameters
    ----------
    scales : int
        Number of features, 4 in the paper.
    width : int
        Channels of each and of the result.

    References
    ----------
    Choi et al., "MoTDiff", arXiv 2510.26173, equation 4.
    """

    def __init__(self, scales: int, width: int) -> None:
        super().__init__()
        # joins[s - 1] gives z_s
        self.joins = nn.ModuleList(nn.Conv2d(2 * width, width, 1) for _ in range(scales - 1))

    def forward(self, f_up: Sequence[Tensor]) -> Tensor:
        """Features f_1_up, f_2_up, ... (B, width, h, w) to z_1 (B, width, h, w)."""
        z = f_up[-1]
        for join, f_s_up in zip(reversed(self.joins), reversed(f_up[:-1]), strict=True):
            z = functional.relu(join(torch.cat([z, f_s_up], dim=1)))
        return z


class PhotoEncoder(nn.Module):
    """Features z_1 (B, width, H / 4, W / 4) of photos (B, 3, H, W), display values 0..1.

    Parameters
    ----------
    config : NetworkConfig
        With a backbone "b0" .. "b5". For features "f2" only two of the backbone's stages are
        built. With `photo_pool` 2 all this happens at half the size, and z_1 is interpolated.

    References
    ----------
    Choi et al., "MoTDiff", arXiv 2510.26173, equations 2-4.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.scales = {"multi": (0, 1, 2, 3), "f2": (1,), "f4": (3,)}[config.features]
        self.pool = config.photo_pool
        self.backbone = PyramidVisionTransformer(config.backbone, stages=self.scales[-1] + 1)
        self.emphasis = nn.ModuleList(
            LocalEmphasis(self.backbone.channels[i], config.width) for i in self.scales
        )
        self.aggregation = StepwiseAggregation(len(self.scales), config.width)
        self.register_buffer("mean", torch.tensor(_IMAGENET_MEAN)[:, None, None], persistent=False)
        self.register_buffer("std", torch.tensor(_IMAGENET_STD)[:, None, None], persistent=False)

    def forward(self, photo: Tensor) -> Tensor:
        """Encode photos whose sides are multiples of 32 `photo_pool`; ValueError for others."""
        sides = photo.shape[-2:]
        unit = _STRIDE * self.pool
        if (
            photo.ndim != 4
            or photo.shape[1] != 3
            or any(side == 0 or side % unit for side in sides)
        ):
            raise ValueError(
                f"photo has shape {tuple(photo.shape)}; it must be (B, 3, H, W) with sides that"
                f" are multiples of {unit}"
            )
        if self.pool > 1:
            photo = functional.avg_pool2d(photo, self.pool)
        f = self.backbone((photo - self.mean) / self.std)  # eq. 2
        size = [side // (_CONDITION_STRIDE * self.pool) for side in sides]
        f_up = [
            emphasis(f[scale], size)  # eq. 3
            for scale, emphasis in zip(self.scales, self.emphasis, strict=True)
        ]
        z_1: Tensor = self.aggregation(f_up)  # eq. 4
        if self.pool > 1:
            z_1 = functional.interpolate(z_1, scale_factor=self.pool, mode="bilinear")
        return z_1


class ConditionNetwork(nn.Module):
    """Photo and physics maps to the condition; base class of the networks that predict from it.

    Parameters
    ----------
    config : NetworkConfig
        Sizes; kept as `config`.

    Attributes
    ----------
    photo : PhotoEncoder or None
        `photo.backbone` has timm's names of parameters, see `motdiff.network.pvt`.
    physics : GridUNet or None
        Encoder of the physics maps.
    fusion : Conv2d or None
        With both encoders: 1x1 convolution of the photo's features, added to those of the physics
        maps.
    condition_channels : int
        Channels of the condition: `physics_width`, or `width` without physics maps.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.photo = None if config.backbone == "none" else PhotoEncoder(config)
        self.physics: GridUNet | None = None
        self.fusion: nn.Conv2d | None = None
        self.condition_channels = config.width
        if config.physics_channels:
            self.condition_channels = config.physics_width
            self.physics = GridUNet(
                config.physics_channels,
                config.physics_width,
                config.physics_depth,
                config.physics_patch,
            )
            if self.photo is not None:
                self.fusion = nn.Conv2d(config.width, config.physics_width, 1)
                # zero at first: a photo encoder can join a trained network without changing it
                silence(self.fusion)

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
            If an input is of the wrong shape.
        """
        encodings: list[Tensor] = []
        if self.physics is not None:
            encodings.append(self.physics(physics))  # (B, physics_width, 64, 64)
        if self.photo is not None:
            z_1 = self.photo(photo)  # (B, width, H/4, W/4)
            encodings.append(z_1 if self.fusion is None else self.fusion(z_1))
        return sum(encodings[1:], start=encodings[0])
