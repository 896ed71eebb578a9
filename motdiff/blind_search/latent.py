"""Latent photo of one blind step: L0 gradients with the patch-wise minimal pixels prior."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.blind_search.grids import gradient_power, psf_to_otf

_INTENSITY_CAP = 0.1  # of the adaptive threshold: a bright photo must keep its minima


@dataclass(frozen=True)
class Coupling:
    """Couplings of the half-quadratic splitting of the gradients; defaults of Xu et al. 2013.

    Attributes
    ----------
    start : float
        First coupling, in gradient weights: squared gradients below ``1 / start`` are dropped at
        first.
    end : float
    growth : float
        Factor per step.
    """

    start: float = 2.0
    end: float = 1e5
    growth: float = 2.0

    def steps(self, gradient_weight: float) -> Iterator[float]:
        """Go through the couplings for the weight of the gradient count."""
        alpha = self.start * gradient_weight
        while alpha < self.end:
            yield alpha
            alpha *= self.growth


def l0_pmp_latent(
    blurred: Tensor,
    kernel: Tensor,
    *,
    intensity_weight: float,
    gradient_weight: float,
    patch_px: int,
    coarse: bool,
    coupling: Coupling,
    exposures: int = 1,
) -> Tensor:
    """Restore photos (B / I, H, W) of few gradients, each patch's darkest pixel near zero.

    Half-quadratic splitting: the gradients are hard-thresholded, the minimal pixels shrunk, and
    the photo solved for in the Fourier domain, with a growing coupling.

    Parameters
    ----------
    blurred : (B, H, W) float, periodic
    kernel : (B, k, k) float, odd k, sum 1
    intensity_weight, gradient_weight : float
        Weights of the minimal pixels (0: without that prior) and of the gradient count.
    patch_px : int
        Side of the patches whose minimum is shrunk, px.
    coarse : bool
        Shrink softly (coarse scales) instead of setting small minima to zero.
    exposures : int
        I photos of each scene, which share a latent photo: of ``B = I N`` photos each N-th shows
        the same scene, through a kernel of its own.

    References
    ----------
    Wen et al., "A simple local minimal intensity prior and an improved algorithm for blind image
    deblurring", IEEE TCSVT 2021, algorithm 2; Xu et al., "Unnatural L0 sparse representation",
    CVPR 2013.
    """
    height, width = blurred.shape[-2:]
    K = psf_to_otf(kernel, (height, width))  # the papers' symbols: K the OTF, B the photo
    KK = _mean_exposure(K.abs().square(), exposures)
    KB = _mean_exposure(K.conj() * torch.fft.rfft2(blurred), exposures)
    DD = gradient_power(height, width, blurred)  # |D|^2 of both differences
    photo = _mean_exposure(blurred, exposures)
    for alpha in coupling.steps(gradient_weight):
        if intensity_weight > 0:
            photo = _shrink_minimal_pixels(photo, intensity_weight, patch_px, soft=coarse)
        # X = (K* B + alpha D* G) / (|K|^2 + alpha |D|^2), G the gradients after thresholding
        X = torch.fft.rfft2(_salient_divergence(photo, gradient_weight / alpha))
        torch.add(KB, X, alpha=alpha, out=X)
        X *= torch.add(KK, DD, alpha=alpha).reciprocal_()  # a division takes four times as long
        photo = torch.fft.irfft2(X, s=(height, width))
    return photo


def _mean_exposure(maps: Tensor, exposures: int) -> Tensor:
    """Mean (B / I, H, W) over the I exposures of each scene, of maps (B, H, W)."""
    return maps if exposures == 1 else maps.view(exposures, -1, *maps.shape[1:]).mean(0)


def start_threshold(photo: Tensor, *, size: int) -> Tensor:
    """Squared gradient (B,) that at least ``20 size`` pixels of each of 4 orientations reach.

    Parameters
    ----------
    photo : (B, H, W) float
    size : int
        Kernel side at this scale, px.
    """
    gx, gy = _forward_gradients(photo)
    strength = gx.square() + gy.square()
    angle = torch.atan(gy / torch.where(gx == 0, torch.full_like(gx, 1e-12), gx))
    count = max(20 * size, 10)
    thresholds = []
    # all four: edges of one orientation alone leave the kernel free along them
    for low in (-torch.pi / 2, -torch.pi / 4, 0.0, torch.pi / 4):
        inside = (angle >= low) & (angle < low + torch.pi / 4)
        values = torch.where(inside, strength, torch.zeros_like(strength)).flatten(1)
        thresholds.append(values.topk(min(count, values.shape[1]), dim=1).values[:, -1])
    return torch.stack(thresholds).amin(dim=0)


def salient_gradients(photo: Tensor, threshold: Tensor) -> tuple[Tensor, Tensor]:
    """Forward differences, right and down, of photos (B, H, W), each (B, H - 1, W - 1).

    They are 0 where their squared size is below the threshold (B,). One that would keep nothing
    is lowered until something stays.
    """
    gx, gy = _forward_gradients(photo)
    strength = gx.square() + gy.square()
    strongest = strength.amax(dim=(1, 2))
    # 0.81 = 0.9^2: at least gradients near the strongest stay
    level = torch.minimum(threshold, 0.81 * strongest)[:, None, None]
    keep = (strength >= level).to(photo.dtype)
    return gx * keep, gy * keep


def _salient_divergence(photo: Tensor, threshold: float) -> Tensor:
    """Divergence of the periodic gradients whose squared size reaches ``threshold``."""
    # in place and without truth values, which take torch longer than the arithmetic
    gx = torch.empty_like(photo)
    gy = torch.empty_like(photo)
    torch.sub(photo[..., 1:], photo[..., :-1], out=gx[..., :-1])
    torch.sub(photo[..., 0], photo[..., -1], out=gx[..., -1])
    torch.sub(photo[..., 1:, :], photo[..., :-1, :], out=gy[..., :-1, :])
    torch.sub(photo[..., 0, :], photo[..., -1, :], out=gy[..., -1, :])
    keep = gx.square().add_(gy.square()).ge_(threshold)
    gx *= keep
    gy *= keep
    divergence = gx.neg()
    divergence[..., 1:] += gx[..., :-1]
    divergence[..., 0] += gx[..., -1]
    divergence[..., 1:, :] += gy[..., :-1, :]
    divergence[..., 0, :] += gy[..., -1, :]
    divergence -= gy
    return divergence


def _forward_gradients(photo: Tensor) -> tuple[Tensor, Tensor]:
    inner = photo[:, :-1, :-1]
    return photo[:, :-1, 1:] - inner, photo[:, 1:, :-1] - inner


def _shrink_minimal_pixels(photo: Tensor, weight: float, patch_px: int, *, soft: bool) -> Tensor:
    """Shrink the darkest pixel of each patch: softly, or to zero below an adaptive threshold."""
    negative, index = functional.max_pool2d(
        -photo[:, None], patch_px, ceil_mode=True, return_indices=True
    )
    value = -negative[:, 0]
    if soft:
        shrunk = torch.sign(value) * (value - weight).clamp(min=0)
    else:
        level = value.abs().mean(dim=(1, 2)).clamp(min=weight, max=_INTENSITY_CAP)[:, None, None]
        shrunk = torch.where(value.abs() < level, torch.zeros_like(value), value)
    return photo.flatten(1).scatter(1, index.flatten(1), shrunk.flatten(1)).view_as(photo)
