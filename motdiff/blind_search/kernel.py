"""Blur kernel of one blind step: sparse non-negative least squares on gradients."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.blind_search.grids import fast_size, gradient_power, shifted

_SPECK_MASS = 0.1  # of the light; a stroke of the path has more
_SPARSITY_CAP = 0.3  # of the correlation's peak: above it no kernel would be left


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
    """Sparse non-negative kernel (B, size, size) that turns latent gradients into blurred ones.

    Minimises ``|L k - b|^2 + ridge |k|^2 + smoothness |grad k|^2 + 2 s sum(k)`` over ``k >= 0`` by
    accelerated projected gradients. ``s = sparsity * sigma * |L|`` scales with the noise that
    reaches the normal equations: ``sigma`` is the rms residual of a first fit and ``|L|^2`` the
    energy of the latent gradients.

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
    # linear, not circular, correlations
    frame = (fast_size(height + size), fast_size(width + size))
    spectra = [torch.fft.rfft2(gradient, s=frame) for gradient in (*latent, *blurred)]
    power = (spectra[0].abs().square() + spectra[1].abs().square()).sum(dim=1)
    cross = (spectra[0].conj() * spectra[2] + spectra[1].conj() * spectra[3]).sum(dim=1)
    Lb = _lags(torch.fft.irfft2(cross, s=frame), size // 2)  # right side of the normal equations
    # L^T L is Toeplitz in the kernel: a frame of twice the kernel's size does instead of the photo
    small = fast_size(2 * size - 1)
    lags = _lags(torch.fft.irfft2(power, s=frame), size - 1)
    corner = functional.pad(lags, (0, small - lags.shape[-1], 0, small - lags.shape[-2]))
    LL = torch.fft.rfft2(corner.roll((-(size - 1), -(size - 1)), (-2, -1))).real.clamp(min=0)
    A = LL + smoothness * gradient_power(small, small, Lb) + ridge

    def applied(response: Tensor, k: Tensor) -> Tensor:
        product: Tensor = torch.fft.irfft2(
            response * torch.fft.rfft2(k, s=(small, small)), s=(small, small)
        )
        return product[:, :size, :size]

    latent_energy = lags[:, size - 1, size - 1].clamp(min=1e-12)
    blurred_energy = (blurred[0].square() + blurred[1].square()).sum(dim=(1, 2, 3))
    variance = blurred_energy / (2 * crops * height * width)
    # over a bound of the eigenvalues: the descent converges
    step = 1 / A.amax(dim=(1, 2), keepdim=True)
    x = torch.full_like(Lb, 1 / size**2)  # even: the first fit must not prefer any place
    for steps in rounds:
        s = torch.minimum(
            sparsity * (variance * latent_energy).sqrt(), _SPARSITY_CAP * Lb.amax(dim=(1, 2))
        )
        target = Lb - s[:, None, None].clamp(min=0)
        y = x
        t = 1.0
        for _ in range(steps):  # FISTA with constant step, Beck and Teboulle, eq. 4.1 to 4.3
            x_next = (y - (applied(A, y) - target).mul_(step)).clamp_(min=0)
            t_next = (1 + math.sqrt(1 + 4 * t**2)) / 2
            y = (x_next - x).mul_((t - 1) / t_next).add_(x_next)
            x = x_next
            t = t_next
        residual = blurred_energy - (x * (2 * Lb - applied(LL, x))).sum(dim=(1, 2))
        variance = residual.clamp(min=0) / (2 * crops * height * width)
    return thresholded(x, below=keep_share)


def thresholded(kernel: Tensor, *, below: float) -> Tensor:
    """Kernels (B, k, k), sum 1, with 0 below the share ``below`` of their peak."""
    peak = kernel.amax(dim=(1, 2), keepdim=True)
    return _normalised(torch.where(kernel < below * peak, torch.zeros_like(kernel), kernel))


def without_specks(kernel: Tensor) -> Tensor:
    """Kernels (B, k, k), sum 1, without 8-connected components of less than 0.1 of the light."""
    batch, rows, columns = kernel.shape
    support = kernel[:, None] > 0
    label = torch.arange(1, rows * columns + 1, device=kernel.device, dtype=torch.float32)
    label = label.view(1, 1, rows, columns).expand(batch, 1, rows, columns) * support
    while True:  # spread the largest label through each component
        spread = functional.max_pool2d(label, 3, 1, 1) * support
        if torch.equal(spread, label):
            break
        label = spread
    index = label.view(batch, -1).long()
    mass = kernel.new_zeros(batch, rows * columns + 1).scatter_add(
        1, index, kernel.reshape(batch, -1)
    )
    component_mass = mass.gather(1, index).view(batch, rows, columns)
    # the heaviest one stays even where all are specks; label 0 is the background
    least_mass = mass[:, 1:].amax(dim=1)[:, None, None].clamp(max=_SPECK_MASS)
    return _normalised(torch.where(component_mass >= least_mass, kernel, torch.zeros_like(kernel)))


def centred(kernel: Tensor) -> Tensor:
    """Kernels (B, k, k), sum 1, moved by whole pixels: their centroid is the frame's centre."""
    return _normalised(shifted(kernel[:, None], -_off_centre_px(kernel))[:, 0])


def centred_together(kernel: Tensor) -> Tensor:
    """Kernels (B, k, k), sum 1, all moved alike: their mean's centroid is the frame's centre."""
    move = -_off_centre_px(kernel.mean(dim=0, keepdim=True)).expand(len(kernel), -1)
    return _normalised(shifted(kernel[:, None], move)[:, 0])


def _off_centre_px(kernel: Tensor) -> Tensor:
    """Whole pixels (B, 2), down and right, of each centroid from the frame's centre."""
    _, rows, columns = kernel.shape
    total = kernel.sum(dim=(1, 2)).clamp(min=1e-12)
    y = torch.arange(rows, device=kernel.device)
    x = torch.arange(columns, device=kernel.device)
    down = torch.round((kernel.sum(dim=2) * y).sum(dim=1) / total).long() - rows // 2
    right = torch.round((kernel.sum(dim=1) * x).sum(dim=1) / total).long() - columns // 2
    return torch.stack([down, right], dim=1)


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
