"""Metrics of an estimate: MNC of PSFs, distance of paths, PSNR up to shift."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

SAME_KERNEL_MNC = 0.95
"""Estimates of one photo's kernel count as the same from this sub-pixel MNC on,
docs/decisions/network.md."""
_SUBPIXEL_STEP_PX = 0.05
_ALIGNED_STEP_PX = 0.25  # of images: 1 px halved twice
_TIMES = 401  # compared of two paths


def mnc(psf_a: ArrayLike, psf_b: ArrayLike) -> float:
    """Maximum of normalised cross-correlation over integer shifts, in 0..1; no mean is subtracted.

    The PSFs (H, W) are non-negative, and their frames may differ in size. ValueError if a PSF is
    not two-dimensional, not finite, or all zero.

    References
    ----------
    Hu and Yang, "Good regions to deblur", ECCV 2012.
    """
    return float(_correlation(psf_a, psf_b).max())


def mnc_subpixel(psf_a: ArrayLike, psf_b: ArrayLike) -> float:
    """MNC over shifts to 0.05 px, by band-limited interpolation around the integer maximum.

    The PSFs are (H, W). Integer shifts punish a perfect PSF that sits half a pixel off (0.80 on
    Levin's); this does not.
    """
    return _subpixel_peak(_correlation(psf_a, psf_b))[0]


def mnc_matrix(psfs: Sequence[ArrayLike]) -> FloatArray:
    """MNC (N, N) of pairs of PSFs at half pixels: a quick :func:`mnc_subpixel`, within 0.03 of it.

    ValueError without PSFs, or as of :func:`mnc`.
    """
    images = [_checked(f"psfs[{i}]", psf) for i, psf in enumerate(psfs)]
    if not images:
        raise ValueError("psfs: needs at least one")
    # zero padding to twice the largest side: no lag wraps round
    frame = fft.next_fast_len(2 * max(max(image.shape) for image in images), real=True) // 2 * 2
    spectra = [fft.rfft2(image / np.linalg.norm(image), (frame, frame)) for image in images]
    alike = np.eye(len(images))
    half = frame // 2
    fine = np.zeros((2 * frame, half + 1), dtype=np.complex128)  # twice the samples: half pixels
    for i, spectrum in enumerate(spectra):
        for j in range(i):
            product = spectrum * spectra[j].conj()
            product[half] /= 2  # the Nyquist frequency is shared by both signs
            product[:, half] /= 2
            fine[: half + 1], fine[-half:] = product[: half + 1], product[half:]
            # 4: the inverse transform divides by four times as many samples
            alike[i, j] = alike[j, i] = 4 * float(fft.irfft2(fine, (2 * frame, 2 * frame)).max())
    return np.clip(alike, 0, 1)


def register_shift(psf_a: ArrayLike, psf_b: ArrayLike) -> tuple[float, float]:
    """Shift (dx, dy) px that moves ``psf_b``, by frame centre, onto ``psf_a``, to 0.05 px."""
    a = np.asarray(psf_a)
    b = np.asarray(psf_b)
    row, column = _subpixel_peak(_correlation(a, b))[1]
    # index of zero displacement between the frames' centres, size // 2
    return (
        column - (b.shape[1] - 1) + b.shape[1] // 2 - a.shape[1] // 2,
        row - (b.shape[0] - 1) + b.shape[0] // 2 - a.shape[0] // 2,
    )


def path_distance_px(a: Trajectory, b: Trajectory, *, samples: int = 200) -> float:
    """Mean distance, px, of two centred paths at equal arc length, in the better direction."""
    p, q = (path.arc_resampled(samples) for path in (a, b))
    p = p - p.mean(axis=0)
    q = q - q.mean(axis=0)
    return float(min(np.linalg.norm(p - points, axis=1).mean() for points in (q, q[::-1])))


def timed_distance_px(a: Trajectory, b: Trajectory) -> float:
    """Rms distance, px, of two paths at equal times after the best shift; direction counts.

    Examples
    --------
    >>> path = Trajectory.straight(12.0)
    >>> back = path.reversed()
    >>> print(f"{timed_distance_px(path, path):.2f} {timed_distance_px(path, back):.2f}")
    0.00 6.95
    """
    t = np.linspace(0, 1, _TIMES)
    return rms_distance_px(a.at(t), b.at(t))


def rms_distance_px(p: FloatArray, q: FloatArray) -> float:
    """Rms distance, px, of points (N, 2) from others in their order, after the best shift."""
    apart = p - q
    return float(np.sqrt(((apart - apart.mean(axis=0)) ** 2).sum(axis=1).mean()))


def psnr_up_to_shift(
    restored: ArrayLike,
    sharp: ArrayLike,
    *,
    max_shift_px: float = 5.0,
    crop_px: int = 15,
) -> float:
    """PSNR, dB, of ``restored`` against ``sharp`` (peak 1), best over shifts, borders cropped.

    Both are (H, W) or (H, W, 3), 0..1. Translations are tried in steps of 1/4 px (Levin et al.
    2009: up to 5 px); ``crop_px`` are left out on each side.
    """
    return psnr(*best_aligned(restored, sharp, max_shift_px, crop_px))


def psnr(image: FloatArray, target: FloatArray) -> float:
    """PSNR, dB, peak 1, of an image as it lies; at most 200 dB."""
    # the floor of 1e-20 keeps equal images at 200 dB
    return float(-10 * np.log10(max(float(np.mean((image - target) ** 2)), 1e-20)))


def _correlation(psf_a: ArrayLike, psf_b: ArrayLike) -> FloatArray:
    """Full normalised cross-correlation; index (h_b - 1, w_b - 1) lays corner on corner."""
    a = _checked("psf_a", psf_a)
    b = _checked("psf_b", psf_b)
    shape = (a.shape[0] + b.shape[0] - 1, a.shape[1] + b.shape[1] - 1)
    product = fft.rfft2(a, shape) * fft.rfft2(b[::-1, ::-1], shape)
    full = fft.irfft2(product, shape)
    return np.asarray(full / (np.linalg.norm(a) * np.linalg.norm(b)), dtype=np.float64)


def _checked(name: str, psf: ArrayLike) -> FloatArray:
    image = np.asarray(psf, dtype=np.float64)
    if image.ndim != 2 or not np.isfinite(image).all() or not np.any(image):
        raise ValueError(
            f"{name}: must be a finite (H, W) array with some light, got shape {image.shape}"
        )
    return image


def _subpixel_peak(correlation: FloatArray) -> tuple[float, tuple[float, float]]:
    """Band-limited maximum within 1 px of the integer maximum, and its (row, column)."""
    padded = np.pad(correlation, 1)  # a peak at the frame's edge must not wrap into the other side
    row0, column0 = (int(i) for i in np.unravel_index(int(padded.argmax()), padded.shape))
    offsets = np.arange(-1, 1 + _SUBPIXEL_STEP_PX / 2, _SUBPIXEL_STEP_PX)
    spectrum = fft.fft2(padded)  # of all of it: the interpolation is band-limited
    rows = _interpolator(padded.shape[0], row0 + offsets)
    columns = _interpolator(padded.shape[1], column0 + offsets)
    fine = (rows @ spectrum @ columns.T).real
    i, j = (int(i) for i in np.unravel_index(int(fine.argmax()), fine.shape))
    return float(min(fine[i, j], 1.0)), (row0 + offsets[i] - 1, column0 + offsets[j] - 1)


def _interpolator(size: int, positions: FloatArray) -> NDArray[np.complex128]:
    """Inverse DFT rows at real positions; a split Nyquist term keeps real signals real."""
    frequency = np.fft.fftfreq(size)
    matrix = np.exp(2j * np.pi * positions[:, None] * frequency[None, :])
    if size % 2 == 0:
        matrix[:, size // 2] = np.cos(np.pi * positions)
    return np.asarray(matrix / size, dtype=np.complex128)


def best_aligned(
    restored: ArrayLike, sharp: ArrayLike, max_shift_px: float, crop_px: int
) -> tuple[FloatArray, FloatArray]:
    """Restored photo moved onto the sharp one, to 1/4 px, and that one, both without borders.

    ValueError if their shapes differ, or the borders leave nothing.
    """
    moving = np.asarray(restored, dtype=np.float64)
    target = np.asarray(sharp, dtype=np.float64)
    if moving.shape != target.shape:
        raise ValueError(f"restored: shape {moving.shape} differs from sharp's {target.shape}")
    if min(target.shape[:2]) <= 2 * crop_px + 2:
        raise ValueError(
            f"crop_px: {crop_px} leaves nothing of a photo of {target.shape[1]} x"
            f" {target.shape[0]} px"
        )
    window = (slice(crop_px, -crop_px or None),) * 2

    room = int(np.ceil(max_shift_px)) + 3  # refined shifts may leave the range a little
    padded = np.pad(moving, [(room, room)] * 2 + [(0, 0)] * (moving.ndim - 2), mode="edge")
    height, width = (side - 2 * crop_px for side in moving.shape[:2])

    def shifted(dx: float, dy: float) -> FloatArray:
        # bilinear, by slices: the error is evaluated 171 times
        row = room + crop_px - dy
        column = room + crop_px - dx
        y = int(np.floor(row))
        x = int(np.floor(column))
        lower = row - y
        right = column - x
        rows = padded[y : y + height]
        if lower:
            rows = (1 - lower) * rows + lower * padded[y + 1 : y + 1 + height]
        columns = rows[:, x : x + width]
        if right:
            columns = (1 - right) * columns + right * rows[:, x + 1 : x + 1 + width]
        return columns

    reference = target[window]
    best = (0.0, 0.0)
    step = 1.0
    span = max_shift_px
    while True:  # coarse to fine; the error is smooth in the shift
        candidates = [
            (best[0] + i, best[1] + j)
            for i in np.arange(-span, span + step / 2, step)
            for j in np.arange(-span, span + step / 2, step)
            if max(abs(best[0] + i), abs(best[1] + j)) <= max_shift_px + 1e-9
        ]
        errors = [float(np.mean((shifted(*c) - reference) ** 2)) for c in candidates]
        best = candidates[int(np.argmin(errors))]
        if step <= _ALIGNED_STEP_PX:
            return shifted(*best), reference
        span = step
        step /= 2
