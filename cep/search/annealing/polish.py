"""The end of a search: the best codes judged on the continuum, and climbed from over all single flips and swaps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cep.band import straight_axis
from cep.code import ShutterCode
from cep.search.objective import Objective
from cep.search.problem import SearchProblem

__all__ = ["neighbours", "polish"]

Codes = NDArray[np.int8]
_HOPEFUL = 8  # neighbours judged on the continuum in a step
_BATCH = 2**21  # numbers evaluated at once: 16 MB
_MOST_WORK = 2**33  # numbers evaluated in a step; beyond, as for long codes, swaps are left out


def polish(problem: SearchProblem, ranked: Codes) -> tuple[ShutterCode, float]:
    """Judge (R, n) codes, best first, on the continuum, and climb from the leaders; the best code and its cost in dB.

    Raises
    ------
    KeyboardInterrupt
        As it comes; the caller has the codes.
    """
    fine = Objective(problem, oversampling=64, dtype=np.float64)
    curved = any(straight_axis(s.trajectory) is None for s in problem.scenarios)
    judged, climbed = (4, 1) if curved else (len(ranked), 6)
    codes = [ShutterCode.from_array(code) for code in ranked[:judged]]
    leaders = sorted((fine.exact_cost(code), code.bits, code) for code in codes)[:climbed]
    cost, code = min((_climb(problem, fine, code, cost) for cost, _, code in leaders), key=lambda pair: pair[0])
    return code, cost


def _climb(problem: SearchProblem, fine: Objective, code: ShutterCode, cost: float) -> tuple[float, ShutterCode]:
    numbers = fine.rows[0].size
    step = max(1, _BATCH // numbers)
    swaps = code.chips**2 // 4 * numbers * code.chips <= _MOST_WORK * 64
    while True:
        codes = neighbours(problem, code.array.astype(np.int8), swaps=swaps)
        if not len(codes):
            return cost, code
        sampled = np.concatenate([fine.cost_of(codes[i : i + step]) for i in range(0, len(codes), step)])
        # a minimum over the continuum is never above the sampled one: only these can win
        hopeful = np.argsort(sampled)[:_HOPEFUL]
        hopeful = hopeful[sampled[hopeful] < cost - 1e-9]
        found = [(fine.exact_cost(c), c) for c in (ShutterCode.from_array(codes[i]) for i in hopeful)]
        best = min(found, key=lambda pair: pair[0], default=(cost, code))
        if best[0] >= cost - 1e-9:
            return cost, code
        cost, code = best


def neighbours(problem: SearchProblem, bits: Codes, *, swaps: bool) -> Codes:
    """Codes within the limits that differ by one flip or, with ``swaps``, one open chip exchanged for a closed one."""
    flips = np.repeat(bits[None], len(bits), axis=0)
    flips[np.arange(len(bits)), np.arange(len(bits))] ^= 1
    codes = [flips]
    if swaps:
        first, second = (grid.ravel() for grid in np.meshgrid(np.flatnonzero(bits), np.flatnonzero(bits == 0)))
        swapped = np.repeat(bits[None], first.size, axis=0)
        swapped[np.arange(first.size), first] = 0
        swapped[np.arange(first.size), second] = 1
        codes.append(swapped)
    every = np.concatenate(codes)
    return every[problem.satisfied(every)]
