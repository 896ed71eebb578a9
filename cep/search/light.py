"""Codes that gather light without a search of chips: the best snapshot, the best strobe, and random codes.

They are judged by a problem's own objective, and need not keep its limits, but for the random ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.search.objective import Objective

__all__ = ["RandomCodes", "best_snapshot", "best_strobe", "random_codes"]

Codes = NDArray[np.int8]
FloatArray = NDArray[np.float64]
_LENGTHS, _STARTS = 32, 16  # snapshots looked at before the best one is moved chip by chip
_PERIODS, _WIDTHS = 64, 32  # of strobes
_BATCH = 2**21  # numbers evaluated at once: 16 MB


@dataclass(frozen=True)
class RandomCodes:
    """Codes drawn within the limits, all equally likely, best first.

    Attributes
    ----------
    codes : (count, n) int8 of 0 and 1
    costs_db : (count,) float
        The objective's, lower is better.
    """

    codes: Codes
    costs_db: FloatArray

    @property
    def middle(self) -> ShutterCode:
        """The code of the median cost; of an even number, the worse of the two in the middle."""
        return ShutterCode.from_array(self.codes[len(self.codes) // 2])

    def quantiles_db(self, shares: Sequence[float] = (0.1, 0.5, 0.9)) -> FloatArray:
        """Cost that each share of the codes, 0..1, does not exceed: how far they spread."""
        return np.asarray(np.quantile(self.costs_db, list(shares)), dtype=np.float64)


def random_codes(objective: Objective, count: int, *, rng: np.random.Generator) -> RandomCodes:
    """Draw ``count`` codes within the limits of the objective's problem.

    Raises
    ------
    ValueError
        If the count is below 1.
    """
    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")
    drawn = objective.problem.random_codes(count, rng=rng)
    costs = _costs(objective, drawn)
    order = np.argsort(costs, kind="stable")
    return RandomCodes(drawn[order], costs[order])


def best_snapshot(objective: Objective) -> ShutterCode:
    """Find the best single open run, of any length and anywhere in the exposure.

    With the objective "mse" its length is the one of least noise for the problem's camera. Up to 32 lengths and 16
    starts are looked at, then the best of these is moved and stretched by single chips while that helps.
    """
    n = objective.problem.chips
    runs = [
        (int(start), int(start) + int(length))
        for length in _spread(1, n, _LENGTHS)
        for start in _spread(0, n - int(length), _STARTS)
    ]
    chip = np.arange(n)
    best, lowest = (0, n), np.inf
    while runs:
        drawn = np.array([(chip >= first) & (chip < end) for first, end in runs], dtype=np.int8)
        costs = _costs(objective, drawn)
        if costs.min() >= lowest:
            break
        best, lowest = runs[int(costs.argmin())], float(costs.min())
        near = [(best[0] + a, best[1] + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
        runs = [(first, end) for first, end in near if 0 <= first < end <= n]
    return ShutterCode("0" * best[0] + "1" * (best[1] - best[0]) + "0" * (n - best[1]))


def best_strobe(objective: Objective) -> ShutterCode:
    """Find the best periodic pulses: ``width`` chips open out of every ``period``, two pulses or more.

    The first pulse begins with the exposure. Every period and width is tried, of long codes 64 periods and 32 widths
    each. Along a uniform straight motion a periodic code has true zeros: "mse" alone is an objective for all motions.

    Raises
    ------
    ValueError
        If a code of one or two chips is asked for: two pulses do not fit.
    """
    n = objective.problem.chips
    if n < 3:
        raise ValueError(f"chips: a strobe needs at least 3, got {n}")
    chip = np.arange(n)
    drawn = [
        (chip % period) < width for period in _spread(2, n - 1, _PERIODS) for width in _spread(1, period - 1, _WIDTHS)
    ]
    codes = np.array(drawn, dtype=np.int8)
    return ShutterCode.from_array(codes[int(_costs(objective, codes).argmin())])


def _spread(first: int, last: int, most: int) -> NDArray[np.intp]:
    """Whole numbers from ``first`` to ``last``: all, or ``most`` evenly spread."""
    count = last - first + 1
    return np.unique(np.linspace(first, last, min(count, most)).round().astype(np.intp))


def _costs(objective: Objective, codes: Codes) -> FloatArray:
    step = max(1, _BATCH // objective.rows[0].size)
    return np.concatenate([objective.cost_of(codes[i : i + step]) for i in range(0, len(codes), step)])
