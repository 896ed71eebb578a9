"""The latent photo of one blind step: L0 gradients with the patch-wise minimal pixels prior, batched in torch."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.estimators.pmp.grids import gradient_power, psf_to_otf

__all__ = ["l0_pmp_latent", "salient_gradients", "start_threshold"]

_ALPHA_MAX = 1e5
_INTENSITY_CAP = 0.1


def l0_pmp_latent(
    blurred: Tensor,
    kernel: Tensor,
    *,
    intensity_weight: float,
    gradient_weight: float,
    patch_px: int,
    coarse: bool,
    kappa: float,
    inner: int,
) -> Tensor:
    """Restore a latent photo that has few gradients and whose darkest pixel in each patch is near zero.

    Half-quadratic splitting: the gradients are hard-thresholded, the minimal pixels shrunk, and the photo solved for
    in the Fourier domain, with the coupling growing from ``2 gradient_weight`` to 1e5.

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
    kappa : float
        Growth of the coupling per step.
    inner : int
        Repetitions at each coupling.

    Returns
    -------
    (B, H, W) float.

    References
    ----------
    Wen et al., "A simple local minimal intensity prior and an improved algorithm for blind image deblurring",
    IEEE TCSVT 2021, algorithm 2; Xu et al., "Unnatural L0 sparse representation", CVPR 2013.
    """
    height, width = blurred.shape[-2:]
    otf = psf_to_otf(kernel, (height, width))
    power = otf.abs().square()
    data = otf.conj() * torch.fft.rfft2(blurred)
    laplacian = gradient_power(height, width, blurred)
    photo = blurred
    alpha = 2.0 * gradient_weight
    while alpha < _ALPHA_MAX:
        for _ in range(inner):
            if intensity_weight > 0:
                photo = _shrink_minimal_pixels(photo, intensity_weight, patch_px, soft=coarse)
            divergence = _salient_divergence(photo, gradient_weight / alpha)
            spectrum = torch.fft.rfft2(divergence).mul_(alpha).add_(data)
            parts = torch.view_as_real(spectrum)
            parts *= (power + alpha * laplacian).reciprocal_()[..., None]  # a division takes four times as long
            photo = torch.fft.irfft2(spectrum, s=(height, width))
        alpha *= kappa
    return photo


def start_threshold(photo: Tensor, *, size: int) -> Tensor:
    """Squared gradient above which each of four orientations keeps at least ``20 size`` pixels, (B,).

    Parameters
    ----------
    photo : (B, H, W) float
    size : int
        Kernel side at this scale, px.
    """
    gx, gy = _forward_gradients(photo)
    strength = gx.square() + gy.square()
    angle = torch.atan(gy / torch.where(gx == 0, torch.full_like(gx, 1e-12), gx))
    wanted = max(20 * size, 10)
    lowest = []
    for low in (-torch.pi / 2, -torch.pi / 4, 0.0, torch.pi / 4):
        inside = (angle >= low) & (angle < low + torch.pi / 4)
        values = torch.where(inside, strength, torch.zeros_like(strength)).flatten(1)
        lowest.append(values.topk(min(wanted, values.shape[1]), dim=1).values[:, -1])
    return torch.stack(lowest).amin(dim=0)


def salient_gradients(photo: Tensor, threshold: Tensor) -> tuple[Tensor, Tensor]:
    """Forward differences of ``photo`` where their squared size reaches ``threshold``, else 0.

    A threshold that would keep nothing is lowered until something stays.

    Parameters
    ----------
    photo : (B, H, W) float
    threshold : (B,) float

    Returns
    -------
    gx, gy : (B, H - 1, W - 1) float
    """
    gx, gy = _forward_gradients(photo)
    strength = gx.square() + gy.square()
    strongest = strength.amax(dim=(1, 2))
    level = torch.minimum(threshold, 0.81 * strongest)[:, None, None]
    keep = (strength >= level).to(photo.dtype)
    return gx * keep, gy * keep


def _salient_divergence(photo: Tensor, threshold: float) -> Tensor:
    """Divergence of the periodic gradients whose squared size reaches ``threshold``, the others set to 0.

    In place and without truth values, which take torch longer than the arithmetic.
    """
    gx, gy = torch.empty_like(photo), torch.empty_like(photo)
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
    """Shrink the darkest pixel of every patch: softly, or to zero where it is below an adaptive threshold."""
    negative, index = functional.max_pool2d(-photo[:, None], patch_px, ceil_mode=True, return_indices=True)
    value = -negative[:, 0]
    if soft:
        shrunk = torch.sign(value) * (value - weight).clamp(min=0)
    else:
        level = value.abs().mean(dim=(1, 2)).clamp(min=weight, max=_INTENSITY_CAP)[:, None, None]
        shrunk = torch.where(value.abs() < level, torch.zeros_like(value), value)
    return photo.flatten(1).scatter(1, index.flatten(1), shrunk.flatten(1)).view_as(photo)
