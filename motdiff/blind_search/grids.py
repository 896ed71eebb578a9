"""Grids and frames of kernels and photos: pyramids, periodic borders, OTFs, shifts, symmetries."""

from __future__ import annotations

import math

import torch
from scipy import fft
from torch import Tensor
from torch.nn import functional

SYMMETRIES = 8  # of the square
QUARTER_TURNS = (0, 3, 5, 6)  # those of them without a reflection


def fast_size(size: int) -> int:
    """Smallest even length >= ``size`` without prime factors above 5: quick Fourier transforms."""
    # SciPy's lengths for real transforms are those, but for the odd ones
    return 2 * int(fft.next_fast_len(-(-size // 2), real=True))


def gradient_power(height: int, width: int, template: Tensor) -> Tensor:
    """Half-plane power response (H, W // 2 + 1) of the two periodic first differences together."""
    fy = torch.arange(height, device=template.device, dtype=template.dtype) / height
    fx = torch.arange(width // 2 + 1, device=template.device, dtype=template.dtype) / width
    power: Tensor = 4 * (
        torch.sin(torch.pi * fy).square()[:, None] + torch.sin(torch.pi * fx).square()[None, :]
    )
    return power


def psf_to_otf(kernel: Tensor, shape: tuple[int, int]) -> Tensor:
    """Half-plane OTF (B, H, W // 2 + 1) of kernels (B, k, k), zero displacement at ``k // 2``."""
    rows, columns = kernel.shape[-2:]
    padded = functional.pad(kernel, (0, shape[1] - columns, 0, shape[0] - rows))
    otf: Tensor = torch.fft.rfft2(padded.roll((-(rows // 2), -(columns // 2)), (-2, -1)))
    return otf


def downsampled(photo: Tensor, factor: float) -> Tensor:
    """Shrink photos (B, H, W) by ``factor`` <= 1, with a Gaussian against aliasing."""
    if factor == 1:
        return photo
    sigma = 1 / (2 * factor)  # half a pixel of the small photo
    radius = math.ceil(1.7 * sigma)  # beyond, the Gaussian is below a quarter of its peak
    offsets = torch.arange(-radius, radius + 1, device=photo.device, dtype=photo.dtype)
    weights = torch.exp(-0.5 * (offsets / sigma).square())
    weights = weights / weights.sum()
    smooth = functional.conv2d(photo[:, None], weights[None, None, :, None])
    smooth = functional.conv2d(smooth, weights[None, None, None, :])
    rows, columns = (math.floor((n - 1) * factor) + 1 for n in smooth.shape[-2:])
    return _sampled(smooth, rows, columns, 1 / factor, 0.0, 0.0, "bilinear")[:, 0]


def resized_kernel(kernel: Tensor, factor: float, size: int) -> Tensor:
    """Enlarge kernels (B, k, k) by ``factor`` into a centred frame of ``size`` px; sum 1."""
    offset = kernel.shape[-1] // 2 - (size // 2) / factor
    grown = _sampled(kernel[:, None], size, size, 1 / factor, offset, offset, "bicubic")[:, 0]
    grown = grown.clamp(min=0)
    return grown / grown.sum(dim=(1, 2), keepdim=True).clamp(min=1e-12)


def shifted(maps: Tensor, shift: Tensor) -> Tensor:
    """Shift maps (B, C, H, W) by whole pixels (B, 2), down and right, with 0 at the borders."""
    batch, channels, height, width = maps.shape
    row = torch.arange(height, device=maps.device)[None, :] - shift[:, :1]
    column = torch.arange(width, device=maps.device)[None, :] - shift[:, 1:]
    rows_inside = ((row >= 0) & (row < height))[:, None, :, None]
    inside = rows_inside & ((column >= 0) & (column < width))[:, None, None, :]
    rows = row.clamp(0, height - 1)[:, None, :, None].expand(batch, channels, height, width)
    columns = column.clamp(0, width - 1)[:, None, None, :].expand(batch, channels, height, width)
    out: Tensor = maps.gather(2, rows).gather(3, columns) * inside
    return out


def mirrored(maps: Tensor, symmetry: int, *, pitch: int) -> Tensor:
    """Turn or mirror maps (B, C, H, W) about the zero displacement by a symmetry of the square.

    The zero lies at index ``H // 2`` of a PSF's grid and at ``129.5`` of the HR map, half a PSF
    pixel off the array's middle: a flipped axis must be moved by one PSF pixel.

    Parameters
    ----------
    maps : (B, C, H, W)
    symmetry : int, 0..7
        1: rows flipped; 2: columns flipped; 4: transposed; added up.
    pitch : int
        Map pixels per PSF pixel: 1 for PSFs and physics maps, 4 for HR maps; 0 for photos, which
        have no centre.
    """
    if symmetry & 1:
        maps = maps.flip(2).roll(pitch, 2)
    if symmetry & 2:
        maps = maps.flip(3).roll(pitch, 3)
    return maps.transpose(2, 3) if symmetry & 4 else maps


def inverse_symmetry(symmetry: int) -> int:
    """Symmetry that undoes ``symmetry`` of :func:`mirrored`."""
    if symmetry < 4:
        return symmetry
    return 4 + 2 * (symmetry & 1) + (symmetry >> 1 & 1)  # transposed, the two flips change places


def periodic_extension(photo: Tensor, shape: tuple[int, int]) -> Tensor:
    """Extend photos (B, H, W) to ``shape`` by harmonic strips that join opposite edges.

    References
    ----------
    Liu and Jia, "Reducing boundary artifacts in image deconvolution", ICIP 2008 (here with
    first-order smoothness).
    """
    batch, height, width = photo.shape
    out = photo.new_zeros(batch, *shape)
    out[:, :height, :width] = photo
    below = shape[0] - height
    beside = shape[1] - width
    if below > 0:
        out[:, height:, :width] = _joining_strip(photo[:, -1, :], photo[:, 0, :], below)
    if beside > 0:
        strip = _joining_strip(photo[:, :, -1], photo[:, :, 0], beside)
        out[:, :height, width:] = strip.transpose(1, 2)
    if below > 0 and beside > 0:
        frame = photo.new_zeros(batch, below + 2, beside + 2)
        frame[:, 0, 1:-1], frame[:, -1, 1:-1] = out[:, height - 1, width:], out[:, 0, width:]
        frame[:, 1:-1, 0], frame[:, 1:-1, -1] = out[:, height:, width - 1], out[:, height:, 0]
        out[:, height:, width:] = _harmonic(frame)
    return out


def _joining_strip(first: Tensor, last: Tensor, thickness: int) -> Tensor:
    """Harmonic strip (B, thickness, W) between two edges (B, W), its short sides linear."""
    frame = first.new_zeros(first.shape[0], thickness + 2, first.shape[1])
    ramp = torch.linspace(0, 1, thickness + 2, device=first.device, dtype=first.dtype)
    ramp = ramp[None, :, None]
    frame[:] = first[:, None, :] * (1 - ramp) + last[:, None, :] * ramp
    frame[:, 1:-1, 1:-1] = _harmonic(frame)
    return frame[:, 1:-1, :]


def _harmonic(frame: Tensor) -> Tensor:
    """Interior (B, m, n) of the harmonic function with the border of frames (B, m + 2, n + 2)."""
    rows = frame.shape[1] - 2
    columns = frame.shape[2] - 2
    source = frame.new_zeros(frame.shape[0], rows, columns)
    source[:, 0, :] += frame[:, 0, 1:-1]
    source[:, -1, :] += frame[:, -1, 1:-1]
    source[:, :, 0] += frame[:, 1:-1, 0]
    source[:, :, -1] += frame[:, 1:-1, -1]
    # the sine transform diagonalises the Laplacian: a direct solution instead of sweeps
    (sine_r, lambda_r), (sine_c, lambda_c) = (_sine_basis(n, frame) for n in (rows, columns))
    spectrum = sine_r @ source @ sine_c / (lambda_r[:, None] + lambda_c[None, :])
    return sine_r @ spectrum @ sine_c


def _sine_basis(size: int, template: Tensor) -> tuple[Tensor, Tensor]:
    """Orthonormal sine basis of the Dirichlet Laplacian and its eigenvalues."""
    index = torch.arange(1, size + 1, device=template.device, dtype=template.dtype)
    angle = torch.pi / (size + 1)
    basis = math.sqrt(2 / (size + 1)) * torch.sin(angle * index[:, None] * index[None, :])
    return basis, 2 - 2 * torch.cos(angle * index)


def _sampled(
    stack: Tensor, rows: int, columns: int, pitch: float, row0: float, column0: float, mode: str
) -> Tensor:
    """Sample (B, 1, H, W) at ``start + pitch i`` in pixel indices, zero outside."""
    height, width = stack.shape[-2:]
    y = row0 + pitch * torch.arange(rows, device=stack.device, dtype=stack.dtype)
    x = column0 + pitch * torch.arange(columns, device=stack.device, dtype=stack.dtype)
    across = (2 * x / max(width - 1, 1) - 1)[None, :].expand(rows, columns)
    down = (2 * y / max(height - 1, 1) - 1)[:, None].expand(rows, columns)
    grid = torch.stack((across, down), dim=-1)
    grid = grid[None].expand(stack.shape[0], -1, -1, -1)
    return functional.grid_sample(stack, grid, mode=mode, padding_mode="zeros", align_corners=True)
