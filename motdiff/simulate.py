"""Simulated photos: blur with real or mirrored borders, and noise."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from motdiff.psf_frame import PSF_PX
from motdiff.trajectory import Trajectory, check_positive
from motdiff.types import FloatArray


def valid_window(shape: tuple[int, ...], psf_shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Part of a sharp image, (rows, columns), that :func:`blur_valid` returns blurred.

    ValueError if the PSF, zero displacement at index ``size // 2``, is larger than the image.
    """
    if psf_shape[0] > shape[0] or psf_shape[1] > shape[1]:
        raise ValueError(
            f"psf: {psf_shape[1]} x {psf_shape[0]} px does not fit an image of {shape[1]} x"
            f" {shape[0]} px"
        )
    rows, columns = (
        slice(p - 1 - p // 2, n - p // 2) for n, p in zip(shape, psf_shape, strict=False)
    )
    return rows, columns


def blur_valid(sharp: ArrayLike, psf: ArrayLike) -> FloatArray:
    """Blur with real borders: only pixels whose whole light comes from within ``sharp``.

    ValueError if the PSF is not two-dimensional or larger than the image.

    Parameters
    ----------
    sharp : (H, W) or (H, W, C) array_like, linear light
    psf : (S, S) array_like
        Zero displacement at index ``S // 2``; true convolution, so a point at p draws the PSF
        around p.

    Returns
    -------
    (H - S + 1, W - S + 1[, C]) float64, the blurred ``sharp[valid_window(sharp.shape,
    psf.shape)]``.
    """
    image, kernel = _checked(sharp, psf)
    valid_window(image.shape, kernel.shape)
    size = tuple(fft.next_fast_len(n, real=True) for n in image.shape[:2])
    # circular wrap-around stays within the rows and columns that are cut away
    spectrum = fft.rfft2(kernel, size)
    if image.ndim == 3:
        spectrum = spectrum[..., None]
    blurred = fft.irfft2(fft.rfft2(image, size, axes=(0, 1)) * spectrum, size, axes=(0, 1))
    rows, columns = kernel.shape
    return np.ascontiguousarray(
        blurred[rows - 1 : image.shape[0], columns - 1 : image.shape[1]], dtype=np.float64
    )


def blur_symmetric(sharp: ArrayLike, psf: ArrayLike) -> FloatArray:
    """Blur at full size, the scene mirrored beyond its borders, as the MoTDiff paper's data.

    The arguments are those of :func:`blur_valid`; the photo has the shape of ``sharp``.
    """
    image, kernel = _checked(sharp, psf)
    pads = [(n - 1 - n // 2, n // 2) for n in kernel.shape] + [(0, 0)] * (image.ndim - 2)
    return blur_valid(np.pad(image, pads, mode="symmetric"), kernel)


def add_noise(
    photo: ArrayLike,
    rng: np.random.Generator,
    *,
    photons_full_scale: float | None = None,
    read_sigma: float = 0.0,
) -> FloatArray:
    """Add photon (Poisson) and read (Gaussian) noise; nothing is clipped.

    ValueError if a noise parameter is negative, or the photo is where photons are counted.

    Parameters
    ----------
    photo : array_like, linear light, 1 = full scale
    photons_full_scale : float, optional
        Photons that value 1 stands for; no photon noise when omitted.
    read_sigma : float
        Standard deviation of the read noise, in units of full scale.
    """
    clean = np.asarray(photo, dtype=np.float64)
    if not (math.isfinite(read_sigma) and read_sigma >= 0):
        raise ValueError(f"read_sigma: must be a non-negative number, got {read_sigma}")
    noisy = clean
    if photons_full_scale is not None:
        check_positive("photons_full_scale", photons_full_scale)
        if clean.size and clean.min() < -1e-6:
            raise ValueError(
                f"photo: light must be non-negative to count photons, got {clean.min():.3g}"
            )
        # FFT blurring leaves values of -1e-17 in black areas
        noisy = rng.poisson(np.maximum(clean, 0) * photons_full_scale) / photons_full_scale
    if read_sigma > 0:
        noisy = noisy + read_sigma * rng.standard_normal(clean.shape)
    return np.array(noisy, dtype=np.float64)


def photograph(
    scene: ArrayLike,
    motion: Trajectory | ArrayLike,
    *,
    rng: np.random.Generator,
    borders: str = "real",
    photons_full_scale: float | None = None,
    read_sigma: float = 0.01,
    record: Callable[[FloatArray], FloatArray] | None = None,
) -> FloatArray:
    """Simulate the blurred photo of a scene; training has its own batched simulation in torch.

    ValueError if an argument is malformed, or the PSF larger than the scene.

    Parameters
    ----------
    scene : (H, W) or (H, W, C) array_like, linear light 0..1
    motion : Trajectory or (S, S) PSF
        A trajectory is drawn in the smallest odd frame that holds it; a coded exposure comes as
        its light-true PSF.
    borders : {"real", "symmetric"}
        Light comes from beyond the photo, as :func:`blur_valid`, or is mirrored there, as
        :func:`blur_symmetric`.
    photons_full_scale, read_sigma : as :func:`add_noise`
    record : callable, optional
        From noisy light to recorded values, such as a converter's rounding; clipping to 0..1 when
        omitted.

    Returns
    -------
    (h, w[, C]) float64 that shows ``visible(scene, S, borders=borders)``.
    """
    if isinstance(motion, Trajectory):
        # odd: as many rows of the scene are cut off before the photo as after it
        motion = motion.psf(motion.frame_size() | 1)
    psf = np.asarray(motion, np.float64)
    blurred = blur_valid(scene, psf) if _are_real(borders) else blur_symmetric(scene, psf)
    light = add_noise(blurred, rng, photons_full_scale=photons_full_scale, read_sigma=read_sigma)
    if record is None:
        return np.clip(light, 0, 1)
    return record(light)


def visible(scene: ArrayLike, psf_px: int, *, borders: str = "real") -> FloatArray:
    """Part of ``scene`` (H, W[, C]) that a photo through a PSF frame of ``psf_px`` shows."""
    light = np.asarray(scene, dtype=np.float64)
    if _are_real(borders):
        light = light[valid_window(light.shape, (psf_px, psf_px))]
    return light


def border_px(borders: str, psf_px: int = PSF_PX) -> int:
    """Pixels, per axis, of a scene beyond its photo through a PSF frame of ``psf_px``."""
    if not _are_real(borders):
        return 0  # mirrored: the photo is as large as the scene
    return psf_px - 1


def _are_real(borders: str) -> bool:
    if borders not in ("real", "symmetric"):
        raise ValueError(f'borders: must be "real" or "symmetric", got {borders!r}')
    return borders == "real"


def _checked(sharp: ArrayLike, psf: ArrayLike) -> tuple[FloatArray, FloatArray]:
    image = np.asarray(sharp, dtype=np.float64)
    kernel = np.asarray(psf, dtype=np.float64)
    if image.ndim not in (2, 3):
        raise ValueError(f"sharp: must be (H, W) or (H, W, C), got shape {image.shape}")
    if kernel.ndim != 2 or kernel.size == 0:
        raise ValueError(f"psf: must be (S, S), got shape {kernel.shape}")
    return image, kernel
