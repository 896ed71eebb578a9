"""Polish of a search's best codes over the continuum: local search by flips and swaps."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cep.optics.code import ShutterCode
from cep.search.cost import CodeCost
from cep.search.problem import SearchProblem

Codes = NDArray[np.int8]
Indices = NDArray[np.intp]
RealArray = NDArray[Any]
BATCH = 2**18  # numbers of an OTF evaluated at once: they stay in the cache
_HOPEFUL = 8  # neighbours evaluated on the continuum in a step
# numbers times chips of a step; beyond, as for very long codes, swaps are left out
_MOST_WORK = 2**39
_SPARSE = 8  # one frequency in so many suffices to reject nearly every code
GAIN_DB = 1e-9  # a smaller one is rounding, which could exchange two equal codes without end


class Polished(NamedTuple):
    """State of a polish.

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


def polish(fine: CodeCost, ranked: Codes, *, swaps: bool = True) -> Iterator[Polished]:
    """Evaluate (R, n) codes, best first, and climb from the leaders by flips, and by ``swaps``.

    Yields
    ------
    Polished
        After every piece of work, so that the caller may stop; the last one is the outcome.
    """
    evaluated = len(ranked)
    climbed = 6
    if not fine.problem.straight:
        # a minimum over a plane of frequencies takes so much longer than one along a line
        evaluated = 4
        climbed = 1
    leaders: list[tuple[float, str, ShutterCode]] = []
    for code in (ShutterCode(array) for array in ranked[:evaluated]):
        leaders = sorted([*leaders, (fine.exact_cost(code), code.bits, code)])[:climbed]
        yield Polished(leaders[0][2], leaders[0][0], 0.0)
    best = leaders[0][2]
    best_cost = leaders[0][0]
    for number, (start_cost, _, start) in enumerate(leaders):
        for cost, code in _climb(fine, start, start_cost, swaps=swaps):
            if cost < best_cost:
                best = code
                best_cost = cost
            yield Polished(best, best_cost, number / len(leaders))


def _climb(
    fine: CodeCost, code: ShutterCode, cost: float, *, swaps: bool
) -> Iterator[tuple[float, ShutterCode]]:
    """Go to the best neighbour until none is better; yields where it stands, now and then."""
    swaps = swaps and code.chips**2 // 4 * fine.rows[0].size * code.chips <= _MOST_WORK
    while True:
        bits = code.array.astype(np.int8)
        codes = neighbours(fine.problem, bits, swaps=swaps)
        below = cost - GAIN_DB
        hopeful = np.empty(0, np.intp)
        # a minimum over the continuum is never above the sampled one: only these can win
        for indices in cheapest(fine, bits, codes, count=_HOPEFUL, below=below):
            hopeful = indices
            yield cost, code
        candidates = [ShutterCode(codes[index]) for index in hopeful]
        costs = [(fine.exact_cost(candidate), candidate) for candidate in candidates]
        best = min(costs, key=lambda pair: pair[0], default=(cost, code))
        if best[0] >= below:
            return
        cost, code = best
        yield cost, code


def neighbours(problem: SearchProblem, bits: Codes, *, swaps: bool) -> Codes:
    """Codes within the limits that differ by one flip, or with ``swaps`` by one swap.

    A swap exchanges an open chip for a closed one.
    """
    flips = np.repeat(bits[None], len(bits), axis=0)
    flips[np.arange(len(bits)), np.arange(len(bits))] ^= 1
    codes = [flips]
    if swaps:
        first, second = (
            grid.ravel() for grid in np.meshgrid(np.flatnonzero(bits), np.flatnonzero(bits == 0))
        )
        swapped = np.repeat(bits[None], first.size, axis=0)
        swapped[np.arange(first.size), first] = 0
        swapped[np.arange(first.size), second] = 1
        codes.append(swapped)
    candidates = np.concatenate(codes)
    return candidates[problem.satisfied(candidates)]


def otf_nearby(code_cost: CodeCost, code: Codes, otf: RealArray, codes: Codes) -> RealArray:
    """OTF (R, 2, F) of (R, n) codes near a code (n,) of OTF (2, F), by the changed chips alone."""
    chips, variants = code_cost.rows.shape[:2]
    change = codes - code
    which, chip = np.nonzero(change)
    row = chip
    if variants == 4:
        # chips turn over one after the other from the first: the left neighbour has done so, the
        # right one has not
        left_open = np.pad(codes, ((0, 0), (1, 0)))[which, chip]
        right_open = np.pad(code, (0, 1))[chip + 1]
        row = 4 * chip + 2 * left_open + right_open
    signs = change[which, chip].astype(code_cost.rows.dtype)
    row_starts = np.searchsorted(which, np.arange(len(codes) + 1))
    # few chips change, so that a sparse product costs a fraction of the full one
    changed = csr_array(
        (signs, row, row_starts), shape=(len(codes), chips * variants)
    ) @ code_cost.rows.reshape(chips * variants, -1)
    changed += otf.ravel()
    return np.asarray(changed.reshape(len(codes), *otf.shape))


def cheapest(
    code_cost: CodeCost, code: Codes, codes: Codes, *, count: int, below: float
) -> Iterator[Indices]:
    """Find the cheapest of (R, n) codes near a code (n,) that cost less than ``below`` dB.

    Yields
    ------
    (``count`` or fewer,) int
        Indices of the cheapest so far, in their order; after the last codes, the answer.
    """
    judges = [(judge, judge.otf(code[None])[0]) for judge in _judges(code_cost)]
    step = max(1, BATCH // judges[0][1].size)
    indices = np.empty(0, np.intp)
    costs = np.empty(0)
    for start in range(0, len(codes), step):
        limit = below
        if indices.size >= count:  # only what is cheaper than the last of them counts now
            limit = float(costs[-1])
        candidates = np.arange(start, min(start + step, len(codes)))
        candidate_costs = np.empty(0)
        for judge, otf in judges:
            batch = codes[candidates]
            candidate_costs = judge.cost(
                otf_nearby(judge, code, otf, batch), judge.duty(batch), judge.noise_of(batch)
            )
            candidates = candidates[candidate_costs < limit]
            candidate_costs = candidate_costs[candidate_costs < limit]
        indices = np.append(indices, candidates)
        costs = np.append(costs, candidate_costs)
        order = np.argsort(costs, kind="stable")[:count]
        indices = indices[order]
        costs = costs[order]
        yield indices


def _judges(code_cost: CodeCost) -> list[CodeCost]:
    """Return the cost, and where a minimum is all that counts a quick one before it."""
    # the minimum over a part of the frequencies is never lower: it never costs more
    if any(name != "min-mtf" for name, _ in code_cost.problem.objective_mix):
        return [code_cost]
    columns_by_part = [
        np.arange(motion.columns.start, motion.columns.stop, _SPARSE) for motion in code_cost.parts
    ]
    edges = np.cumsum([0, *(columns.size for columns in columns_by_part)]).tolist()
    few = copy(code_cost)
    columns = np.concatenate(columns_by_part)
    few.rows = np.ascontiguousarray(code_cost.rows[..., columns])
    few.floor = code_cost.floor[columns]
    if code_cost.open_half is not None:
        few.open_half = code_cost.open_half[:, columns]
    # a minimum takes nothing of a part but its columns
    few.parts = tuple(
        replace(motion, columns=slice(*bounds))
        for motion, bounds in zip(code_cost.parts, pairwise(edges), strict=True)
    )
    return [few, code_cost]
