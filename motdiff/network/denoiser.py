"""Diffusion network: an asymmetric denoiser of path maps, on a condition of the photo."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from motdiff.network.condition import ConditionNetwork
from motdiff.network.config import NetworkConfig
from motdiff.network.unet import GridUNet, silence
from motdiff.psf_frame import MAP_PITCH

_PATH_SHARE = 0.01  # of a map's pixels lie on the path: the output starts from this probability


class Denoiser(nn.Module):
    """Noisy map, timestep and condition to logits of the path map.

    Encoding block: 7x7 convolution with stride 4 + ReLU, ResNet block (3x3, batch norm), 3x3
    convolution + ReLU. The condition is concatenated. Mid layer: 1x1 convolution + ReLU. Two
    decoding blocks: PixelShuffle x2, 3x3 convolution + ReLU. Output: dropout, 1x1 convolution.
    There are no skip connections, so that the noisy map's fine grain cannot leak into the
    estimate.

    The paper does not say how the timestep enters. Here: sinusoidal embedding -> two-layer network
    -> a scale and a shift of each channel, after the ResNet block's first batch norm and on the
    mid layer before its ReLU.

    Its receptive field is about 16 map pixels, so it cannot decide for one path where the
    condition allows several. With `denoiser_view` a U-Net with attention over the whole map, whose
    output is 0 at first, is added to the mid layer. The paper has none.

    Parameters
    ----------
    condition_channels : int
        Channels of the condition.
    config : NetworkConfig
        Sizes. Of target "psf" the maps lie on the condition's own grid, without stride and
        PixelShuffle. With a view the condition must be 64x64.

    Attributes
    ----------
    pitch : int
        Map pixels per condition pixel: 4 for HR maps, 1 for PSFs.

    References
    ----------
    Choi et al., "MoTDiff", arXiv 2510.26173, equation 5 and "Simple diffusion denoiser
    architecture".
    """

    def __init__(self, condition_channels: int, config: NetworkConfig) -> None:
        super().__init__()
        width = config.denoiser_width
        wide, narrow = config.decoder_widths
        self.pitch = MAP_PITCH
        grow = 2  # of each decoding block
        if config.target == "psf":
            self.pitch = grow = 1
        self.time = _TimeNetwork(config.time_width)
        self.enter = nn.Conv2d(1, width, 7, self.pitch, 3)
        self.residual = _ResidualBlock(width, config.time_width)
        self.leave = nn.Conv2d(width, width, 3, 1, 1)
        self.mid = nn.Conv2d(width + condition_channels, width, 1)
        self.mid_modulation = _Modulation(config.time_width, width)
        self.view: GridUNet | None = None
        if config.denoiser_view:
            self.view = GridUNet(width, width, config.denoiser_view, patch=4)
            silence(self.view.out[-1])
        self.decode = nn.Sequential(
            nn.PixelShuffle(grow),
            nn.Conv2d(width // grow**2, wide, 3, 1, 1),
            nn.ReLU(),
            nn.PixelShuffle(grow),
            nn.Conv2d(wide // grow**2, narrow, 3, 1, 1),
            nn.ReLU(),
        )
        self.output = nn.Sequential(
            nn.Dropout(config.dropout), _output_layer(narrow, 1 + config.dwell)
        )

    def forward(self, x_t: Tensor, t: Tensor, condition: Tensor) -> Tensor:
        """Logits (B, 1 or 2, H, W) of x0 (and of dwell).

        Parameters
        ----------
        x_t : (B, 1, H, W) float
            Noisy map.
        t : (B,) int64
            Timestep, 0..999.
        condition : (B, C, H / pitch, W / pitch) float
            Condition.
        """
        time = self.time(t)  # (B, time_width)
        # eq. 5: Enc(x_t, t) beside the condition, then Dec
        x = functional.relu(self.enter(x_t))  # (B, width, H/4, W/4)
        x = self.residual(x, time)
        x = functional.relu(self.leave(x))
        x = self.mid(torch.cat([x, condition], dim=1))
        x = self.mid_modulation(x, time)
        if self.view is not None:
            x = x + self.view(x)
        x = functional.relu(x)
        x = self.decode(x)  # (B, decoder_widths[1], H, W)
        logits: Tensor = self.output(x)
        return logits


class MotDiffNetwork(ConditionNetwork):
    """Logits of the path map (or the PSF) from photo, physics maps, noisy map and timestep.

    `condition` depends on the photo only: call it once, then `denoiser` at every step.

    Parameters
    ----------
    config : NetworkConfig
        Sizes; kept as `config`. Its target is "map" or "psf".

    Attributes
    ----------
    denoiser : Denoiser
        Network of every step.

    References
    ----------
    Choi et al., "MoTDiff: High-resolution motion trajectory estimation from a single blurred image
    using diffusion models", arXiv 2510.26173. The physics maps are ours.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.denoiser = Denoiser(self.condition_channels, config)

    def forward(
        self,
        x_t: Tensor,
        t: Tensor,
        photo: Tensor | None = None,
        physics: Tensor | None = None,
        corner: tuple[int, int] = (0, 0),
    ) -> Tensor:
        """`condition` and `denoiser` in one, for training: each photo has one timestep.

        An `x_t` smaller than the photo's map is a window of it, whose first pixel is the
        denoiser's `pitch` times `corner` (row, column).
        """
        condition = self.condition(photo, physics)
        rows, columns = (
            slice(c, c + n // self.denoiser.pitch)
            for c, n in zip(corner, x_t.shape[-2:], strict=True)
        )
        logits: Tensor = self.denoiser(x_t, t, condition[..., rows, columns])
        return logits


def timestep_embedding(t: Tensor, width: int) -> Tensor:
    """Cosines and sines (B, width) of timesteps (B,), of periods from 2 pi to 20000 pi.

    References
    ----------
    Vaswani et al., "Attention is all you need", 2017, section 3.5; Ho et al., DDPM, 2020, appendix
    B.
    """
    half = width // 2
    freq_rad = torch.exp(
        -math.log(10_000) / half * torch.arange(half, device=t.device, dtype=torch.float32)
    )
    angle = t.float()[:, None] * freq_rad  # (B, width / 2)
    return torch.cat([angle.cos(), angle.sin()], dim=1)


class _TimeNetwork(nn.Module):
    """Timestep (B,) to features (B, width)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.width = width
        self.first = nn.Linear(width, width)
        self.second = nn.Linear(width, width)

    def forward(self, t: Tensor) -> Tensor:
        waves = timestep_embedding(t, self.width).to(self.first.weight.dtype)
        return functional.silu(self.second(functional.silu(self.first(waves))))


class _Modulation(nn.Module):
    """Scale and shift of each channel by the time: x (1 + scale) + shift."""

    def __init__(self, time_width: int, channels: int) -> None:
        super().__init__()
        self.linear = nn.Linear(time_width, 2 * channels)
        # small at the start, so that the untrained time does not swamp the image
        nn.init.normal_(self.linear.weight, std=0.02)
        nn.init.zeros_(self.linear.bias)

    def forward(self, x: Tensor, time: Tensor) -> Tensor:
        scale, shift = self.linear(time)[:, :, None, None].chunk(2, dim=1)  # (B, C, 1, 1) each
        modulated: Tensor = x * (1 + scale) + shift
        return modulated


class _ResidualBlock(nn.Module):
    """ResNet's basic block with batch norm, modulated by the time; (B, C, h, w) -> the same."""

    def __init__(self, channels: int, time_width: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, 1, 1, bias=False)
        self.norm1 = nn.BatchNorm2d(channels)
        self.modulation = _Modulation(time_width, channels)
        self.conv2 = nn.Conv2d(channels, channels, 3, 1, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(channels)

    def forward(self, x: Tensor, time: Tensor) -> Tensor:
        hidden = functional.relu(self.modulation(self.norm1(self.conv1(x)), time))
        return functional.relu(x + self.norm2(self.conv2(hidden)))


def _output_layer(inputs: int, outputs: int) -> nn.Conv2d:
    """1x1 convolution whose first channel starts at the logit of the path's share of pixels."""
    layer = nn.Conv2d(inputs, outputs, 1)
    # from 0 the first steps of a training would only learn that paths are rare (Lin et al., focal
    # loss, 2017, section 4.1)
    bias = torch.zeros(outputs)
    bias[0] = math.log(_PATH_SHARE / (1 - _PATH_SHARE))
    layer.bias = nn.Parameter(bias)
    return layer
