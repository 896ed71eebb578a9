"""Denoiser of motion paths: what a diffusion model knows of how cameras move.

A path is described by the orthonormal discrete cosine transform of its positions at 64 equal
times: coefficients 1 to 63 of x and y, over its rms radius. Noise levels and the scaling of inputs
and outputs are those of Karras, Aittala, Aila, Laine, "Elucidating the design space of
diffusion-based generative models", NeurIPS 2022 (EDM), equation 7 and table 1.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from motdiff.network.unet import silence

POINTS = 64
SIGMA_DATA = 0.7
"""Standard deviation of a coordinate of a path with rms radius 1."""
_WIDTH = 256  # of the layers, as their number; the published weights have these sizes
_DEPTH = 4
_WAVES = 8
_TYPICAL_RADIUS_PX = 10.0


class PathDenoiser(nn.Module):
    """Expected paths beneath noisy ones.

    Attributes
    ----------
    variances : (63,) buffer
        Mean squares of the coefficients of the training's paths, the mean of both axes.
    """

    variances: Tensor

    def __init__(self) -> None:
        super().__init__()
        values = 2 * (POINTS - 1)
        self.first = nn.Linear(values, _WIDTH)
        self.condition = nn.Sequential(
            nn.Linear(4 * _WAVES + 1, _WIDTH // 2),
            nn.SiLU(),
            nn.Linear(_WIDTH // 2, _WIDTH),
            nn.SiLU(),
        )
        self.blocks = nn.ModuleList([_Block(_WIDTH) for _ in range(_DEPTH)])
        self.last = nn.Linear(_WIDTH, values)
        silence(self.last)
        self.register_buffer("variances", torch.ones(POINTS - 1))

    def forward(self, noisy: Tensor, sigma: Tensor, radius_px: Tensor) -> Tensor:
        """Denoise coefficients.

        Parameters
        ----------
        noisy : (B, 63, 2)
        sigma : (B,)
            Standard deviation of the noise in each coefficient.
        radius_px : (B,), px
            Rms radius of the paths: walks of 60 px are rougher than those of 10 px.
        """
        power = (sigma.square() + SIGMA_DATA**2)[:, None]
        flat = noisy.flatten(1)
        features = self.first(flat / power.sqrt())
        condition = self.condition(_described(sigma, radius_px))
        for block in self.blocks:
            features = block(features, condition)
        input_share = SIGMA_DATA**2 / power * flat
        change = SIGMA_DATA * sigma[:, None] / power.sqrt() * self.last(features)
        denoised: Tensor = (input_share + change).view_as(noisy)
        return denoised


class _Block(nn.Module):
    """Two layers beside an identity, scaled and shifted by the condition; 0 before training."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.widen = nn.Linear(width, 2 * width)
        self.narrow = nn.Linear(2 * width, width)
        self.modulate = nn.Linear(width, 2 * width)
        silence(self.narrow)
        silence(self.modulate)

    def forward(self, features: Tensor, condition: Tensor) -> Tensor:
        scale, shift = self.modulate(condition).chunk(2, dim=-1)
        wide = functional.silu(self.widen(self.norm(features) * (1 + scale) + shift))
        changed: Tensor = features + self.narrow(wide)
        return changed


def _described(sigma: Tensor, radius_px: Tensor) -> Tensor:
    """Waves (B, 33) of the logarithms of noise level and radius."""
    octaves = 2.0 ** torch.arange(_WAVES, device=sigma.device)
    level = sigma.log()[:, None] / 4 * octaves * (math.pi / 2)
    log_radius = (radius_px / _TYPICAL_RADIUS_PX).log()[:, None]
    size = log_radius * octaves
    return torch.cat([level.sin(), level.cos(), size.sin(), size.cos(), log_radius], dim=-1)
