"""One door to every restoration method, with what a user should know about the result."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cep.restoration.inverse import inverse_filter
from cep.restoration.l0 import l0, tv_less_ringing
from cep.restoration.pnp import pnp
from cep.restoration.spectral import channels_first, trimmed_psf
from cep.restoration.tv import tv
from cep.restoration.wiener import wiener

__all__ = ["METHODS", "Restoration", "misfit", "restore", "saturated"]

FloatArray = NDArray[np.float64]
METHODS: Mapping[str, Callable[..., FloatArray]] = {
    "wiener": wiener,
    "inverse": inverse_filter,
    "tv": tv,
    "l0": l0,
    "tv-ring": tv_less_ringing,
    "pnp": pnp,
}
_CLIPPED = 0.995
_WORTH_TELLING = 1e-3


@dataclass(frozen=True)
class Restoration:
    """A restored photo.

    Attributes
    ----------
    image : float ndarray like the photo
        At the scale of the full open exposure, not clipped.
    method : str
    residual : float
        RMS of the reblurred result against the photo, away from the borders; full-scale units.
    unreliable_px : int
        Width of the border strip that leans on a guess of the scene outside the frame.
    saturated_fraction : float
        Share of the photo's pixels that are clipped.
    warnings : tuple of str
    seconds : float
    """

    image: FloatArray
    method: str
    residual: float
    unreliable_px: int
    saturated_fraction: float
    warnings: tuple[str, ...]
    seconds: float


def restore(photo: ArrayLike, psf: ArrayLike, *, method: str = "wiener", **options: Any) -> Restoration:
    """Restore a photo with one of :data:`METHODS`.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    psf : (S, S) array_like
        Light-true PSF, zero displacement at index ``size // 2``.
    method : str
        "wiener", "inverse", "tv", "l0", "tv-ring" (TV less its ringing) or "pnp" (with a trained denoiser).
    **options
        Passed on to the method.

    Raises
    ------
    ValueError
        If the method is not known, or the method refuses its arguments.
    """
    if method not in METHODS:
        raise ValueError(f"method: must be one of {', '.join(METHODS)}, got {method!r}")
    started = time.perf_counter()
    channels, kernel = channels_first(photo), trimmed_psf(psf)
    reach = kernel.shape[0] // 2
    notes: list[str] = []
    clipped = float(saturated(photo).mean())
    if clipped > _WORTH_TELLING:
        notes.append(f"{100 * clipped:.1f} % of the pixels are clipped: expect ringing around them")
    if 4 * reach > min(channels.shape[1:]):
        notes.append(f"the PSF reaches {reach} px, far into a photo of {channels.shape[2]} x {channels.shape[1]} px")
    image = METHODS[method](photo, psf, **options)
    return Restoration(
        image, method, misfit(photo, image, psf), reach, clipped, tuple(notes), time.perf_counter() - started
    )


def misfit(photo: ArrayLike, restored: ArrayLike, psf: ArrayLike) -> float:
    """RMS of ``restored`` reblurred minus ``photo``, over the pixels that the PSF reaches from inside; NaN if none."""
    channels, latent, kernel = channels_first(photo), channels_first(restored), trimmed_psf(psf)
    reach = kernel.shape[0] // 2
    if min(channels.shape[1:]) <= 2 * reach:
        return float("nan")
    inside = channels[:, reach : channels.shape[1] - reach, reach : channels.shape[2] - reach]
    again = np.stack([signal.fftconvolve(channel, kernel, mode="valid") for channel in latent])
    return float(np.sqrt(np.mean((again - inside) ** 2)))


def saturated(photo: ArrayLike) -> NDArray[np.bool_]:
    """Pixels (H, W) of a 0..1 photo that are clipped at full scale, in any channel."""
    return np.asarray((channels_first(photo) >= _CLIPPED).any(axis=0))
