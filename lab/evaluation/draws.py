"""Figures of several draws of one kernel: the best, how alike they are, and whether the truth is
among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motdiff.metrics import mnc_matrix, mnc_subpixel
from motdiff.types import FloatArray


@dataclass(frozen=True)
class DrawFigures:
    """Figures of the draws for one photo.

    Attributes
    ----------
    best : float
        Sub-pixel MNC of the draw that is most like the true kernel.
    alike : float
        Mean MNC of two draws: 1 where all are the same guess.
    covered : bool
        False where the true kernel is the outlier: less like its nearest draw than every draw is
        like its nearest other kernel. Of K draws from the true distribution, a share of ``K / (K +
        1)`` of photos is covered.
    """

    best: float
    alike: float
    covered: bool


def measure_draws(draws: Sequence[FloatArray], truth: FloatArray) -> DrawFigures:
    """Measure draws of a photo's kernel.

    Parameters
    ----------
    draws : sequence of at least two (S, S) float
    truth : (S, S) float

    Raises
    ------
    ValueError
        If there are fewer than two draws, or a kernel is not finite or zero.

    Notes
    -----
    True kernel and draws of the right distribution are exchangeable: each of the K + 1 is the
    outlier with the same probability. The share of covered photos is therefore known without a
    density: lower means draws that are too alike, or wrong.
    """
    if len(draws) < 2:
        raise ValueError(f"draws: must be at least 2, got {len(draws)}")
    alike = mnc_matrix([truth, *draws])
    np.fill_diagonal(alike, -1.0)
    nearest = alike.max(axis=1)
    pairs = alike[1:, 1:][np.triu_indices(len(draws), 1)]
    best = max(mnc_subpixel(draw, truth) for draw in draws)
    return DrawFigures(best, float(pairs.mean()), bool(nearest[0] >= nearest[1:].min()))
