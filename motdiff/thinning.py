"""Fewer samples of a path that is dense in time, without moving it at any time by more than a tolerance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["thinned_knots"]

FloatArray = NDArray[np.float64]


def thinned_knots(t: FloatArray, xy: FloatArray, tolerance_px: float) -> NDArray[np.intp]:
    """Choose samples between which a path is straight in space and time, to within a tolerance.

    Neighbouring intervals are joined in pairs, these in pairs again, and so on, as long as every sample between the
    ends lies within the tolerance of the straight, uniform motion between them. That takes O(T log T), or O(T) where
    nothing can be joined, and gives up to a few times as many samples as the fewest possible.

    Parameters
    ----------
    t : (T,) float, increasing
    xy : (T, 2) float, px
    tolerance_px : float
        Largest distance, at equal times, between the path and the one through the chosen samples.

    Returns
    -------
    (K,) int, increasing, from 0 to T - 1
    """
    kept = np.ones(t.size, dtype=bool)
    joined: NDArray[np.bool_] = np.ones(t.size - 1, dtype=bool)  # whether each block of intervals is straight
    width = 1
    while joined.size > 1:
        width *= 2
        blocks = joined.size // 2
        straight: NDArray[np.bool_] = np.asarray(joined[: 2 * blocks].reshape(blocks, 2).all(axis=1))
        candidates = np.flatnonzero(straight)
        if not candidates.size:
            break
        first, last = candidates * width, (candidates + 1) * width
        times = t[: blocks * width].reshape(blocks, width)[candidates]
        share = (times - t[first, None]) / (t[last] - t[first])[:, None]
        distance2 = np.zeros(share.shape)
        for column in xy.T:
            start = column[first, None]
            chord = start + share * (column[last, None] - start)
            distance2 += (column[: blocks * width].reshape(blocks, width)[candidates] - chord) ** 2
        fits = distance2.max(axis=1) <= tolerance_px**2
        straight[candidates] = fits
        kept[first[fits] + width // 2] = False
        joined = straight
    return np.flatnonzero(kept)
