"""Which of the drawn, classical and refined kernels to believe, and how much."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["FEATURES", "features", "probabilities"]

FloatArray = NDArray[np.float64]

FEATURES = ("spectral_fit", "phase_evidence", "rim_light", "sample_agreement", "classical_agreement")

# Fitted on simulated photos of the training set's held-out scenes, see docs/decisions/network.md
_WEIGHTS = np.array([0.8, 2.0, -1.0, 0.2, 0.2])
_SLOPE, _OFFSET = 12.5, -8.5


def features(evidence: FloatArray, alike: FloatArray, *, samples: int, classical: int) -> FloatArray:
    """Features (N, 5) of N candidate kernels: first the samples, then the classical kernels, then others.

    Parameters
    ----------
    evidence : (N, 3) float
        From :meth:`motdiff.estimators.judge.Judge.evidence`.
    alike : (N, N) float
        MNC of every pair, see :func:`motdiff.metrics.mnc_matrix`.
    samples, classical : int
        How many there are of the first two.

    Returns
    -------
    (N, 5) float: the evidence, and the mean MNC with the samples and with the classical kernels (without itself).
    """
    alike = alike * (1 - np.eye(len(alike)))
    index = np.arange(len(alike))
    among_samples = alike[:, :samples].sum(axis=1) / np.maximum(samples - (index < samples), 1)
    is_classical = (index >= samples) & (index < samples + classical)
    among_classical = alike[:, samples : samples + classical].sum(axis=1) / np.maximum(classical - is_classical, 1)
    return np.column_stack([evidence, among_samples, among_classical])


def probabilities(rows: FloatArray) -> FloatArray:
    """Probability (N,) of each candidate to have a sub-pixel MNC of 0.7 or more, from its features (N, 5)."""
    return np.asarray(1 / (1 + np.exp(-(_SLOPE * (rows @ _WEIGHTS) + _OFFSET))), dtype=np.float64)
