"""Simulation of blurred training photos, in batches on the training device.

:func:`motdiff.simulate.photograph` does one photo in numpy; the tests compare the two blurs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from motdiff.blind_search.grids import fast_size
from motdiff.simulate import border_px

# ITU-T T.81 (JPEG), Annex K, table K.1: luminance
_TABLE = (
    (16, 11, 10, 16, 24, 40, 51, 61),
    (12, 12, 14, 19, 26, 58, 60, 55),
    (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62),
    (18, 22, 37, 56, 68, 109, 103, 77),
    (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101),
    (72, 92, 95, 98, 112, 100, 103, 99),
)


@dataclass(frozen=True)
class Photography:
    """Distribution of borders, noise, gamma, exposure and JPEG of the simulated photos.

    Attributes
    ----------
    borders : {"real", "symmetric"}
        "real": light comes from beyond the frame. "symmetric": the scene is mirrored there, as the
        paper's.
    most_noise : float
        Largest standard deviation of the noise, full scale 1; small ones are likelier (most_noise
        times u squared).
    gammas : (float, float)
        Range of the exponent that turns display values into light; half of the photos have 1
        (values taken as light).
    wrong_gamma : float
        Share of photos whose light is decoded with a wrong exponent, so that the blur is not quite
        a convolution.
    gains : (float, float)
        Range of the exposure's factor; above 1 the lights are clipped.
    jpeg : float
        Share of photos that went through JPEG.
    qualities : (float, float)
        Range of its quality.
    """

    borders: str = "real"
    most_noise: float = 0.03
    gammas: tuple[float, float] = (1.4, 2.6)
    wrong_gamma: float = 0.2
    gains: tuple[float, float] = (0.6, 1.15)
    jpeg: float = 0.3
    qualities: tuple[float, float] = (60.0, 98.0)

    def __post_init__(self) -> None:
        if self.borders not in ("real", "symmetric"):
            raise ValueError(f'borders: must be "real" or "symmetric", got {self.borders!r}')
        if not 0 <= self.most_noise < 1:
            raise ValueError(f"most_noise: must lie within 0..1, got {self.most_noise}")

    @property
    def margin(self) -> int:
        """Pixels that the sharp crop must have more than the photo, for 64-px PSFs."""
        return border_px(self.borders)


def blurred(sharp: Tensor, psfs: Tensor) -> Tensor:
    """Blur ``sharp`` (..., H, W) with ``psfs`` (..., R, C), broadcast; differentiable.

    The blurred (..., H - R + 1, W - C + 1) are those of :func:`motdiff.simulate.blur_valid`.
    """
    (height, width), (rows, columns) = sharp.shape[-2:], psfs.shape[-2:]
    frame = (fast_size(height), fast_size(width))  # what wraps around is cut away
    product = torch.fft.rfft2(sharp, s=frame) * torch.fft.rfft2(psfs, s=frame)
    periodic: Tensor = torch.fft.irfft2(product, s=frame)
    return periodic[..., rows - 1 : height, columns - 1 : width]


def photographed(
    sharp: Tensor, psfs: Tensor, *, photography: Photography, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Simulate the photos of sharp crops taken by a moving camera.

    The crops (B, 3, H, W), display values 0..1, have ``photography.margin`` pixels more than the
    photo on both axes; the PSFs (B, 64, 64) sum to 1. All are float32 and on one device, as is the
    generator.

    Returns
    -------
    photos : (B, 3, h, w) float32, 0..1, light as the photographer decodes it
    sigma : (B,) float32, standard deviation of the noise
    """
    batch = sharp.shape[0]
    device = sharp.device

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(batch, generator=generator, device=device)

    def with_share(share: float) -> Tensor:
        return torch.rand(batch, generator=generator, device=device) < share

    ones = torch.ones(batch, device=device)
    gamma = torch.where(with_share(0.5), ones, uniform(*photography.gammas))
    per_photo = (slice(None), None, None, None)
    light = sharp ** gamma[per_photo] * uniform(*photography.gains)[per_photo]
    if photography.borders == "symmetric":
        light = _mirrored(light, psfs.shape[-1])
    sigma = photography.most_noise * torch.rand(batch, generator=generator, device=device).square()
    photo = blurred(light, psfs[:, None])
    noise = torch.randn(photo.shape, generator=generator, device=device)
    photo = photo + sigma[per_photo] * noise
    # a camera compresses and rounds display values, not light
    display = photo.clamp(0, 1) ** (1 / gamma[per_photo])
    lossy = jpeg_loss(display, uniform(*photography.qualities))
    compressed = with_share(photography.jpeg)[per_photo]
    display = torch.where(compressed, lossy, (255 * display).round() / 255)
    gamma_error = torch.where(with_share(photography.wrong_gamma), uniform(0.7, 1.4), ones)
    return display ** (gamma * gamma_error)[per_photo], sigma


def _mirrored(light: Tensor, size: int) -> Tensor:
    """Mirror beyond the borders, the edge pixel repeated, by what a PSF of ``size`` px reaches."""
    before = size - 1 - size // 2
    after = size // 2
    for axis in (2, 3):
        first = light.narrow(axis, 0, before).flip(axis)
        last = light.narrow(axis, light.shape[axis] - after, after).flip(axis)
        light = torch.cat([first, light, last], dim=axis)
    return light


def jpeg_loss(photos: Tensor, quality: Tensor) -> Tensor:
    """Compress and decompress every channel with the luminance table, not rounded to 8 bits.

    The photos (B, C, H, W) are display values 0..1, H and W multiples of 8; the quality (B,),
    1..100, is that of the Independent JPEG Group's library.
    """
    batch, channels, height, width = photos.shape
    cosine = _cosine_matrix(photos)
    table = torch.tensor(_TABLE, dtype=photos.dtype, device=photos.device)
    clamped = quality.clamp(1, 100)
    scale = torch.where(clamped < 50, 50 / clamped, 2 - clamped / 50)[:, None, None]
    # the Independent JPEG Group's jpeg_quality_scaling: 50 is the table itself
    steps = (table * scale + 0.5).floor().clamp(1, 255)[:, None, None, None]  # (B, 1, 1, 1, 8, 8)
    levels = 255 * photos - 128
    blocks = levels.view(batch, channels, height // 8, 8, width // 8, 8).transpose(3, 4)
    spectrum = cosine @ blocks @ cosine.T
    restored = cosine.T @ ((spectrum / steps).round() * steps) @ cosine
    image = (restored.transpose(3, 4).reshape(batch, channels, height, width) + 128) / 255
    return image.clamp(0, 1)


def _cosine_matrix(template: Tensor) -> Tensor:
    """Orthonormal DCT-II, (8, 8)."""
    k = torch.arange(8, dtype=template.dtype, device=template.device)
    matrix = torch.cos(math.pi / 8 * k[:, None] * (k[None, :] + 0.5)) / 2
    matrix[0] /= math.sqrt(2)
    return matrix
