"""Correction of an estimated kernel by a network, from the photo's residual on the kernel's grid.

A search ends with sparse non-negative kernels: faint parts of the path are cut with the noise. The
maps here hold the least-squares kernel before any constraint, and where the photo contradicts the
kernel; from them a small network learns which faint parts continue a path.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from motdiff.blind_search.coarse_to_fine import fine_latent
from motdiff.blind_search.grids import (
    QUARTER_TURNS,
    SYMMETRIES,
    fast_size,
    gradient_power,
    inverse_symmetry,
    mirrored,
    periodic_extension,
    psf_to_otf,
)
from motdiff.blind_search.kernel import thresholded
from motdiff.blind_search.latent import salient_gradients
from motdiff.network.physics_maps import autocorrelation, lags, spectral_maps
from motdiff.network.sampling import DOUBT
from motdiff.network.unet import GridUNet, silence
from motdiff.psf_frame import ODD_PX, PSF_PX, in_frame
from motdiff.types import FloatArray

MAPS = 11
"""Maps of each kernel."""
_WIDTH = 64  # of the U-Net, as its depth and patch; the published weights have these sizes
_DEPTH = 2
_PATCH = 2
_DROPOUT = 0.1
_RIDGES = (0.03, 0.3, 3.0)  # of the least-squares kernels, in mean powers of the latent gradients
_WIENER_RIDGE = 0.3
_WIENER_PENALTY = 3e-4
_WIENER_PER_VARIANCE = 100.0
# Symmetries averaged in each pass. Two passes: the maps of a corrected kernel hold more evidence
# than those of a searched one; the first needs only quarter turns (docs/decisions/network.md).
_PASSES = (QUARTER_TURNS, range(SYMMETRIES))
_LATENT_RANGE = (-0.5, 1.5)  # a restoration by a wrong kernel rings far beyond full scale


class CorrectionNetwork(nn.Module):
    """Corrected kernels (B, 64, 64), peak about 1, with small negatives, of maps (B, 11, 64, 64).

    The kernel, which is the first map, plus the output of a U-Net that is 0 before training.
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


def corrected(
    network: CorrectionNetwork, maps: Tensor, symmetries: Sequence[int] = range(SYMMETRIES)
) -> Tensor:
    """Mean over symmetries of the square of the corrections (B, 64, 64) of maps (B, 11, 64, 64).

    They are non-negative, with sum 1, and 0 below 2 % of the peak. The network is in eval mode.
    """
    variants = torch.cat([mirrored(maps, symmetry, pitch=1) for symmetry in symmetries])
    kernels = network(variants)[:, None].chunk(len(symmetries))
    aligned = [
        mirrored(kernel, inverse_symmetry(symmetry), pitch=1)
        for symmetry, kernel in zip(symmetries, kernels, strict=True)
    ]
    return thresholded(torch.cat(aligned, dim=1).mean(dim=1).clamp(min=0), below=DOUBT)


def corrected_kernel(
    network: CorrectionNetwork,
    crops: FloatArray,
    kernel: FloatArray,
    rivals: Sequence[FloatArray],
    *,
    sigma: float,
) -> FloatArray:
    """Correct a kernel twice by crops of its photo: (63, 63), non-negative, sum 1.

    Parameters
    ----------
    network : CorrectionNetwork
        In eval mode, on the CPU.
    crops : (C, H, W) float, grey, linear light
    kernel : (k, k) float, sum 1
    rivals : sequence of one or two (k', k') float, sum 1
        Kernels that the photo might have instead; their frames may differ.
    sigma : float
        Standard deviation of the noise.
    """
    light = torch.from_numpy(crops.astype(np.float32))
    framed = torch.from_numpy(np.stack([_framed(k) for k in (kernel, *rivals)]))
    estimate = framed[:1]
    framed_rivals = framed[[1, -1]][None]  # a single one counts twice
    with torch.inference_mode():
        for symmetries in _PASSES:
            maps = correction_maps(light[None], estimate, framed_rivals, sigma=sigma)
            estimate = corrected(network, maps, symmetries)
    odd = in_frame(estimate[0].double().numpy(), ODD_PX)
    return np.asarray(odd / odd.sum(), dtype=np.float64)


def _framed(kernel: FloatArray) -> NDArray[np.float32]:
    cut = in_frame(kernel)
    return np.asarray(cut / max(float(cut.sum()), 1e-12), dtype=np.float32)


def correction_maps(photos: Tensor, kernels: Tensor, rivals: Tensor, *, sigma: float) -> Tensor:
    """Stack the correction network's input, for one kernel of each photo or several of one.

    Parameters
    ----------
    photos : (B or 1, C, H, W) float32, grey, linear light
        As C crops each, which share one blur; sides of at least 64 px. A single photo belongs to
        all kernels.
    kernels : (B, 64, 64) float32, sum 1
    rivals : (B, 2, 64, 64) float32, sum 1
        For each kernel, two other candidates, which may be like it; the same one twice where there
        are only two.
    sigma : float
        Standard deviation of the noise in all of them.

    Returns
    -------
    (B, 11, 64, 64) float32: the kernel and its two rivals; least-squares kernels of its latent
    photo, with three ridges, and of its Wiener restoration; the correlation of the latent
    gradients with the residual of the photo's: positive where light is missing, negative where
    there is too much; each over its largest magnitude. Then autocorrelation and cepstrum of the
    photo, and the kernel's autocorrelation, at lags of -32..31 px.

    Raises
    ------
    ValueError
        If a side is shorter than 64 px.
    """
    signed = torch.cat([kernels[:, None], rivals, _photo_maps(photos, kernels, sigma)], dim=1)
    signed = signed / signed.abs().amax(dim=(-2, -1), keepdim=True).clamp(min=1e-9)
    spectral = spectral_maps(photos).expand(len(kernels), -1, -1, -1)
    return torch.cat([signed, spectral, autocorrelation(kernels[:, None])], dim=1)


def _photo_maps(photos: Tensor, kernels: Tensor, sigma: float) -> Tensor:
    """Least-squares kernels, and the correlation with the residual, (B, 5, 64, 64)."""
    count, height, width = photos.shape[1:]
    flat = photos.flatten(0, 1)
    shape = (fast_size(height + PSF_PX - 1), fast_size(width + PSF_PX - 1))
    wrapped = periodic_extension(flat, shape).view(-1, count, *shape)
    wrapped = wrapped.expand(len(kernels), -1, -1, -1).flatten(0, 1)
    repeated = kernels.repeat_interleave(count, dim=0)
    frame = (fast_size(height - 1 + PSF_PX), fast_size(width - 1 + PSF_PX))

    def gradient_spectra(images: Tensor) -> Tensor:
        gradients = salient_gradients(images, images.new_zeros(len(images)))
        spectra = torch.fft.rfft2(torch.stack(gradients, dim=1), s=frame)  # (B C, 2, h, w)
        by_photo: Tensor = spectra.view(-1, 2 * count, *spectra.shape[-2:])
        return by_photo

    def restored(latent: Tensor) -> Tensor:
        return gradient_spectra(latent[:, :height, :width].clamp(*_LATENT_RANGE))

    B = gradient_spectra(flat)
    X = restored(fine_latent(wrapped, repeated, sigma=sigma))
    H = psf_to_otf(kernels, frame)[:, None]
    residuals = torch.fft.irfft2(B - X * H, s=frame)[..., : height - 1, : width - 1]
    R = torch.fft.rfft2(residuals, s=frame)
    correlation = lags(torch.fft.irfft2(_cross(X, R)[:, None], s=frame))
    least_squares = _least_squares(X, B, _RIDGES, frame)
    X = restored(_wiener(wrapped, repeated, sigma))
    return torch.cat(
        [least_squares, _least_squares(X, B, (_WIENER_RIDGE,), frame), correlation], dim=1
    )


def _wiener(wrapped: Tensor, kernels: Tensor, sigma: float) -> Tensor:
    """Restore periodic photos (C, H, W) with a penalty on squared gradients."""
    height, width = wrapped.shape[-2:]
    H = psf_to_otf(kernels, (height, width))
    penalty = _WIENER_PENALTY + _WIENER_PER_VARIANCE * sigma**2
    response = H.abs().square() + penalty * gradient_power(height, width, wrapped) + 1e-9
    restored: Tensor = torch.fft.irfft2(
        H.conj() * torch.fft.rfft2(wrapped) / response, s=(height, width)
    )
    return restored


def _least_squares(
    X: Tensor, B: Tensor, ridges: tuple[float, ...], frame: tuple[int, int]
) -> Tensor:
    """Unconstrained kernels (B, R, 64, 64), ``X* B / (|X|^2 + ridge)``, of gradient spectra."""
    cross = _cross(X, B)
    power = X.abs().square().sum(dim=1)
    # 0 where the latent photo is flat
    level = power.mean(dim=(-2, -1), keepdim=True).clamp(min=1e-12)
    K = torch.stack([cross / (power + ridge * level) for ridge in ridges], dim=1)
    return lags(torch.fft.irfft2(K, s=frame))


def _cross(X: Tensor, Y: Tensor) -> Tensor:
    """Cross spectra X* Y, (B, H, W // 2 + 1), summed over the crops and both directions."""
    return (X.conj() * Y).sum(dim=1)
