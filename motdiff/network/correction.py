"""Correction of a kernel that a search found, by a network that sees what the photo tells of each
of its pixels.

A search ends with sparse non-negative kernels: faint parts of the path are cut with the noise. The
maps here hold the least-squares kernel before any constraint, and where the photo contradicts the
kernel; they lie on the kernel's own grid, where a small network learns which faint parts continue
a path.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from motdiff.estimators.pmp.blind import fine_latent
from motdiff.estimators.pmp.grids import fast_size, gradient_power, periodic_extension, psf_to_otf
from motdiff.estimators.pmp.kernel import without_faint_light
from motdiff.estimators.pmp.latent import salient_gradients
from motdiff.network.physics_maps import autocorrelation, lags, spectral_maps
from motdiff.network.sampling import DOUBT
from motdiff.network.symmetry import SYMMETRIES, inverse_symmetry, mirrored
from motdiff.network.unet import GridUNet, silence
from motdiff.psf_frame import PSF_PX

MAPS = 11
"""Maps of each kernel."""
_WIDTH = 48  # of the U-Net; dropout in training alone
_DEPTH = 2
_PATCH = 2
_DROPOUT = 0.1
_RIDGES = (0.03, 0.3, 3.0)  # of the least-squares kernels, in mean powers of the latent gradients
_WIENER_RIDGE = 0.3
_WIENER_PENALTY = 3e-4
_WIENER_PER_VARIANCE = 100.0
_LATENT_RANGE = (-0.5, 1.5)  # a restoration by a wrong kernel rings far beyond full scale


class CorrectionNetwork(nn.Module):
    """Maps (B, 11, 64, 64) of kernels to corrected kernels (B, 64, 64), over a peak of about 1,
    with small negatives.

    The kernel, which is the first map, plus what a U-Net on the 64 x 64 grid finds; nothing at
    first.
    """

    def __init__(self) -> None:
        super().__init__()
        self.unet = GridUNet(MAPS, _WIDTH, _DEPTH, _PATCH)
        self.dropout = nn.Dropout2d(_DROPOUT)
        self.out = nn.Conv2d(_WIDTH, 1, 1)
        silence(self.out)

    def forward(self, maps: Tensor) -> Tensor:
        """Correct the first of the maps (B, 11, 64, 64); ValueError for another shape."""
        change: Tensor = self.out(self.dropout(self.unet(maps)))
        return maps[:, 0] + change[:, 0]


def corrected(network: CorrectionNetwork, maps: Tensor) -> Tensor:
    """Mean of the corrections of all turned and mirrored maps.

    Parameters
    ----------
    network : CorrectionNetwork
        In eval mode.
    maps : (B, 11, 64, 64) float
        From :func:`correction_maps`.

    Returns
    -------
    (B, 64, 64) float: non-negative, sum 1, 0 below 2 % of the peak.
    """
    turned = torch.cat([mirrored(maps, symmetry, pitch=1) for symmetry in range(SYMMETRIES)])
    found = network(turned)[:, None].chunk(SYMMETRIES)
    turned_back = [
        mirrored(part, inverse_symmetry(symmetry), pitch=1) for symmetry, part in enumerate(found)
    ]
    return without_faint_light(torch.cat(turned_back, dim=1).mean(dim=1).clamp(min=0), below=DOUBT)


def correction_maps(crops: Tensor, kernels: Tensor, others: Tensor, *, sigma: float) -> Tensor:
    """Stack what crops of one photo tell of kernels found in them.

    Parameters
    ----------
    crops : (C, H, W) float32, grey, linear light
        They share one blur; sides of at least 64 px.
    kernels : (K, 64, 64) float32, sum 1
    others : (K, 2, 64, 64) float32, sum 1
        For each kernel, two others that were found, which may be like it; the same one twice where
        there are only two.
    sigma : float
        Standard deviation of the noise.

    Returns
    -------
    (K, 11, 64, 64) float32: the kernel and the two others; least-squares kernels of its latent
    photo, with three ridges, and of its Wiener restoration; the correlation of the latent
    gradients with what the kernel leaves of the photo's: positive where light is missing, negative
    where there is too much; each over its largest magnitude. Then autocorrelation and cepstrum of
    the photo, and the kernel's autocorrelation, at lags of -32..31 px.

    Raises
    ------
    ValueError
        If a side is shorter than 64 px.
    """
    spectral = spectral_maps(crops[None])
    blurred = salient_gradients(crops, crops.new_zeros(len(crops)))
    maps = torch.stack([_photo_maps(crops, blurred, kernel, sigma=sigma) for kernel in kernels])
    own = torch.cat([kernels[:, None], others, maps], dim=1)
    own = own / own.abs().amax(dim=(-2, -1), keepdim=True).clamp(min=1e-9)
    return torch.cat(
        [own, spectral.expand(len(kernels), -1, -1, -1), autocorrelation(kernels[:, None])], dim=1
    )


def _photo_maps(
    crops: Tensor, blurred: tuple[Tensor, Tensor], kernel: Tensor, *, sigma: float
) -> Tensor:
    """Least-squares kernels, and the correlation with the misfit, (5, 64, 64)."""
    count, height, width = crops.shape
    shape = (fast_size(height + PSF_PX - 1), fast_size(width + PSF_PX - 1))
    wrapped = periodic_extension(crops, shape)
    repeated = kernel.expand(count, -1, -1)
    latent = fine_latent(wrapped, repeated, sigma=sigma)
    latent, wiener = (
        photo[:, :height, :width].clamp(*_LATENT_RANGE)
        for photo in (latent, _wiener(wrapped, repeated, sigma))
    )
    frame = (fast_size(height - 1 + PSF_PX), fast_size(width - 1 + PSF_PX))
    seen = [torch.fft.rfft2(gradient, s=frame) for gradient in blurred]
    no_threshold = crops.new_zeros(count)
    spectra = [
        torch.fft.rfft2(gradient, s=frame) for gradient in salient_gradients(latent, no_threshold)
    ]
    of_wiener = [
        torch.fft.rfft2(gradient, s=frame) for gradient in salient_gradients(wiener, no_threshold)
    ]
    transfer = psf_to_otf(kernel[None], frame)
    missing = []
    for spectrum, other in zip(spectra, seen, strict=True):
        left = torch.fft.irfft2(other - spectrum * transfer, s=frame)[:, : height - 1, : width - 1]
        missing.append(torch.fft.rfft2(left, s=frame))
    correlation = lags(torch.fft.irfft2(_cross(spectra, missing)[None], s=frame))
    return torch.cat(
        [
            _least_squares(spectra, seen, _RIDGES, frame),
            _least_squares(of_wiener, seen, (_WIENER_RIDGE,), frame),
            correlation,
        ]
    )


def _wiener(wrapped: Tensor, kernels: Tensor, sigma: float) -> Tensor:
    """Restore periodic photos (C, H, W) with a penalty on squared gradients."""
    height, width = wrapped.shape[-2:]
    transfer = psf_to_otf(kernels, (height, width))
    penalty = _WIENER_PENALTY + _WIENER_PER_VARIANCE * sigma**2
    response = transfer.abs().square() + penalty * gradient_power(height, width, wrapped) + 1e-9
    restored: Tensor = torch.fft.irfft2(
        transfer.conj() * torch.fft.rfft2(wrapped) / response, s=(height, width)
    )
    return restored


def _least_squares(
    latent: list[Tensor], blurred: list[Tensor], ridges: tuple[float, ...], frame: tuple[int, int]
) -> Tensor:
    """Unconstrained kernels (R, 64, 64) that turn latent gradients into blurred ones, from their
    spectra.
    """
    cross = _cross(latent, blurred)
    power = sum(
        (spectrum.abs().square().sum(dim=0) for spectrum in latent), torch.zeros_like(cross.real)
    )
    level = power.mean().clamp(min=1e-12)  # 0 where the latent photo is flat
    return lags(
        torch.fft.irfft2(
            torch.stack([cross / (power + ridge * level) for ridge in ridges]), s=frame
        )
    )


def _cross(first: list[Tensor], second: list[Tensor]) -> Tensor:
    """Cross spectrum of all crops and both directions, (H, W // 2 + 1)."""
    return torch.stack(
        [(a.conj() * b).sum(dim=0) for a, b in zip(first, second, strict=True)]
    ).sum(dim=0)
