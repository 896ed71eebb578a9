"""U-Net of "ablated diffusion models" with the parameter names of guided-diffusion, whose weights
BlindDPS uses.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from motdiff.network.denoiser import timestep_embedding

_HEAD = 64  # channels of an attention head
_GROUPS = 32  # of a group norm
_LARGEST_PX = 1024
_WIDEST = 4096
_DEEPEST = 8


@dataclass(frozen=True)
class AdmConfig:
    """Size of a network.

    Attributes
    ----------
    size : int
        Side of the images in pixels, a multiple of ``2 ** (len(multipliers) - 1)``.
    channels : int
        Channels of the images: 1 or 3.
    width : int
        Channels of the first level, a multiple of 32.
    multipliers : tuple of int
        Channels of each level by ``width``; each level has half the side of the one before.
    blocks : int
        Residual blocks of each level.
    attention : tuple of int
        Sides in pixels of the levels with attention; their channels are a multiple of 64, and the
        last level's.
    learned_variance : bool
        Whether the output has as many channels again, for the variance.

    Raises
    ------
    ValueError
        If a field is of another kind or out of its range.
    """

    size: int
    channels: int
    width: int
    multipliers: tuple[int, ...]
    blocks: int = 1
    attention: tuple[int, ...] = (16,)
    learned_variance: bool = True

    def __post_init__(self) -> None:
        for name in ("multipliers", "attention"):
            values = getattr(self, name)
            if not isinstance(values, list | tuple) or not all(
                type(value) is int for value in values
            ):
                raise ValueError(f"{name}: must be whole numbers, got {values!r}")
            object.__setattr__(self, name, tuple(values))  # JSON has lists
        limits = {"size": _LARGEST_PX, "channels": 3, "width": _WIDEST, "blocks": _DEEPEST}
        for name, largest in limits.items():
            value = getattr(self, name)
            if type(value) is not int or not 1 <= value <= largest:
                raise ValueError(
                    f"{name}: must be a whole number within 1..{largest}, got {value!r}"
                )
        if self.channels == 2:
            raise ValueError("channels: must be 1 or 3, got 2")
        if not 1 <= len(self.multipliers) <= _DEEPEST or self.size % 2 ** (
            len(self.multipliers) - 1
        ):
            raise ValueError(
                f"multipliers: must be 1..{_DEEPEST} levels that halve {self.size} px, got"
                f" {self.multipliers}"
            )
        widths = [self.width * multiplier for multiplier in self.multipliers]
        if self.width % _GROUPS or not all(0 < width <= _WIDEST for width in widths):
            raise ValueError(
                f"width: must be a multiple of {_GROUPS}, with levels up to {_WIDEST}, got"
                f" {self.width}"
            )
        if any(
            width % _HEAD
            for level, width in enumerate(widths)
            if self.attends(level) or level == len(widths) - 1
        ):
            raise ValueError(
                f"width: levels with attention must be a multiple of {_HEAD} wide, got"
                f" {self.width}"
            )

    def attends(self, level: int) -> bool:
        """Whether a level has attention."""
        return self.size >> level in self.attention


class AdmUNet(nn.Module):
    """Noise (and variance) in noisy images, by residual blocks with scales and shifts that depend
    on the timestep.

    Parameters
    ----------
    config : AdmConfig

    References
    ----------
    Dhariwal, Nichol, "Diffusion models beat GANs on image synthesis", NeurIPS 2021, section 3.
    """

    def __init__(self, config: AdmConfig) -> None:
        super().__init__()
        self.width = config.width
        time_width = 4 * config.width
        widths = [config.width * multiplier for multiplier in config.multipliers]
        self.time_embed = nn.Sequential(
            nn.Linear(config.width, time_width), nn.SiLU(), nn.Linear(time_width, time_width)
        )
        self.input_blocks = nn.ModuleList(
            [_Stage(nn.Conv2d(config.channels, widths[0], 3, padding=1))]
        )
        skips = [widths[0]]
        channels = widths[0]
        for level, width in enumerate(widths):
            attends = config.attends(level)
            for _ in range(config.blocks):
                self.input_blocks.append(_stage(channels, width, time_width, attends=attends))
                channels = width
                skips.append(channels)
            if level < len(widths) - 1:
                self.input_blocks.append(
                    _Stage(_ResidualBlock(channels, channels, time_width, scale=0.5))
                )
                skips.append(channels)
        self.middle_block = _Stage(
            _ResidualBlock(channels, channels, time_width),
            _Attention(channels),
            _ResidualBlock(channels, channels, time_width),
        )
        self.output_blocks = nn.ModuleList()
        for level, width in reversed(list(enumerate(widths))):
            for index in range(config.blocks + 1):
                grows = level > 0 and index == config.blocks
                inputs = channels + skips.pop()
                attends = config.attends(level)
                self.output_blocks.append(
                    _stage(inputs, width, time_width, attends=attends, grows=grows)
                )
                channels = width
        outputs = config.channels * (2 if config.learned_variance else 1)
        self.out = nn.Sequential(
            nn.GroupNorm(_GROUPS, channels), nn.SiLU(), nn.Conv2d(channels, outputs, 3, padding=1)
        )

    def forward(self, x: Tensor, t: Tensor) -> Tensor:
        """Noise in images (B, C, S, S) at timesteps (B,), (B, C, S, S), then the channels of the
        variance.
        """
        time = self.time_embed(timestep_embedding(t, self.width))
        skips = []
        for stage in self.input_blocks:
            x = stage(x, time)
            skips.append(x)
        x = self.middle_block(x, time)
        for stage in self.output_blocks:
            x = stage(torch.cat([x, skips.pop()], dim=1), time)
        noise: Tensor = self.out(x)
        return noise


class _Stage(nn.Sequential):
    """Layers in sequence; the residual blocks among them also get the timestep's embedding."""

    def forward(self, x: Tensor, time: Tensor) -> Tensor:  # type: ignore[override]
        for layer in self:
            x = layer(x, time) if isinstance(layer, _ResidualBlock) else layer(x)
        return x


def _stage(
    inputs: int, outputs: int, time_width: int, *, attends: bool, grows: bool = False
) -> _Stage:
    layers: list[nn.Module] = [_ResidualBlock(inputs, outputs, time_width)]
    if attends:
        layers.append(_Attention(outputs))
    if grows:
        layers.append(_ResidualBlock(outputs, outputs, time_width, scale=2.0))
    return _Stage(*layers)


class _ResidualBlock(nn.Module):
    """(B, C, h, w) -> (B, C', scale h, scale w)."""

    def __init__(self, inputs: int, outputs: int, time_width: int, *, scale: float = 1.0) -> None:
        super().__init__()
        self.scale = scale
        self.in_layers = nn.Sequential(
            nn.GroupNorm(_GROUPS, inputs), nn.SiLU(), nn.Conv2d(inputs, outputs, 3, padding=1)
        )
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(time_width, 2 * outputs))
        self.out_layers = nn.Sequential(
            nn.GroupNorm(_GROUPS, outputs),
            nn.SiLU(),
            nn.Identity(),
            nn.Conv2d(outputs, outputs, 3, padding=1),
        )
        self.skip_connection = (
            nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)
        )

    def forward(self, x: Tensor, time: Tensor) -> Tensor:
        hidden = self.in_layers[2](_resized(self.in_layers[:2](x), self.scale))
        gain, shift = self.emb_layers(time)[:, :, None, None].chunk(2, dim=1)
        hidden = self.out_layers[1:](self.out_layers[0](hidden) * (1 + gain) + shift)
        total: Tensor = self.skip_connection(_resized(x, self.scale)) + hidden
        return total


class _Attention(nn.Module):
    """Residual attention of every pixel to every other, (B, C, h, w) -> the same."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(_GROUPS, channels)
        self.qkv = nn.Conv1d(channels, 3 * channels, 1)
        self.proj_out = nn.Conv1d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        flat = x.flatten(2)  # (B, C, N)
        heads = self.qkv(self.norm(flat)).unflatten(1, (-1, 3, _HEAD))  # (B, heads, 3, 64, N)
        query, key, value = heads.transpose(3, 4).unbind(2)  # (B, heads, N, 64) each
        mixed = functional.scaled_dot_product_attention(query, key, value)
        total = flat + self.proj_out(mixed.transpose(2, 3).flatten(1, 2))
        shaped: Tensor = total.reshape(x.shape)
        return shaped


def _resized(x: Tensor, scale: float) -> Tensor:
    if scale < 1:
        return functional.avg_pool2d(x, 2)
    return functional.interpolate(x, scale_factor=scale, mode="nearest") if scale > 1 else x
