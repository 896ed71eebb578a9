"""Condition of the network: features of a photo, by a vision transformer, and its physics maps.

The transformer's parameters are named as in timm's `pvt_v2_b0` .. `pvt_v2_b5`: `load_state_dict`
takes its ImageNet weights without a map of names. Stochastic depth is left out: it has no
parameters, and the condition should not change from one call to the next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from motdiff.network.config import NetworkConfig
from motdiff.network.unet import GridUNet, silence
from motdiff.psf_frame import PSF_PX

_HEADS = (1, 2, 5, 8)  # of the attention in each stage, here and below as published
_REDUCTIONS = (8, 4, 2, 1)  # of the grid of keys and values
_EPS = 1e-6  # of the blocks' norms, as in the published weights; norms after convolutions: 1e-5
_IMAGENET_MEAN = (0.485, 0.456, 0.406)
_IMAGENET_STD = (0.229, 0.224, 0.225)
_STRIDE = 32  # of the coarsest feature, and of the condition, in photo pixels
_CONDITION_STRIDE = 4

PHOTO_PX = _CONDITION_STRIDE * PSF_PX
"""Side of the photo that goes with physics maps, px: its features then lie on the PSF's grid."""


class Variant(NamedTuple):
    """Channels, blocks and expansion of the feed-forward layers in each of the four stages."""

    dims: tuple[int, int, int, int]
    depths: tuple[int, int, int, int]
    mlp_ratios: tuple[int, int, int, int] = (8, 8, 4, 4)


VARIANTS = {
    "b0": Variant((32, 64, 160, 256), (2, 2, 2, 2)),
    "b1": Variant((64, 128, 320, 512), (2, 2, 2, 2)),
    "b2": Variant((64, 128, 320, 512), (3, 4, 6, 3)),
    "b3": Variant((64, 128, 320, 512), (3, 4, 18, 3)),
    "b4": Variant((64, 128, 320, 512), (3, 8, 27, 3)),
    "b5": Variant((64, 128, 320, 512), (3, 6, 40, 3), (4, 4, 4, 4)),
}


class PyramidVisionTransformer(nn.Module):
    """PVT v2 without its classification head.

    Parameters
    ----------
    variant : str
        "b0" .. "b5".
    stages : int
        Stages to build, 1..4; fewer when the later features are not used.

    References
    ----------
    Wang et al., "PVT v2: Improved baselines with pyramid vision transformer", Computational Visual
    Media 2022.
    """

    def __init__(self, variant: str, *, stages: int = 4) -> None:
        super().__init__()
        dims, depths, mlp_ratios = VARIANTS[variant]
        self.channels = dims[:stages]
        self.patch_embed = _PatchEmbedding(3, dims[0], kernel=7, stride=4)
        self.stages = nn.ModuleList(
            _Stage(
                dims[i - 1] if i else None,
                dims[i],
                depths[i],
                _HEADS[i],
                _REDUCTIONS[i],
                mlp_ratios[i],
            )
            for i in range(stages)
        )
        self.apply(_initialise)

    def forward(self, photo: Tensor) -> list[Tensor]:
        """Features (B, C_s, H / 2^(s+1), W / 2^(s+1)), s = 1..4, of photos (B, 3, H, W).

        Sides are multiples of 32; values are normalised by ImageNet's mean and deviation.
        """
        x = self.patch_embed(photo)  # (B, H/4, W/4, C1)
        features = []
        for stage in self.stages:
            x = stage(x)  # (B, C, h, w); the next stage begins with its own patch embedding
            features.append(x)
        return features


class _PatchEmbedding(nn.Module):
    """Overlapping patches to tokens: (B, C, H, W) -> (B, H / stride, W / stride, C')."""

    def __init__(self, inputs: int, outputs: int, *, kernel: int, stride: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2)
        self.norm = nn.LayerNorm(outputs)

    def forward(self, x: Tensor) -> Tensor:
        tokens: Tensor = self.norm(self.proj(x).permute(0, 2, 3, 1))
        return tokens


class _Stage(nn.Module):
    """One scale: patch embedding (the first stage's is the network's), blocks, norm."""

    def __init__(
        self,
        inputs: int | None,
        channels: int,
        depth: int,
        heads: int,
        reduction: int,
        mlp_ratio: int,
    ) -> None:
        super().__init__()
        self.downsample: _PatchEmbedding | None = None
        if inputs is not None:
            self.downsample = _PatchEmbedding(inputs, channels, kernel=3, stride=2)
        self.blocks = nn.ModuleList(
            _Block(channels, heads, reduction, mlp_ratio) for _ in range(depth)
        )
        self.norm = nn.LayerNorm(channels, eps=_EPS)

    def forward(self, x: Tensor) -> Tensor:
        if self.downsample is not None:
            x = self.downsample(x)  # (B, h, w, C)
        for block in self.blocks:
            x = block(x)
        feature: Tensor = self.norm(x).permute(0, 3, 1, 2)  # (B, C, h, w)
        return feature


class _Block(nn.Module):
    """Pre-norm residual attention and feed-forward layer; tokens (B, h, w, C)."""

    def __init__(self, channels: int, heads: int, reduction: int, mlp_ratio: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels, eps=_EPS)
        self.attn = _Attention(channels, heads, reduction)
        self.norm2 = nn.LayerNorm(channels, eps=_EPS)
        self.mlp = _FeedForward(channels, mlp_ratio * channels)

    def forward(self, x: Tensor) -> Tensor:
        mixed = x + self.attn(self.norm1(x))
        out: Tensor = mixed + self.mlp(self.norm2(mixed))
        return out


class _Attention(nn.Module):
    """Self-attention with keys and values of a grid coarsened by a strided convolution."""

    def __init__(self, channels: int, heads: int, reduction: int) -> None:
        super().__init__()
        self.heads = heads
        self.q = nn.Linear(channels, channels)
        self.kv = nn.Linear(channels, 2 * channels)
        self.proj = nn.Linear(channels, channels)
        self.sr = nn.Conv2d(channels, channels, reduction, reduction) if reduction > 1 else None
        self.norm = nn.LayerNorm(channels) if reduction > 1 else None

    def forward(self, x: Tensor) -> Tensor:
        batch, height, width, channels = x.shape
        coarse = x
        if self.sr is not None and self.norm is not None:
            # (B, h/r, w/r, C)
            coarse = self.norm(self.sr(x.permute(0, 3, 1, 2)).permute(0, 2, 3, 1))
        q = self.q(x).view(batch, -1, self.heads, channels // self.heads).transpose(1, 2)
        kv = self.kv(coarse).view(batch, -1, 2, self.heads, channels // self.heads)
        k, v = kv.permute(2, 0, 3, 1, 4)  # (B, heads, N / r^2, d) each
        mixed = functional.scaled_dot_product_attention(q, k, v)  # (B, heads, N, d)
        out: Tensor = self.proj(mixed.transpose(1, 2).reshape(batch, height, width, channels))
        return out


class _FeedForward(nn.Module):
    """Two linear layers around a depthwise convolution, whose zero padding encodes positions."""

    def __init__(self, channels: int, hidden: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(channels, hidden)
        self.dwconv = nn.Conv2d(hidden, hidden, 3, 1, 1, groups=hidden)
        self.fc2 = nn.Linear(hidden, channels)

    def forward(self, x: Tensor) -> Tensor:
        x = self.dwconv(self.fc1(x).permute(0, 3, 1, 2)).permute(0, 2, 3, 1)  # (B, h, w, hidden)
        out: Tensor = self.fc2(functional.gelu(x))
        return out


def _initialise(module: nn.Module) -> None:
    """As upstream: truncated normal (linear layers), He by outputs (convolutions), biases 0."""
    if isinstance(module, nn.Linear):
        nn.init.trunc_normal_(module.weight, std=0.02)
    elif isinstance(module, nn.Conv2d):
        fan_out = (
            module.kernel_size[0] * module.kernel_size[1] * module.out_channels // module.groups
        )
        nn.init.normal_(module.weight, 0, math.sqrt(2 / fan_out))
    if isinstance(module, nn.Linear | nn.Conv2d) and module.bias is not None:
        nn.init.zeros_(module.bias)


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
        `photo.backbone` has timm's names of parameters.
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
