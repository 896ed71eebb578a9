"""Steepest climb of the smallest |H|: quick, and only as good as a first limit for a proof has to be."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cep.search.exhaustive.exhaust import dot

__all__ = ["climbed"]

Patterns = NDArray[np.int8]
_LEAST = 1e-6  # relative gain of a step


def climbed(
    code: Patterns, basis: NDArray[np.complex128], satisfied: Callable[[Patterns], NDArray[np.bool_]]
) -> Patterns:
    """Flip the one or two chips that raise the smallest |H| most, for as long as any do.

    Parameters
    ----------
    code : (n,) int8
    basis : (n, Q) complex
        Contribution of each chip at each frequency.
    satisfied : callable
        Which of (R, n) codes may be visited.
    """
    first, second = np.triu_indices(code.size)
    best = -1.0
    while True:
        near = np.repeat(code[None], first.size, axis=0)
        rows = np.arange(first.size)
        near[rows, first] ^= 1
        # a pair of one chip and itself is a single flip
        near[rows, second] ^= (first != second).astype(np.int8)
        near = near[satisfied(near)]
        lowest = np.abs(dot(near, basis)).min(axis=1, initial=np.inf)
        if not len(near) or lowest.max() <= best + _LEAST * abs(best):
            return code
        code, best = near[lowest.argmax()], float(lowest.max())
