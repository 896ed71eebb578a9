"""Pyramid Vision Transformer v2: features of a photo at four scales.

Parameters are named as in timm's `pvt_v2_b0` .. `pvt_v2_b5`: `load_state_dict` takes its ImageNet
weights without a map of names. Stochastic depth is left out: it has no parameters, and the
condition should not change from one call to the next.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from torch import Tensor, nn
from torch.nn import functional

_HEADS = (1, 2, 5, 8)  # of the attention in each stage, here and below as published
_REDUCTIONS = (8, 4, 2, 1)  # of the grid of keys and values
_EPS = 1e-6  # of the blocks' norms, as in the published weights; norms after convolutions: 1e-5


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
