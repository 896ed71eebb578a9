"""Metrics of the tables alone: order of a path, SSIM up to shift, a PSF laid on the true one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from motdiff.metrics import best_aligned, psnr, register_shift
from motdiff.path_psfs import interpolated
from motdiff.psf_frame import moved
from motdiff.trajectory import arc_lengths, checked_points
from motdiff.types import FloatArray

_SPACING_PX = 0.25  # of the points that are matched


def laid_on(truth: ArrayLike, psf: ArrayLike) -> FloatArray:
    """Move a ``psf``, blind and so shifted, onto ``truth`` by whole pixels; its frame grows."""
    right_px, down_px = (round(shift) for shift in register_shift(truth, psf))
    return moved(psf, down_px=down_px, right_px=right_px)


def ordered_distance_px(a: ArrayLike, b: ArrayLike) -> float:
    """Mean distance, px, of two paths under their best monotone matching, better direction.

    Dynamic time warping over points evenly spaced along both paths: small errors of arc length do
    not add up, as they do in :func:`~motdiff.metrics.path_distance_px`, but a loop run the wrong
    way round counts in full. Nothing is centred.

    Parameters
    ----------
    a, b : (N, 2) and (M, 2) array_like, px
        Ordered points.

    Raises
    ------
    ValueError
        If a path is not finite (N, 2) points.
    """
    p = _evenly_spaced("a", a)
    q = _evenly_spaced("b", b)
    distance = np.linalg.norm(p[:, None] - q[None], axis=-1)
    return min(_warped_mean(distance), _warped_mean(distance[:, ::-1]))


def psnr_ssim_up_to_shift(
    restored: ArrayLike,
    sharp: ArrayLike,
    *,
    max_shift_px: float = 5.0,
    crop_px: int = 15,
) -> tuple[float, float]:
    """PSNR, dB, of :func:`~motdiff.metrics.psnr_up_to_shift`, and the SSIM at that shift."""
    aligned, target = best_aligned(restored, sharp, max_shift_px, crop_px)
    return psnr(aligned, target), _ssim(aligned, target)


def _ssim(image: FloatArray, target: FloatArray) -> float:
    from skimage.metrics import structural_similarity

    channel_axis = 2 if image.ndim == 3 else None
    score: float = structural_similarity(image, target, data_range=1.0, channel_axis=channel_axis)
    return float(score)


def _evenly_spaced(name: str, path: ArrayLike) -> FloatArray:
    points = checked_points(name, path)
    arc = arc_lengths(points)
    where = np.linspace(0, arc[-1], max(2, int(np.ceil(arc[-1] / _SPACING_PX)) + 1))
    return interpolated(where, arc, points)


def _warped_mean(distance: FloatArray) -> float:
    """Least sum over monotone matchings from corner to corner, per matched pair."""
    best = np.empty_like(distance)
    best[0] = np.cumsum(distance[0])
    for i in range(1, len(distance)):
        # from above, straight or diagonally
        entered = np.minimum(best[i - 1], np.r_[np.inf, best[i - 1, :-1]])
        # best[j] = d[j] + min(entered[j], best[j - 1]), unrolled along the row by prefix sums
        run = np.cumsum(distance[i])
        best[i] = run + np.minimum.accumulate(entered - run + distance[i])
    i, j = np.subtract(distance.shape, 1).tolist()
    pairs = 1
    while i or j:
        steps = [(i - 1, j - 1), (i - 1, j), (i, j - 1)]
        i, j = min((step for step in steps if min(step) >= 0), key=lambda step: best[step])
        pairs += 1
    return float(best[-1, -1] / pairs)
