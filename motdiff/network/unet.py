"""Small U-Net on the PSF's 64x64 grid, over physics maps or over the denoiser's features.

A position on this grid is a displacement or a lag, which a learned embedding gives to each pixel;
attention at the coarse levels joins distant ones, such as the symmetric halves of a spectrum.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from motdiff.psf_frame import PSF_PX

_HEADS = 4
_LARGEST = 2.0  # channels grow by half the width per level, up to this multiple


class GridUNet(nn.Module):
    """Maps (B, C, 64, 64) to features (B, width, 64, 64).

    Residual blocks (GroupNorm, SiLU) at `depth` levels below 64x64 with 1, 1.5, 2, 2, ... times
    `width` channels; self-attention at the two coarsest levels; skip connections; a learned
    position embedding.

    Parameters
    ----------
    channels : int
        Number C of maps.
    width : int
        Channels at 64x64, a multiple of 8.
    depth : int
        Levels below the first: 64 -> 32 -> ... -> 64 / 2^depth.
    patch : int
        1, 2 or 4: every 2x2 or 4x4 pixels of the maps become channels of one, and the first level
        works on 32x32 or 16x16; 2 costs about a third of 1.
    """

    def __init__(self, channels: int, width: int, depth: int, patch: int = 1) -> None:
        super().__init__()
        side = PSF_PX // patch
        widths = [int(width * min(1 + level / 2, _LARGEST)) for level in range(depth + 1)]
        attends = [level > 0 and level >= depth - 1 for level in range(depth + 1)]
        self.channels = channels
        self.fold = nn.PixelUnshuffle(patch)
        self.unfold = nn.PixelShuffle(patch)
        self.stem = nn.Conv2d(channels * patch**2, width, 3, 1, 1)
        self.position = nn.Parameter(_waves(width, side))  # (1, width, side, side)
        self.fine = _Level(width, width, attends=False)
        self.down = nn.ModuleList(
            nn.Conv2d(widths[i], widths[i + 1], 3, 2, 1) for i in range(depth)
        )
        self.inward = nn.ModuleList(
            _Level(widths[i + 1], widths[i + 1], attends=attends[i + 1]) for i in range(depth)
        )
        self.up = nn.ModuleList(nn.Conv2d(widths[i + 1], widths[i], 1) for i in range(depth))
        self.outward = nn.ModuleList(
            _Level(2 * widths[i], widths[i], attends=attends[i]) for i in range(depth)
        )
        self.out = nn.Sequential(
            _group_norm(width), nn.SiLU(), nn.Conv2d(width, width * patch**2, 1)
        )

    def forward(self, maps: Tensor) -> Tensor:
        """Features (B, width, 64, 64) of maps (B, C, 64, 64); ValueError for another shape."""
        if maps.shape[1:] != (self.channels, PSF_PX, PSF_PX):
            raise ValueError(
                f"maps has shape {tuple(maps.shape)}; it must be (B, {self.channels}, {PSF_PX},"
                f" {PSF_PX})"
            )
        x: Tensor = self.fine(self.stem(self.fold(maps)) + self.position)  # (B, width, side, side)
        skips = []
        for down, inward in zip(self.down, self.inward, strict=True):
            skips.append(x)
            x = inward(down(x))  # half the side each time
        for up, outward, skip in zip(
            reversed(self.up), reversed(self.outward), reversed(skips), strict=True
        ):
            x = functional.interpolate(up(x), scale_factor=2.0, mode="nearest")
            x = outward(torch.cat([x, skip], dim=1))
        features: Tensor = self.unfold(self.out(x))  # (B, width, 64, 64)
        return features


def silence(layer: nn.Module) -> None:
    """Set a layer's parameters to zero: a sum with it is unchanged before training."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)


class _Level(nn.Module):
    """Residual block, and attention if asked for: (B, C, h, w) -> (B, C', h, w)."""

    def __init__(self, inputs: int, outputs: int, *, attends: bool) -> None:
        super().__init__()
        self.before = nn.Sequential(
            _group_norm(inputs), nn.SiLU(), nn.Conv2d(inputs, outputs, 3, 1, 1)
        )
        self.after = nn.Sequential(
            _group_norm(outputs), nn.SiLU(), nn.Conv2d(outputs, outputs, 3, 1, 1)
        )
        self.shortcut = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)
        self.attention = _Attention(outputs) if attends else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.attention(self.shortcut(x) + self.after(self.before(x)))
        return out


class _Attention(nn.Module):
    """Residual self-attention of every pixel with every other: (B, C, h, w) -> the same."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = _group_norm(channels)
        self.qkv = nn.Conv2d(channels, 3 * channels, 1)
        self.proj = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        batch, channels, height, width = x.shape
        qkv = self.qkv(self.norm(x)).reshape(batch, 3, _HEADS, channels // _HEADS, height * width)
        q, k, v = qkv.permute(1, 0, 2, 4, 3)  # (B, heads, N, d) each
        mixed = functional.scaled_dot_product_attention(q, k, v)
        out: Tensor = self.proj(mixed.transpose(2, 3).reshape(batch, channels, height, width))
        return x + out


def _group_norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(math.gcd(8, channels), channels)


def _waves(width: int, side: int) -> Tensor:
    """Sines and cosines of x and of y, periods 4 to 2 side px, (1, width, side, side)."""
    freq_cy_px = torch.logspace(math.log2(0.5 / side), math.log2(1 / 4), width // 4, base=2)
    # (width / 4, side)
    angle = 2 * math.pi * freq_cy_px[:, None] * (torch.arange(side) - (side - 1) / 2)
    wave = torch.cat([angle.sin(), angle.cos()])  # (width / 2, side)
    across = wave[:, None, :].expand(-1, side, -1)
    down = wave[:, :, None].expand(-1, -1, side)
    return 0.5 * torch.cat([across, down])[None]
