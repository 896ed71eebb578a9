"""The end of a search: the best codes judged on the continuum, and climbed from over all single flips and swaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.band import straight_axis
from cep.code import ShutterCode
from cep.search.annealing.nearby import cheapest
from cep.search.objective import Objective
from cep.search.problem import SearchProblem

__all__ = ["Polished", "neighbours", "polish"]

Codes = NDArray[np.int8]
_HOPEFUL = 8  # neighbours judged on the continuum in a step
_MOST_WORK = 2**39  # numbers times chips of a step; beyond, as for very long codes, swaps are left out


class Polished(NamedTuple):
    """How far a polish has come.

    Attributes
    ----------
    code : ShutterCode
        The best so far.
    cost : float
        Its cost in dB, with minima over the continuum.
    done : float
        Fraction of the leaders climbed from, 0..1.
    """

    code: ShutterCode
    cost: float
    done: float


def polish(problem: SearchProblem, ranked: Codes) -> Iterator[Polished]:
    """Judge (R, n) codes, best first, on the continuum, and climb from the leaders.

    Yields
    ------
    Polished
        After every piece of work, so that the caller may stop; the last one is the outcome.
    """
    fine = Objective(problem, oversampling=64, dtype=np.float64)
    curved = any(straight_axis(s.trajectory) is None for s in problem.scenarios)
    judged, climbed = (4, 1) if curved else (len(ranked), 6)
    leaders: list[tuple[float, str, ShutterCode]] = []
    for code in (ShutterCode.from_array(array) for array in ranked[:judged]):
        leaders = sorted([*leaders, (fine.exact_cost(code), code.bits, code)])[:climbed]
        yield Polished(leaders[0][2], leaders[0][0], 0.0)
    best, best_cost = leaders[0][2], leaders[0][0]
    for number, (start_cost, _, start) in enumerate(leaders):
        for cost, code in _climb(problem, fine, start, start_cost):
            if cost < best_cost:
                best, best_cost = code, cost
            yield Polished(best, best_cost, number / len(leaders))


def _climb(
    problem: SearchProblem, fine: Objective, code: ShutterCode, cost: float
) -> Iterator[tuple[float, ShutterCode]]:
    """Go to the best neighbour until none is better; where it stands, after every piece of work."""
    swaps = code.chips**2 // 4 * fine.rows[0].size * code.chips <= _MOST_WORK
    while True:
        bits = code.array.astype(np.int8)
        codes, below = neighbours(problem, bits, swaps=swaps), cost - 1e-9
        hopeful: NDArray[np.intp] = np.empty(0, np.intp)
        # a minimum over the continuum is never above the sampled one: only these can win
        for found_yet in cheapest(fine, bits, codes, most=_HOPEFUL, below=below):
            hopeful = found_yet
            yield cost, code
        found = [(fine.exact_cost(c), c) for c in (ShutterCode.from_array(codes[i]) for i in hopeful)]
        best = min(found, key=lambda pair: pair[0], default=(cost, code))
        if best[0] >= below:
            return
        cost, code = best
        yield cost, code


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
