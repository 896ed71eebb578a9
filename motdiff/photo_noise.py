"""Noise of a photo, measured in the photo itself."""

from __future__ import annotations

import numpy as np

from motdiff.types import FloatArray

LEAST_SIGMA = 1e-3
"""Least noise to reckon with, of full scale, a quarter of a step of 8 bits: simulated photos have
none, smoothed files show less than they have, and nothing divides by 0."""


def noise_sigma(photo: FloatArray) -> float:
    """Estimate the sigma of white noise in a photo (H, W) from mixed second differences.

    The photo has at least 3 x 3 px; the sigma is in its unit.

    References
    ----------
    Immerkaer, "Fast noise variance estimation", CVIU 1996; here with the median, which blurred
    edges leave alone.

    Examples
    --------
    >>> slope = np.linspace(0.2, 0.4, 200)[:, None] * np.ones(200)
    >>> noise = 0.01 * np.random.default_rng(0).standard_normal(slope.shape)
    >>> round(noise_sigma(slope + noise), 3)
    0.01
    """
    second = photo[:, :-2] - 2 * photo[:, 1:-1] + photo[:, 2:]
    mixed = second[:-2] - 2 * second[1:-1] + second[2:]
    # 0.6745: median of |x| for a standard normal x; 6: norm of the mask (1, -2, 1) x (1, -2, 1)
    return float(np.median(np.abs(mixed)) / 0.6745 / 6)


def shared_sigma(crops: FloatArray) -> float:
    """Noise that crops (C, H, W) share: the median of their :func:`noise_sigma`."""
    return float(np.median([noise_sigma(crop) for crop in crops]))
