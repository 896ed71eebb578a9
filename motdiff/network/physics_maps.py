"""Physics maps of a photo's blur on the PSF's grid: correlations, cepstrum, classical kernels.

The network sees them beside the photo's features, or instead: they lie on the path's own grid.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motdiff.blind_search.coarse_to_fine import PmpSettings, Start, estimate_kernels
from motdiff.blind_search.latent import Coupling
from motdiff.psf_frame import PSF_PX, margins

_QUICK_COUPLING = Coupling(start=16.0, end=100.0, growth=2.0)
_QUICK_FINE_WEIGHTS = (1e-3, 3e-4)  # fewer steps than the full searches have
_BAND_SIGMA_CY_PX = 0.22  # above, noise outweighs the scene
_DISPLAY_GAMMA = 2.2  # near sRGB's curve: ImageNet's weights know display values alone


QUICK_STARTS = (Start(29, sparsity=1.0), Start(39), Start(53, sparsity=0.5))
"""Three runs at half the cost of a full one each (0.4 CPU-s at 256 px)."""


def physics_maps(photos: Tensor, kernels: Tensor) -> Tensor:
    """All maps of each photo.

    Parameters
    ----------
    photos : (B, C, H, W) float32
        Blurred photos, grey, linear light, each as C crops that share one blur.
    kernels : (B, K, 64, 64) float32
        From :func:`quick_kernels`.

    Returns
    -------
    (B, 2 + 2 K, 64, 64) float32: autocorrelation and cepstrum of the photo, the kernels over their
    peaks, and their autocorrelations. Zero lag and zero displacement at index 32.
    """
    return stacked_maps(spectral_maps(photos), kernels)


def stacked_maps(spectral: Tensor, kernels: Tensor) -> Tensor:
    """:func:`physics_maps` of spectral maps (B, 2, 64, 64) and kernels (B, K, 64, 64)."""
    peaks = kernels.amax(dim=(-2, -1), keepdim=True).clamp(min=1e-12)
    return torch.cat([spectral, kernels / peaks, autocorrelation(kernels)], dim=1)


def display_photo(grey: Tensor) -> Tensor:
    """Display values (B, 3, H, W) for the photo encoder, of grey linear light (B, 1, H, W)."""
    return (grey.clamp(0, 1) ** (1 / _DISPLAY_GAMMA)).expand(-1, 3, -1, -1)


def quick_kernels(
    photos: Tensor,
    *,
    sigma: float = 0.01,
    starts: tuple[Start, ...] = QUICK_STARTS,
    iterations: int = 2,
    fine_weights: tuple[float, ...] = _QUICK_FINE_WEIGHTS,
) -> Tensor:
    """Kernels (B, K, 64, 64) of shortened PMP searches, one per start: sum 1, centroid near 32.

    Parameters
    ----------
    photos : (B, C, H, W) float32
        As for :func:`physics_maps`.
    sigma : float
        Standard deviation of the noise.
    iterations : int
        Alternations of photo and kernel at each scale.
    fine_weights : tuple of float
        See :class:`motdiff.blind_search.coarse_to_fine.PmpSettings`; with none in half the time.
    """
    settings = PmpSettings(
        sigma=sigma,
        iterations=iterations,
        last_iterations=iterations,
        coupling=_QUICK_COUPLING,
        fine_weights=fine_weights,
    )
    kernels = []
    for start in starts:
        kernel = estimate_kernels(photos, start, settings=settings)
        kernels.append(torch.nn.functional.pad(kernel, 2 * margins(start.size)))
    return torch.stack(kernels, dim=1)


def spectral_maps(photos: Tensor) -> Tensor:
    """Autocorrelation and cepstrum (B, 2, 64, 64) of photos (B, C, H, W), lags of -32..31 px.

    ValueError if a side is shorter than 64 px. Zero lag lies at index 32. Sharp scenes have power
    spectra near ``1 / f^2``; times ``f^2`` they are about white, and the photo's autocorrelation
    is about the kernel's. The cepstrum turns the product of spectra into a sum, where the kernel's
    zeros show as ripples. Means over crops; the scale is the rms of the map.
    """
    height, width = photos.shape[-2:]
    if min(height, width) < PSF_PX:
        raise ValueError(f"photos: sides must be at least {PSF_PX} px, got {width} x {height}")
    hann_y, hann_x = (
        torch.hann_window(side, periodic=False, device=photos.device, dtype=photos.dtype)
        for side in (height, width)
    )
    window = hann_y[:, None] * hann_x[None, :]
    # taken away before the window, or its shape would show in the spectrum
    mean = (photos * window).sum(dim=(-2, -1), keepdim=True) / window.sum()
    power = torch.fft.rfft2((photos - mean) * window).abs().square()
    fy = torch.fft.fftfreq(height, device=photos.device, dtype=photos.dtype)[:, None]
    fx = torch.fft.rfftfreq(width, device=photos.device, dtype=photos.dtype)[None, :]
    radius2 = fx.square() + fy.square()
    band = torch.exp(-radius2 / (2 * _BAND_SIGMA_CY_PX**2))
    white = power * radius2
    # the mean is 0 where a photo is flat, such as a clipped sky
    level = white.mean(dim=(-2, -1), keepdim=True).clamp(min=1e-12)
    log_white = torch.log(white / level + 1e-3)
    spectra = torch.stack([(white * band).mean(dim=1), (log_white * band).mean(dim=1)], dim=1)
    return _scaled(lags(torch.fft.irfft2(spectra, s=(height, width))))


def autocorrelation(kernels: Tensor) -> Tensor:
    """Autocorrelations of kernels (..., 64, 64) at lags of -32..31 px; 1 at index 32, lag zero."""
    frame = (2 * PSF_PX, 2 * PSF_PX)  # linear, not circular, correlation
    R = lags(torch.fft.irfft2(torch.fft.rfft2(kernels, s=frame).abs().square(), s=frame))
    return R / R[..., PSF_PX // 2, PSF_PX // 2][..., None, None].clamp(min=1e-12)


def lags(correlation: Tensor) -> Tensor:
    """Lags -32..31 of a periodic correlation (..., H, W)."""
    half = PSF_PX // 2
    rolled = correlation.roll((half, half), (-2, -1))
    return rolled[..., :PSF_PX, :PSF_PX]


def _scaled(maps: Tensor) -> Tensor:
    """Scale maps to zero mean and unit rms."""
    centred = maps - maps.mean(dim=(-2, -1), keepdim=True)
    rms = centred.square().mean(dim=(-2, -1), keepdim=True).sqrt().clamp(min=1e-12)
    return torch.tanh(centred / (4 * rms)) * 4  # compresses the peak at zero lag to at most 4
