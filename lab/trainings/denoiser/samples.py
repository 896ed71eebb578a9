"""Training samples of the denoiser: crops of sharp photos in linear light, with white noise or
blurred along random motions through random codes.

All tensors are made on the photos' device.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from motdiff.psf_frame import PSF_PX

SIGMAS = (1e-3, 0.3)
"""Least and largest standard deviation of white noise, full scale 1; log-evenly spread between."""
BLURRED_SIGMAS = (1e-3, 0.12)
"""The same of a blurred photo, at the scale of the full open exposure."""

_LUMINANCE = (0.2126, 0.7152, 0.0722)
_GAINS = (0.3, 1.0)  # exposure of a crop
_TIMES = 1024  # of a path: 0.06 px apart on the longest
_ALONG_ANOTHER = 0.25  # share of the photos that are restored along a path not quite theirs
_ERROR_PX = (0.05, 0.5)
_ERROR_MODES = 4
_OPEN, _SNAPSHOT = 0.3, 0.2  # shares; the others are coded
_CHIPS = (20, 80)


@dataclass(frozen=True)
class Photos:
    """Sharp photos in one tensor, so that crops of all of them are cut at once.

    Attributes
    ----------
    pixels : (3, P) uint8, display values, one photo after another
    starts, heights, widths : (N,) int64
    """

    pixels: Tensor
    starts: Tensor
    heights: Tensor
    widths: Tensor

    @classmethod
    def joined(cls, photos: Sequence[Tensor]) -> Photos:
        """Join photos, each (3, H, W) uint8."""
        device = photos[0].device
        shapes = torch.tensor([photo.shape[1:] for photo in photos], device=device)
        sizes = shapes.prod(dim=1)
        return cls(
            torch.cat([photo.flatten(1) for photo in photos], dim=1),
            sizes.cumsum(0) - sizes,
            shapes[:, 0],
            shapes[:, 1],
        )

    def crops(self, count: int, side_px: int, draw: torch.Generator) -> Tensor:
        """Cut (count, 3, side_px, side_px) float32 crops in linear light, turned and mirrored.

        Raises
        ------
        ValueError
            If a photo is smaller than the crops.
        """
        shortest = int(torch.minimum(self.heights, self.widths).min())
        if shortest < side_px:
            raise ValueError(
                f"photos: must be at least {side_px} px wide and high, got {shortest}"
            )
        device = self.pixels.device
        areas = (self.heights * self.widths).float()
        index = torch.multinomial(areas, count, replacement=True, generator=draw)
        corner = torch.rand(2, count, generator=draw, device=device)
        rows = (corner[0] * (self.heights[index] - side_px + 1)).long()
        columns = (corner[1] * (self.widths[index] - side_px + 1)).long()
        first = self.starts[index] + rows * self.widths[index] + columns
        lags = torch.arange(side_px, device=device)
        offsets = first[:, None, None] + lags[:, None] * self.widths[index][:, None, None] + lags
        display = self.pixels[:, offsets].transpose(0, 1).float() / 255
        for dims in ((3,), (2,)):
            flipped = torch.rand(count, 1, 1, 1, generator=draw, device=device) < 0.5
            display = torch.where(flipped, display.flip(dims), display)
        is_turned = torch.rand(count, 1, 1, 1, generator=draw, device=device) < 0.5
        display = torch.where(is_turned, display.transpose(2, 3), display)
        return torch.where(
            display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055).clamp(min=0) ** 2.4
        )


def scenes(photos: Photos, count: int, side_px: int, draw: torch.Generator) -> Tensor:
    """Draw scenes (count, 1, side_px, side_px) at random exposures: a photo's luminance, or one of
    its colours.
    """
    light = photos.crops(count, side_px, draw)
    device = light.device
    choice = torch.rand(count, generator=draw, device=device)
    colour = torch.eye(3, device=device)[(choice * 6).long().clamp(max=2)]
    by_eye = torch.tensor(_LUMINANCE, device=device).expand(count, 3)
    mix = torch.where((choice < 0.5)[:, None], colour, by_eye)
    gain = uniform(_GAINS, (count, 1, 1, 1), draw)
    return gain * (light * mix[:, :, None, None]).sum(dim=1, keepdim=True)


def levels(bounds: tuple[float, float], count: int, draw: torch.Generator) -> Tensor:
    """Draw noise levels (count,), log-evenly."""
    return uniform((math.log(bounds[0]), math.log(bounds[1])), (count,), draw).exp()


def white_noise(images: Tensor, sigma: Tensor, draw: torch.Generator) -> Tensor:
    """Draw white noise of levels (B,), of the shape (B, 1, H, W) of ``images``."""
    return column(sigma) * torch.randn(images.shape, generator=draw, device=images.device)


def psfs(paths: Tensor, count: int, draw: torch.Generator) -> tuple[Tensor, Tensor]:
    """Draw PSFs (count, 64, 64) of motions through codes, and those that are taken for them.

    Both sum to 1. Three quarters are the same; the others are along a path that is not quite the
    motion's, as an estimate is.

    Parameters
    ----------
    paths : (N, T, 2) float, px
    count : int
    """
    device = paths.device
    path = paths[torch.randint(len(paths), (count,), generator=draw, device=device)].float()
    path = torch.nn.functional.interpolate(
        path.transpose(1, 2), _TIMES, mode="linear", align_corners=True
    )
    path = path * uniform((0.25, 1.0), (count, 1, 1), draw)
    signs = torch.randint(2, (count, 2, 1), generator=draw, device=device) * 2 - 1
    path = path * signs
    is_turned = torch.rand(count, 1, 1, generator=draw, device=device) < 0.5
    path = torch.where(is_turned, path.flip(1), path)
    times = torch.linspace(0, 1, _TIMES, device=device)
    light = _codes(count, times, draw)
    modes = torch.arange(1, _ERROR_MODES + 1, device=device)
    waves = torch.cos(math.pi * modes[:, None] * times) / modes[:, None]
    error = torch.randn(count, 2, _ERROR_MODES, generator=draw, device=device) @ waves
    size = uniform(_ERROR_PX, (count, 1, 1), draw)
    is_other = torch.rand(count, 1, 1, generator=draw, device=device) < _ALONG_ANOTHER
    error = (
        error
        * (is_other * size)
        / error.square().sum(1, keepdim=True).mean(2, keepdim=True).sqrt()
    )
    return splatted(path, light), splatted(path + error, light)


def _codes(count: int, times: Tensor, draw: torch.Generator) -> Tensor:
    """Draw the light (count, T) of open shutters, snapshots and random codes."""
    device = times.device
    chips = torch.randint(*_CHIPS, (count, 1), generator=draw, device=device)
    open_share = uniform((0.3, 0.7), (count, 1), draw)
    bits = torch.rand(count, _CHIPS[1], generator=draw, device=device) < open_share
    bits[:, 0] = True
    coded = bits.gather(1, (times * chips).long().clamp(max=_CHIPS[1] - 1).minimum(chips - 1))
    length = uniform((0.03, 0.7), (count, 1), draw)
    begin = (1 - length) * torch.rand(count, 1, generator=draw, device=device)
    snapshot = (times >= begin) & (times <= begin + length)
    kind = torch.rand(count, 1, generator=draw, device=device)
    light = torch.where(kind < _OPEN + _SNAPSHOT, snapshot, coded)
    return torch.where(kind < _OPEN, torch.ones_like(light), light).float()


def splatted(path: Tensor, light: Tensor) -> Tensor:
    """Draw PSFs (B, 64, 64) of light (B, T) along paths (B, 2, T), bilinear, sum 1."""
    count = len(path)
    place = (path + PSF_PX // 2).clamp(0, PSF_PX - 1.001)
    corner = place.floor()
    share = place - corner
    psf = torch.zeros(count, PSF_PX**2, device=path.device)
    for down in (0, 1):
        for right in (0, 1):
            x = share[:, 0] if right else 1 - share[:, 0]
            y = share[:, 1] if down else 1 - share[:, 1]
            index = (corner[:, 1] + down) * PSF_PX + corner[:, 0] + right
            psf.scatter_add_(1, index.long(), light * x * y)
    return (psf / psf.sum(dim=1, keepdim=True)).view(count, PSF_PX, PSF_PX)


def otfs(kernels: Tensor, side_px: int) -> Tensor:
    """Transform PSFs (B, 64, 64) to OTFs (B, 1, side_px, side_px // 2 + 1)."""
    grid = torch.nn.functional.pad(kernels, (0, side_px - PSF_PX) * 2)
    H: Tensor = torch.fft.rfft2(grid.roll((-(PSF_PX // 2),) * 2, (1, 2)))[:, None]
    return H


def uniform(bounds: tuple[float, float], shape: tuple[int, ...], draw: torch.Generator) -> Tensor:
    """Draw evenly between two bounds, on the generator's device."""
    return bounds[0] + (bounds[1] - bounds[0]) * torch.rand(
        shape, generator=draw, device=draw.device
    )


def column(values: Tensor) -> Tensor:
    """Shape values (B,) as (B, 1, 1, 1)."""
    return values.view(-1, 1, 1, 1)
