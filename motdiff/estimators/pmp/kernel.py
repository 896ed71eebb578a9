"""The blur kernel of one blind step: sparse non-negative least squares on gradients; batched in
torch.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.estimators.pmp.grids import fast_size, gradient_power

_SPECK_MASS = 0.1
_SPARSITY_CAP = 0.3


def fit_kernel(
    latent: tuple[Tensor, Tensor],
    blurred: tuple[Tensor, Tensor],
    *,
    size: int,
    ridge: float,
    smoothness: float,
    sparsity: float,
    rounds: tuple[int, int],
    keep_share: float = 0.05,
) -> Tensor:
    r"""Kernel (B, size, size) that turns latent gradients into blurred ones: a sparse non-negative
    least squares.

    Minimises ``|L k - b|^2 + ridge |k|^2 + smoothness |grad k|^2 + 2 s sum(k)`` over ``k >= 0`` by
    accelerated projected gradients. ``s = sparsity * sigma * |L|`` scales with the noise that
    reaches the normal equations: ``sigma`` is the rms residual of a first fit and ``|L|^2`` the
    energy of the latent gradients. The normal equations are Toeplitz in the kernel, so they run on
    a frame of twice the kernel's size instead of the photo's.

    Parameters
    ----------
    latent, blurred : pairs of (B, C, H, W) float
        Horizontal and vertical differences of C crops that share one kernel.
    size : int
        Odd side of the kernel, px.
    ridge, smoothness : float
        Weights of the kernel's squared values and of its squared differences.
    sparsity : float
        Weight of its sum, in standard deviations of the noise.
    rounds : (int, int)
        Steps of the descent in the first fit, which measures the residual, and in the second.
    keep_share : float
        Values below this share of the peak are dropped.

    References
    ----------
    Cho and Lee, "Fast motion deblurring", SIGGRAPH Asia 2009, section 4 (least squares on
    gradients); Beck and Teboulle, SIAM J. Imaging Sciences 2009 (the descent). Non-negativity and
    the noise-scaled sparsity are ours.
    """
    _, crops, height, width = latent[0].shape
    frame = (fast_size(height + size), fast_size(width + size))
    spectra = [torch.fft.rfft2(gradient, s=frame) for gradient in (*latent, *blurred)]
    power = (spectra[0].abs().square() + spectra[1].abs().square()).sum(dim=1)
    cross = (spectra[0].conj() * spectra[2] + spectra[1].conj() * spectra[3]).sum(dim=1)
    right = _lags(torch.fft.irfft2(cross, s=frame), size // 2)
    small = fast_size(2 * size - 1)
    lags = _lags(torch.fft.irfft2(power, s=frame), size - 1)
    corner = functional.pad(lags, (0, small - lags.shape[-1], 0, small - lags.shape[-2]))
    data = torch.fft.rfft2(corner.roll((-(size - 1), -(size - 1)), (-2, -1))).real.clamp(min=0)
    transfer = data + smoothness * gradient_power(small, small, right) + ridge

    def applied(response: Tensor, x: Tensor) -> Tensor:
        product: Tensor = torch.fft.irfft2(
            response * torch.fft.rfft2(x, s=(small, small)), s=(small, small)
        )
        return product[:, :size, :size]

    latent_energy = lags[:, size - 1, size - 1].clamp(min=1e-12)
    blurred_energy = (blurred[0].square() + blurred[1].square()).sum(dim=(1, 2, 3))
    variance = blurred_energy / (2 * crops * height * width)
    step = 1 / transfer.amax(dim=(1, 2), keepdim=True)
    kernel = torch.full_like(right, 1 / size**2)
    for steps in rounds:
        level = torch.minimum(
            sparsity * (variance * latent_energy).sqrt(), _SPARSITY_CAP * right.amax(dim=(1, 2))
        )
        target = right - level[:, None, None].clamp(min=0)
        ahead = kernel
        momentum = 1.0
        for _ in range(steps):
            descended = (ahead - (applied(transfer, ahead) - target).mul_(step)).clamp_(min=0)
            following = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            ahead = (descended - kernel).mul_((momentum - 1) / following).add_(descended)
            kernel = descended
            momentum = following
        misfit = blurred_energy - (kernel * (2 * right - applied(data, kernel))).sum(dim=(1, 2))
        variance = misfit.clamp(min=0) / (2 * crops * height * width)
    return without_faint_light(kernel, below=keep_share)


def without_faint_light(kernel: Tensor, *, below: float) -> Tensor:
    """Kernels (B, k, k) with 0 wherever they lie below the share ``below`` of their peak; sum
    1.
    """
    peak = kernel.amax(dim=(1, 2), keepdim=True)
    return _normalised(torch.where(kernel < below * peak, torch.zeros_like(kernel), kernel))


def without_specks(kernel: Tensor) -> Tensor:
    """Kernels (B, k, k) without connected parts (8 neighbours) that hold less than a tenth of the
    light; sum 1.
    """
    batch, rows, columns = kernel.shape
    lit = kernel > 0
    label = torch.arange(1, rows * columns + 1, device=kernel.device, dtype=torch.float32).view(
        1, 1, rows, columns
    )
    label = label.expand(batch, 1, rows, columns) * lit[:, None]
    while True:  # spread the largest label through each part; its length in px bounds the rounds
        spread = functional.max_pool2d(label, 3, 1, 1) * lit[:, None]
        if torch.equal(spread, label):
            break
        label = spread
    index = label.view(batch, -1).long()
    mass = kernel.new_zeros(batch, rows * columns + 1).scatter_add(
        1, index, kernel.reshape(batch, -1)
    )
    mine = mass.gather(1, index).view(batch, rows, columns)
    largest = mass[:, 1:].amax(dim=1)[:, None, None].clamp(max=_SPECK_MASS)
    return _normalised(torch.where(mine >= largest, kernel, torch.zeros_like(kernel)))


def centred(kernel: Tensor) -> Tensor:
    """Kernels (B, k, k) moved by whole pixels so that the centroid is at the frame's centre; sum
    1.
    """
    batch, rows, columns = kernel.shape
    total = kernel.sum(dim=(1, 2)).clamp(min=1e-12)
    y = torch.arange(rows, device=kernel.device)
    x = torch.arange(columns, device=kernel.device)
    down = torch.round((kernel.sum(dim=2) * y).sum(dim=1) / total).long() - rows // 2
    right = torch.round((kernel.sum(dim=1) * x).sum(dim=1) / total).long() - columns // 2
    row = y[None, :] + down[:, None]
    column = x[None, :] + right[:, None]
    inside = ((row >= 0) & (row < rows))[:, :, None] & ((column >= 0) & (column < columns))[
        :, None, :
    ]
    row_index = row.clamp(0, rows - 1)[:, :, None].expand(batch, rows, columns)
    column_index = column.clamp(0, columns - 1)[:, None, :].expand(batch, rows, columns)
    return _normalised(kernel.gather(1, row_index).gather(2, column_index) * inside)


def _lags(correlation: Tensor, reach: int) -> Tensor:
    """Correlation at lags -reach..reach on both axes, (B, 2 reach + 1, 2 reach + 1)."""
    rolled = correlation.roll((reach, reach), (-2, -1))
    return rolled[:, : 2 * reach + 1, : 2 * reach + 1]


def _normalised(kernel: Tensor) -> Tensor:
    """Sum 1; a kernel without light becomes a point."""
    point = torch.zeros_like(kernel)
    point[:, kernel.shape[1] // 2, kernel.shape[2] // 2] = 1
    kernel = torch.where(kernel.sum(dim=(1, 2), keepdim=True) > 0, kernel, point)
    return kernel / kernel.sum(dim=(1, 2), keepdim=True).clamp(min=1e-12)
