"""Codes that differ from one in a few chips: their OTF is its own, changed by one row of the chip basis per chip."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cep.search.objective import Objective

__all__ = ["cheapest", "otf_nearby"]

Codes = NDArray[np.int8]
Indices = NDArray[np.intp]
RealArray = NDArray[Any]
_BATCH = 2**18  # numbers of an OTF evaluated at once: they stay in the cache
_SPARSE = 8  # one frequency in so many already refuses nearly every code


def otf_nearby(objective: Objective, code: Codes, otf: RealArray, codes: Codes) -> RealArray:
    """OTF (R, 2, F) of (R, n) codes near a code (n,) whose OTF (2, F) is known: the work grows with what differs."""
    chips, variants = objective.rows.shape[:2]
    change = codes - code
    which, chip = np.nonzero(change)
    row = chip
    if variants == 4:
        # chips turn over one after the other from the first: the left neighbour has done so, the right one has not
        left, right = np.pad(codes, ((0, 0), (1, 0)))[which, chip], np.pad(code, (0, 1))[chip + 1]
        row = 4 * chip + 2 * left + right
    signs = change[which, chip].astype(objective.rows.dtype)
    ends = np.searchsorted(which, np.arange(len(codes) + 1))
    changed = csr_array((signs, row, ends), shape=(len(codes), chips * variants)) @ objective.rows.reshape(
        chips * variants, -1
    )
    changed += otf.ravel()
    return np.asarray(changed.reshape(len(codes), *otf.shape))


def cheapest(objective: Objective, code: Codes, codes: Codes, *, most: int, below: float) -> Iterator[Indices]:
    """Find the cheapest of (R, n) codes near a code (n,), as far as they cost less than ``below`` dB.

    Yields
    ------
    (``most`` or fewer,) int
        Indices of the cheapest so far, in their order; after the last codes, the answer.
    """
    judges = [(judge, judge.otf(code[None])[0]) for judge in _judges(objective)]
    step = max(1, _BATCH // judges[0][1].size)
    found, costs = np.empty(0, np.intp), np.empty(0)
    for start in range(0, len(codes), step):
        limit = below if found.size < most else float(costs[-1])
        left, now = np.arange(start, min(start + step, len(codes))), np.empty(0)
        for judge, otf in judges:
            now = judge.cost(otf_nearby(judge, code, otf, codes[left]), judge.duty(codes[left]))
            left, now = left[now < limit], now[now < limit]
        found, costs = np.append(found, left), np.append(costs, now)
        order = np.argsort(costs, kind="stable")[:most]
        found, costs = found[order], costs[order]
        yield found


def _judges(objective: Objective) -> list[Objective]:
    """Return the objective, and before it a quick one that never costs more, where a minimum is all that counts."""
    if any(name != "min-mtf" for name, _ in objective.problem.objective_mix):
        return [objective]
    kept = [np.arange(part.columns.start, part.columns.stop, _SPARSE) for part in objective.parts]
    ends = np.cumsum([0, *(columns.size for columns in kept)]).tolist()
    few = copy(objective)
    few.rows = np.ascontiguousarray(objective.rows[..., np.concatenate(kept)])
    # a minimum takes nothing of a part but its columns
    few.parts = tuple(
        replace(part, columns=slice(*bounds)) for part, bounds in zip(objective.parts, pairwise(ends), strict=True)
    )
    return [few, objective]
