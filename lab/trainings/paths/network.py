"""Denoiser of paths: a transformer over the points of a path, which sees the kernels where the
points lie.

A draw is an ordered, connected path: 64 points at equal times. The noise levels and the scaling of
inputs and outputs are those of Karras, Aittala, Aila, Laine, "Elucidating the design space of
diffusion-based generative models", NeurIPS 2022 (EDM), equation 7 and table 1.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from motdiff.network.unet import silence
from motdiff.psf_frame import PSF_PX

POINTS = 64
UNIT_PX = 8.0
"""Pixels per unit of the coordinates that are diffused."""
SIGMA_DATA = 0.8
MAPS = 4
"""Maps of a photo: the roots of three kernels, and that of a least-squares kernel, signed."""
_CENTRE = PSF_PX // 2
_PER_SEGMENT = 4  # dots of a rendered segment: a fast one is 1 to 2 px long
_GRID = 16  # side of the map that all points attend to
_HEAD_CHANNELS = 32
_RESIDUAL_PX = (1, 5, 13)  # sides of the squares over which unexplained light is averaged
_RESIDUAL_GAIN = 50.0  # light of a pixel, a fiftieth of all where a path is fast, to about 1
_WAVES = 6


def rendered(points: Tensor) -> Tensor:
    """PSFs (B, 64, 64) of paths (B, 64, 2) in px; what lies outside the frame is lost."""
    share = (torch.arange(_PER_SEGMENT, device=points.device) + 0.5) / _PER_SEGMENT
    segments = torch.lerp(points[:, :-1, None], points[:, 1:, None], share[:, None])
    dots = segments.flatten(1, 2) + _CENTRE
    corner = dots.floor()
    fraction = dots - corner
    psfs = points.new_zeros(len(points), PSF_PX**2)
    for right in (0, 1):
        for down in (0, 1):
            column, row = (corner + corner.new_tensor([right, down])).long().unbind(-1)
            weight = (fraction if right else 1 - fraction)[..., 0] * (
                fraction if down else 1 - fraction
            )[..., 1]
            within = (column >= 0) & (column < PSF_PX) & (row >= 0) & (row < PSF_PX)
            pixel = row.clamp(0, PSF_PX - 1) * PSF_PX + column.clamp(0, PSF_PX - 1)
            psfs = psfs.scatter_add(1, pixel, weight * within / dots.shape[1])
    return psfs.view(-1, PSF_PX, PSF_PX)


def at_points(maps: Tensor, points: Tensor) -> Tensor:
    """Values (B, N, C) of maps (B, C, H, W), which cover the PSF's frame, at points (B, N, 2)."""
    grid = 2 * (points + _CENTRE + 0.5) / PSF_PX - 1
    values = functional.grid_sample(maps, grid[:, :, None], align_corners=False)
    return values[..., 0].transpose(1, 2)


def waves(values: Tensor, count: int) -> Tensor:
    """Sines and cosines (..., 2 K count) of values (..., K), with periods of 64, 32, ..."""
    phases = values[..., None] * (2.0 ** torch.arange(count, device=values.device) * math.pi / 32)
    return torch.cat([phases.sin(), phases.cos()], dim=-1).flatten(-2)


@dataclass(frozen=True)
class Condition:
    """Features of the maps of B photos, on which the denoiser is conditioned.

    Attributes
    ----------
    features : three tensors (B, C, H, W)
        Of the U-Net, at 64, 32 and 16 px.
    summary : (B, D)
    kernel : (B, 64, 64)
        Mean of the kernels, sum 1.
    """

    features: tuple[Tensor, Tensor, Tensor]
    summary: Tensor
    kernel: Tensor


class PathDenoiser(nn.Module):
    """Denoised paths of noisy ones: ``D(x; sigma)`` of EDM.

    Parameters
    ----------
    channels : int
        Of the transformer, a multiple of 32.
    layers : int
    width : int
        Of the U-Net's finest level, a multiple of 8.
    """

    def __init__(self, channels: int = 160, layers: int = 6, width: int = 32) -> None:
        super().__init__()
        self.encoder = _Encoder(width)
        inputs = 6 * width + 4 * _WAVES + 2 + 5 * len(_RESIDUAL_PX)
        self.entry = nn.Linear(inputs, channels)
        self.times = nn.Parameter(0.02 * torch.randn(POINTS, channels))
        self.places = nn.Parameter(0.02 * torch.randn(_GRID**2, channels))
        self.grid = nn.Linear(3 * width + 2, channels)
        self.summary = nn.Linear(4 * width, channels)
        self.level = nn.Sequential(
            nn.Linear(16, channels), nn.SiLU(), nn.Linear(channels, channels)
        )
        self.modulation = nn.Linear(channels, 6 * channels)
        self.layers = nn.ModuleList(
            [_Layer(channels, attends_to_grid=i % 2 == 0) for i in range(layers)]
        )
        self.norm = nn.LayerNorm(channels)
        self.out = nn.Linear(channels, 2)
        silence(self.modulation)
        silence(self.out)

    def condition(self, maps: Tensor) -> Condition:
        """Encode maps (B, 4, 64, 64) of photos once, for all noise levels and draws."""
        *features, coarse = self.encoder(maps)
        kernel = maps[:, :3].square().mean(dim=1)
        kernel = kernel / kernel.sum(dim=(1, 2), keepdim=True).clamp(min=1e-6)
        return Condition((*features,), self.summary(coarse.mean(dim=(2, 3))), kernel)

    def forward(self, x: Tensor, sigma: Tensor, condition: Condition) -> Tensor:
        """Denoise paths.

        Parameters
        ----------
        x : (B R, 64, 2), units of 8 px
            R noisy paths for each of the condition's B photos, one photo after another.
        sigma : (B R,)
            Noise levels.
        condition : Condition

        Returns
        -------
        (B R, 64, 2)
        """
        repeats = len(x) // len(condition.kernel)
        s = sigma[:, None, None]
        variance = s.square() + SIGMA_DATA**2
        c_skip = SIGMA_DATA**2 / variance
        c_out = s * SIGMA_DATA / variance.sqrt()
        c_in = 1 / variance.sqrt()
        # where points are expected under a prior of independent ones: far-off noise has no place
        points = UNIT_PX * c_skip * x
        psfs = rendered(points)
        kernels = condition.kernel.repeat_interleave(repeats, dim=0)
        by_photo = points.view(len(condition.kernel), -1, 2)
        inputs = [
            at_points(maps, by_photo).reshape(len(x), POINTS, -1) for maps in condition.features
        ]
        inputs += [_unexplained(kernels - psfs, points), waves(points, _WAVES), c_in * x]
        h = self.entry(torch.cat(inputs, dim=-1)) + self.times
        light = torch.stack([kernels, psfs], dim=1)
        light = functional.avg_pool2d(light, PSF_PX // _GRID).flatten(2).transpose(1, 2)
        places = condition.features[2].flatten(2).transpose(1, 2)
        places = places.repeat_interleave(repeats, dim=0)
        grid = self.grid(torch.cat([places, light * 800], dim=-1)) + self.places
        embedding = self.level(waves(8 * sigma.log()[:, None], 8))
        embedding = embedding + condition.summary.repeat_interleave(repeats, dim=0)
        modulation = self.modulation(embedding)
        for layer in self.layers:
            h = layer(h, grid, modulation)
        denoised: Tensor = c_skip * x + c_out * self.out(self.norm(h))
        return denoised


@torch.no_grad()
def draw(
    network: PathDenoiser,
    maps: Tensor,
    *,
    count: int,
    steps: int = 16,
    generator: torch.Generator,
    sigmas: tuple[float, float] = (5.0, 0.02),
) -> Tensor:
    """Draw paths (B, count, 64, 2), px, for photos with maps (B, 4, 64, 64): EDM's Euler steps.

    Parameters
    ----------
    network : PathDenoiser
        In eval mode.
    steps : int
    generator : torch.Generator
        On the device of ``maps``.
    sigmas : (float, float)
        First and smallest noise level; between them their fifth roots are even.
    """
    condition = network.condition(maps)
    first, smallest = (sigma ** (1 / 5) for sigma in sigmas)
    levels = torch.linspace(first, smallest, steps, device=maps.device) ** 5
    levels = torch.cat([levels, levels.new_zeros(1)])
    shape = (len(maps) * count, POINTS, 2)
    x = levels[0] * torch.randn(shape, generator=generator, device=maps.device)
    for sigma, smaller in itertools.pairwise(levels):
        denoised = network(x, sigma.expand(len(x)), condition)
        x = denoised + smaller / sigma * (x - denoised)
    return (UNIT_PX * x).view(len(maps), count, POINTS, 2)


def _unexplained(residual: Tensor, points: Tensor) -> Tensor:
    """Light (B, 64, 15) that the path lacks, or has too much, at its points and beside them."""
    steps = points.new_tensor([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    values = []
    for side in _RESIDUAL_PX:
        # the mean over a thin path falls with the side of the square, not with its area
        maps = side * functional.avg_pool2d(_RESIDUAL_GAIN * residual[:, None], side, 1, side // 2)
        places = points[:, :, None] + steps * max(1.0, side / 2)
        values.append(at_points(maps, places.flatten(1, 2)).reshape(len(points), POINTS, -1))
    return torch.cat(values, dim=-1)


class _Block(nn.Module):
    def __init__(self, channels: int, out: int, stride: int = 1) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, out, 3, stride, 1)
        self.second = nn.Conv2d(out, out, 3, 1, 1)
        self.first_norm = nn.GroupNorm(8, out)
        self.second_norm = nn.GroupNorm(8, out)
        self.skip = nn.Conv2d(channels, out, 1, stride)

    def forward(self, x: Tensor) -> Tensor:
        y = functional.silu(self.first_norm(self.first(x)))
        return functional.silu(self.skip(x) + self.second_norm(self.second(y)))


class _Encoder(nn.Module):
    """U-Net of the maps: features at 64, 32, 16 and 8 px, of 1, 2, 3 and 4 widths."""

    def __init__(self, width: int) -> None:
        super().__init__()
        sides = [width, 2 * width, 3 * width, 4 * width]
        self.down = nn.ModuleList(
            [
                _Block(MAPS, sides[0]),
                *(_Block(sides[i], sides[i + 1], stride=2) for i in range(3)),
            ]
        )
        self.middle = _Block(sides[3], sides[3])
        self.up = nn.ModuleList([_Block(sides[i] + sides[i + 1], sides[i]) for i in (2, 1, 0)])

    def forward(self, maps: Tensor) -> tuple[Tensor, ...]:
        levels = []
        for block in self.down:
            maps = block(maps)
            levels.append(maps)
        results = [self.middle(levels.pop())]
        for block in self.up:
            larger = functional.interpolate(results[0], scale_factor=2.0)
            results.insert(0, block(torch.cat([larger, levels.pop()], dim=1)))
        return tuple(results)


class _Layer(nn.Module):
    """Attention among the points, to the grid in every other layer, and a perceptron."""

    def __init__(self, channels: int, *, attends_to_grid: bool) -> None:
        super().__init__()
        self.heads = channels // _HEAD_CHANNELS
        self.qkv = nn.Linear(channels, 3 * channels)
        self.mixed = nn.Linear(channels, channels)
        self.grid_q = self.grid_kv = self.grid_mixed = None
        if attends_to_grid:
            self.grid_q = nn.Linear(channels, channels)
            self.grid_kv = nn.Linear(channels, 2 * channels)
            self.grid_mixed = nn.Linear(channels, channels)
        self.wide = nn.Linear(channels, 4 * channels)
        self.narrow = nn.Linear(4 * channels, channels)
        self.modulation = nn.Parameter(torch.zeros(6 * channels))
        self.apart = nn.Parameter(torch.zeros(self.heads, 2 * POINTS - 1))
        index = torch.arange(POINTS)
        self.lag: Tensor  # of two points in time, for the attention's bias
        self.register_buffer("lag", index[:, None] - index + POINTS - 1, persistent=False)

    def forward(self, x: Tensor, grid: Tensor, modulation: Tensor) -> Tensor:
        shift, scale, share, shift_wide, scale_wide, share_wide = (self.modulation + modulation)[
            :, None
        ].chunk(6, dim=-1)
        q, k, v = self.qkv(_normed(x) * (1 + scale) + shift).chunk(3, dim=-1)
        bias = self.apart[:, self.lag]
        x = x + (1 + share) * self.mixed(self._attended(q, k, v, bias=bias))
        if self.grid_q is not None and self.grid_kv is not None and self.grid_mixed is not None:
            k, v = self.grid_kv(grid).chunk(2, dim=-1)
            x = x + self.grid_mixed(self._attended(self.grid_q(_normed(x)), k, v))
        y = _normed(x) * (1 + scale_wide) + shift_wide
        result: Tensor = x + (1 + share_wide) * self.narrow(functional.gelu(self.wide(y)))
        return result

    def _attended(self, q: Tensor, k: Tensor, v: Tensor, bias: Tensor | None = None) -> Tensor:
        q, k, v = (t.view(*t.shape[:2], self.heads, -1).transpose(1, 2) for t in (q, k, v))
        # queries and keys of unit length, times 10: unbounded, their products exploded in bfloat16
        q, k = (functional.normalize(t, dim=-1) for t in (q, k))
        mask = None if bias is None else bias.to(v.dtype).expand(len(q), -1, -1, -1)
        mixed = functional.scaled_dot_product_attention(
            q.to(v.dtype), k.to(v.dtype), v, attn_mask=mask, scale=10.0
        )
        return mixed.transpose(1, 2).flatten(2)


def _normed(x: Tensor) -> Tensor:
    return functional.layer_norm(x, x.shape[-1:])
