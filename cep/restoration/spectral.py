"""Common parts of the restorations: checked input, the OTF of a PSF on an FFT grid, spectra of
gradients.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from motdiff.psf_frame import in_frame
from motdiff.types import ComplexArray, FloatArray


def channels_first(photo: ArrayLike) -> FloatArray:
    """Return the photo, checked, as (C, H, W) float64, C = 1 or 3.

    Raises
    ------
    ValueError
        If the photo is not (H, W) or (H, W, 3), smaller than 3 x 3, or holds NaN or infinity.
    """
    image = np.asarray(photo, dtype=np.float64)
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(f"photo: must be (H, W) or (H, W, 3), got shape {image.shape}")
    if min(image.shape[:2]) < 3:
        raise ValueError(
            f"photo: must be at least 3 x 3 px, got {image.shape[1]} x {image.shape[0]}"
        )
    if not np.isfinite(image).all():
        raise ValueError("photo: must be finite, found NaN or infinity")
    return image[None] if image.ndim == 2 else np.ascontiguousarray(np.moveaxis(image, 2, 0))


def channels_last(image: FloatArray) -> FloatArray:
    """(C, H, W) back to (H, W) or (H, W, 3)."""
    return image[0] if image.shape[0] == 1 else np.ascontiguousarray(np.moveaxis(image, 0, 2))


def trimmed_psf(psf: ArrayLike) -> FloatArray:
    """Return the PSF, checked, in the smallest odd square frame around its zero displacement.

    Parameters
    ----------
    psf : (S, S') array_like
        Zero displacement at index ``size // 2`` of each axis.

    Raises
    ------
    ValueError
        If it is not two-dimensional, not finite, negative somewhere, or dark.
    """
    kernel = np.asarray(psf, dtype=np.float64)
    if (
        kernel.ndim != 2
        or kernel.size == 0
        or not np.isfinite(kernel).all()
        or kernel.min() < 0
        or not kernel.any()
    ):
        raise ValueError(
            "psf: must be a finite, non-negative (S, S) array with some light, got shape"
            f" {kernel.shape}"
        )
    rows, columns = np.nonzero(kernel)
    centre = (kernel.shape[0] // 2, kernel.shape[1] // 2)
    reach = int(max(np.abs(rows - centre[0]).max(), np.abs(columns - centre[1]).max()))
    return in_frame(kernel, 2 * reach + 1)


def otf_on_grid(psf: FloatArray, shape: tuple[int, int]) -> ComplexArray:
    """``rfft2`` of the PSF wrapped onto a periodic grid of ``shape``, zero displacement at index
    (0, 0).
    """
    rows, columns = np.nonzero(psf)
    grid = np.zeros(shape)
    wrapped = ((rows - psf.shape[0] // 2) % shape[0], (columns - psf.shape[1] // 2) % shape[1])
    np.add.at(grid, wrapped, psf[rows, columns])
    return np.asarray(fft.rfft2(grid), dtype=np.complex128)


def gradient_power(shape: tuple[int, int]) -> FloatArray:
    """``|Dx|^2 + |Dy|^2`` of periodic forward differences on the ``rfft2`` grid of ``shape``."""
    fy = np.fft.fftfreq(shape[0])[:, None]
    fx = np.fft.rfftfreq(shape[1])[None, :]
    return np.asarray(4 * np.sin(np.pi * fy) ** 2 + 4 * np.sin(np.pi * fx) ** 2, dtype=np.float64)


def power_law(shape: tuple[int, int]) -> FloatArray:
    """Squared frequency |f|^2, (cy/px)^2, on the ``rfft2`` grid of ``shape``: a 1/f^2 scene's
    inverse spectrum.
    """
    fy = np.fft.fftfreq(shape[0])[:, None]
    fx = np.fft.rfftfreq(shape[1])[None, :]
    return np.asarray(fy**2 + fx**2, dtype=np.float64)
