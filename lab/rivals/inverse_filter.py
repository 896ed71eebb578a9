"""Inverse filter with a floor under the MTF: the restoration of the MoTDiff paper's Table III."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cep.restoration.blur import Blur, Border, channels_first, channels_last, trimmed_psf
from cep.restoration.clipping import fill_clipped
from motdiff.types import FloatArray


def inverse_filter(
    photo: ArrayLike,
    psf: ArrayLike,
    *,
    floor: float = 0.05,
    border: Border = "real",
    border_rounds: int = 10,
) -> FloatArray:
    """Divide the photo's spectrum by the OTF, whose modulus has a floor.

    Clipped pixels are filled before it, see :func:`cep.restoration.clipping.fill_clipped`.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light
    psf : (S, S) array_like
        Light-true PSF, zero displacement at index ``size // 2``.
    floor : float
        Least |H| divided by, as a fraction of the DC value (the PSF's sum). 0 divides by
        everything but exact zeros.
    border, border_rounds
        As :class:`cep.restoration.blur.Blur` and its method ``extend``.

    Returns
    -------
    float ndarray like ``photo``
        At the scale of the full open exposure; a guess within the PSF's reach of a real border.
    """
    if not 0 <= floor < 1:
        raise ValueError(f"floor: must lie within 0..1, got {floor}")
    channels = channels_first(fill_clipped(photo, psf))
    blur = Blur(trimmed_psf(psf), channels.shape[1:], border)
    modulus = np.abs(blur.H)
    smallest = floor * blur.psf.sum()
    # conj(H) / (|H| max(|H|, floor)) keeps the phase of H where its modulus is raised
    divisor = modulus * np.maximum(modulus, smallest)
    alive = divisor > np.finfo(float).tiny  # exact zeros of H: nothing can be restored there
    gain = np.divide(np.conj(blur.H), divisor, out=np.zeros_like(blur.H), where=alive)
    restored = np.empty_like(channels)
    for channel, out in zip(channels, restored, strict=True):
        extended = blur.extend(channel, noise_to_scene=smallest**2, rounds=border_rounds)
        out[:] = blur.crop(blur.image(blur.spectrum(extended) * gain))
    return channels_last(restored)
