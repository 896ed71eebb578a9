"""Kernels of several photos of one scene, searched together: they share the latent photo."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy import fft, signal

from motdiff.crops import best_windows
from motdiff.estimators.kernel_score import rank_kernels
from motdiff.estimators.pmp.estimator import STARTS, searched_kernels
from motdiff.photo_noise import LEAST_SIGMA, noise_sigma
from motdiff.progress import Progress
from motdiff.psf_frame import PSF_PX, in_frame
from motdiff.threads import side_by_side
from motdiff.types import FloatArray

_FAINTEST = 1e-4  # of the largest noise power expected: below it, rounding is compared


def kernels_of_one_scene(
    photos: Sequence[FloatArray], *, progress: Progress | None = None, cost: float = 1.0
) -> tuple[tuple[FloatArray, ...], tuple[float, ...]]:
    """Search the kernels of photos of one scene, aligned to a few px, in the photos together.

    What one kernel extinguishes another lets through, so the latent photo and with it each kernel
    is known better than from a photo alone. Of several starts the one whose kernels agree best
    with the photos is chosen: ``k_1 * y_i = k_i * y_1``, whatever the scene.

    Parameters
    ----------
    photos : sequence of I >= 2 (H, W) float
    progress : Progress, optional
        Its plan holds ``cost`` for this work already.

    Returns
    -------
    I kernels (64, 64), sum 1, whose shifts against each other are the photos', and the
    probability that each is good

    References
    ----------
    Xu, Liu, Tong and Kailath, "A least-squares approach to blind channel identification", IEEE
    TSP 43(12), 1995 (the cross relation).
    """
    progress = progress or Progress()
    window = best_windows(photos[0], count=1)[0]
    level = photos[0].mean()
    crops = np.stack([photo[window] * (level / photo.mean()) for photo in photos])
    sigmas = np.maximum([noise_sigma(crop) for crop in crops], LEAST_SIGMA)
    piece = cost / len(STARTS)
    searches = side_by_side(
        [
            partial(
                searched_kernels,
                crops[:, None],
                start,
                sigma=float(np.median(sigmas)),
                one_scene=True,
                on_progress=progress.piece(piece),
            )
            for start in STARTS
        ]
    )
    kernels = min(searches, key=lambda candidates: _cross_misfit(crops, candidates, sigmas))
    confidences = [
        float(rank_kernels(crop[None], [kernel]).probabilities[0])
        for crop, kernel in zip(crops, kernels, strict=True)
    ]
    return tuple(in_frame(kernel, PSF_PX) for kernel in kernels), tuple(confidences)


def _cross_misfit(crops: FloatArray, kernels: FloatArray, sigmas: FloatArray) -> float:
    """Mean power of ``k_1 * y_i - k_i * y_1`` over that of the noise in it; about 1 to 2 if right.

    Within the frame, so that no border counts, and through a window.
    """
    ratios = []
    for crop, kernel, sigma in zip(crops[1:], kernels[1:], sigmas[1:], strict=True):
        difference = signal.fftconvolve(crop, kernels[0], "valid")
        difference -= signal.fftconvolve(crops[0], kernel, "valid")
        shape = difference.shape
        window = np.hanning(shape[0] + 2)[1:-1, None] * np.hanning(shape[1] + 2)[1:-1]
        power = np.abs(fft.fft2(difference * window)) ** 2 / np.square(window).sum()
        noise = sum(
            deviation**2 * np.abs(fft.fft2(through, shape)) ** 2
            for deviation, through in ((sigma, kernels[0]), (sigmas[0], kernel))
        )
        ratios.append(np.mean(power / (noise + _FAINTEST * noise.max())))
    return float(np.mean(ratios))
