"""The blur kernel of one blind step: regularised least squares on gradients, cleaned; batched in torch."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.estimators.pmp.grids import fast_size

__all__ = ["centred", "fit_kernel", "without_specks"]

_RIDGE = 2.0
_CG_STEPS = 20
_CG_TOLERANCE = 1e-5
_SMALL_SHARE = 0.05
_SPECK_MASS = 0.1


def fit_kernel(
    latent: tuple[Tensor, Tensor], blurred: tuple[Tensor, Tensor], *, size: int, ridge: float = _RIDGE
) -> Tensor:
    """Kernel (B, size, size) that turns latent gradients into blurred ones: least squares with a ridge, then cleaned.

    The normal equations are Toeplitz in the kernel, so the conjugate gradients run on a frame of twice the kernel's
    size instead of the photo's.

    Parameters
    ----------
    latent, blurred : pairs of (B, H, W) float
        Horizontal and vertical differences.
    size : int
        Odd side of the kernel, px.
    ridge : float
        Weight of the kernel's squared norm, in units of squared gradients.

    References
    ----------
    Cho and Lee, "Fast motion deblurring", SIGGRAPH Asia 2009, section 4.
    """
    height, width = latent[0].shape[-2:]
    frame = (fast_size(height + size), fast_size(width + size))
    spectra = [torch.fft.rfft2(gradient, s=frame) for gradient in (*latent, *blurred)]
    power = spectra[0].abs().square() + spectra[1].abs().square()
    cross = spectra[0].conj() * spectra[2] + spectra[1].conj() * spectra[3]
    right = _lags(torch.fft.irfft2(cross, s=frame), size // 2)
    small = fast_size(2 * size - 1)
    lags = _lags(torch.fft.irfft2(power, s=frame), size - 1)
    corner = functional.pad(lags, (0, small - lags.shape[-1], 0, small - lags.shape[-2]))
    transfer = torch.fft.rfft2(corner.roll((-(size - 1), -(size - 1)), (-2, -1))).real

    def normal(x: Tensor) -> Tensor:
        product = torch.fft.irfft2(transfer * torch.fft.rfft2(x, s=(small, small)), s=(small, small))
        return product[:, :size, :size] + ridge * x

    kernel = torch.full_like(right, 1 / size**2)
    residual = right - normal(kernel)
    direction = residual
    energy = residual.square().sum(dim=(1, 2), keepdim=True)
    for _ in range(_CG_STEPS):
        applied = normal(direction)
        step = energy / (direction * applied).sum(dim=(1, 2), keepdim=True).clamp(min=1e-30)
        kernel = kernel + step * direction
        residual = residual - step * applied
        lower = residual.square().sum(dim=(1, 2), keepdim=True)
        if bool((lower.sqrt() < _CG_TOLERANCE).all()):
            break
        direction = residual + lower / energy.clamp(min=1e-30) * direction
        energy = lower
    peak = kernel.amax(dim=(1, 2), keepdim=True)
    return _normalised(torch.where(kernel < _SMALL_SHARE * peak, torch.zeros_like(kernel), kernel))


def without_specks(kernel: Tensor) -> Tensor:
    """Kernels (B, k, k) without connected parts (8 neighbours) that hold less than a tenth of the light; sum 1."""
    batch, rows, columns = kernel.shape
    lit = kernel > 0
    label = torch.arange(1, rows * columns + 1, device=kernel.device, dtype=torch.float32).view(1, 1, rows, columns)
    label = label.expand(batch, 1, rows, columns) * lit[:, None]
    while True:  # spread the largest label through each part; its length in px bounds the rounds
        spread = functional.max_pool2d(label, 3, 1, 1) * lit[:, None]
        if torch.equal(spread, label):
            break
        label = spread
    index = label.view(batch, -1).long()
    mass = kernel.new_zeros(batch, rows * columns + 1).scatter_add(1, index, kernel.reshape(batch, -1))
    mine = mass.gather(1, index).view(batch, rows, columns)
    largest = mass[:, 1:].amax(dim=1)[:, None, None].clamp(max=_SPECK_MASS)
    return _normalised(torch.where(mine >= largest, kernel, torch.zeros_like(kernel)))


def centred(kernel: Tensor) -> Tensor:
    """Kernels (B, k, k) moved by whole pixels so that the centroid is at the frame's centre; sum 1."""
    batch, rows, columns = kernel.shape
    total = kernel.sum(dim=(1, 2)).clamp(min=1e-12)
    y = torch.arange(rows, device=kernel.device)
    x = torch.arange(columns, device=kernel.device)
    down = torch.round((kernel.sum(dim=2) * y).sum(dim=1) / total).long() - rows // 2
    right = torch.round((kernel.sum(dim=1) * x).sum(dim=1) / total).long() - columns // 2
    row, column = y[None, :] + down[:, None], x[None, :] + right[:, None]
    inside = ((row >= 0) & (row < rows))[:, :, None] & ((column >= 0) & (column < columns))[:, None, :]
    row_index = row.clamp(0, rows - 1)[:, :, None].expand(batch, rows, columns)
    column_index = column.clamp(0, columns - 1)[:, None, :].expand(batch, rows, columns)
    return _normalised(kernel.gather(1, row_index).gather(2, column_index) * inside)


def _lags(correlation: Tensor, reach: int) -> Tensor:
    """Correlation at lags -reach..reach on both axes, (B, 2 reach + 1, 2 reach + 1)."""
    rolled = correlation.roll((reach, reach), (-2, -1))
    return rolled[:, : 2 * reach + 1, : 2 * reach + 1]


def _normalised(kernel: Tensor) -> Tensor:
    return kernel / kernel.sum(dim=(1, 2), keepdim=True).clamp(min=1e-12)
