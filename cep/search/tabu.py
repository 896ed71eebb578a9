"""Tabu search: always the best of all flips and swaps, even uphill, but never soon back the way it came.

Annealing looks at one random move of a chain at a time; here every move of one code is judged at once, from
``|H + D|^2 = |H|^2 + 2 Re(H* D) + |D|^2`` with the ``|D|^2`` of all pairs of chips kept. That takes memory for
chips^2 x frequencies, so it is for motions whose basis is small: straight ones.

References
----------
Gallardo, Cotta and Fernandez, "Finding low autocorrelation binary sequences with memetic algorithms", Applied Soft
Computing 2009: tabu search with short random tenures and restarts on a problem of the same kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.band import straight_axis
from cep.search.objective import Objective

__all__ = ["TabuWalk", "fits"]

Codes = NDArray[np.int8]
_MOST_NUMBERS = 2**24  # of the pair table: 64 MB
_PATIENCE = 60  # steps without a better code before a walk ends
_TENURE = (2, 8)  # steps that a moved chip stays where it is, drawn at random
_KICK = (3, 9)  # swaps that start a walk from one of the best
_FRESH = 0.3  # share of walks that start from a random code
_POOL = 8
_CHECK = 16  # steps between looks at the clock


def fits(objective: Objective) -> bool:
    """Whether all motions are straight, the limits are on light alone and leave any move, and the pairs' table fits."""
    problem, (chips, _, frequencies) = objective.problem, objective.basis.shape
    straight = all(straight_axis(scenario.trajectory) is not None for scenario in problem.scenarios)
    free = not problem.constrained and problem.open_limits != (chips, chips)
    return straight and free and chips * chips * frequencies <= _MOST_NUMBERS


class TabuWalk:
    """Walks from kicked copies of the best codes so far.

    Parameters
    ----------
    objective : Objective
        Its soft cost leads.
    codes : (R, n) int8
        The best so far.
    """

    def __init__(self, objective: Objective, codes: Codes) -> None:
        self._objective = objective
        basis = objective.basis
        self._pool: list[tuple[float, bytes]] = []
        self._norm = (basis * basis).sum(axis=1)
        cross = 2 * np.einsum("icf,jcf->ijf", basis, basis)
        self._pairs = self._norm[:, None] + self._norm[None] - cross  # |B_i - B_j|^2
        costs = objective.cost(objective.otf(codes), codes.sum(axis=1, dtype=np.intp), soft=True)
        for code, cost in zip(codes, costs, strict=True):
            self._keep(code, float(cost))

    def walk(self, rng: np.random.Generator, offer: Callable[[Codes], None]) -> Iterator[int]:
        """Walk once; yields the moves judged between looks at the clock, and offers each code that was its best yet."""
        code, low, high = self._kicked(rng), *self._objective.problem.open_limits
        reached, held = code.copy(), np.zeros(code.size, dtype=np.intp)
        best, since, step, judged = np.inf, 0, 0, 0
        while since < _PATIENCE:
            step, since = step + 1, since + 1
            opened, closed = np.flatnonzero(code), np.flatnonzero(code == 0)
            on, off, costs = self._neighbours(code, opened, closed, low, high)
            free = (held[on] < step) & (held[off] < step)
            allowed = np.where(free | (costs < best), costs, np.inf)
            pick = int(allowed.argmin())
            if not np.isfinite(allowed[pick]):
                pick = int(rng.integers(costs.size))
            code = _moved(code, on[pick], off[pick])
            held[[on[pick], off[pick]]] = step + rng.integers(*_TENURE, size=2)
            if costs[pick] < best - 1e-6:
                best, since, reached = float(costs[pick]), 0, code
                offer(code[None])
            judged += costs.size
            if step % _CHECK == 0:
                yield judged
                judged = 0
        # one code a walk, or near copies would crowd the pool
        self._keep(reached, best)
        yield judged

    def _neighbours(
        self, code: Codes, opened: NDArray[np.intp], closed: NDArray[np.intp], low: int, high: int
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
        """Chips that open and that close, the same one for a flip, with the cost of each move."""
        basis, count = self._objective.basis, opened.size
        otf = self._objective.otf(code[None])[0]
        power = (otf * otf).sum(axis=0)
        slope: NDArray[Any] = 2 * (basis * otf).sum(axis=1)
        on, off = (grid.ravel() for grid in np.meshgrid(closed, opened, indexing="ij"))
        blocks = [(power + slope[closed])[:, None] - slope[opened][None] + self._pairs[closed[:, None], opened[None]]]
        numbers = [np.full(on.size, count)]
        flips: list[NDArray[np.intp]] = []
        if count < high:
            blocks.append((power + slope[closed] + self._norm[closed])[:, None])
            numbers.append(np.full(closed.size, count + 1))
            flips.append(closed)
        if count > low:
            blocks.append((power - slope[opened] + self._norm[opened])[:, None])
            numbers.append(np.full(count, count - 1))
            flips.append(opened)
        powers = np.concatenate([block.reshape(-1, power.size) for block in blocks])
        costs = self._objective.cost_of_power(powers, np.concatenate(numbers), soft=True)
        return np.concatenate([on, *flips]), np.concatenate([off, *flips]), costs

    def _kicked(self, rng: np.random.Generator) -> Codes:
        if not self._pool or rng.random() < _FRESH:
            drawn: Codes = self._objective.problem.random_codes(1, rng=rng)[0]
            return drawn
        code = np.frombuffer(self._pool[int(rng.integers(len(self._pool)))][1], dtype=np.int8).copy()
        opened, closed = np.flatnonzero(code), np.flatnonzero(code == 0)
        swaps = min(int(rng.integers(*_KICK)), opened.size, closed.size)
        code[rng.choice(opened, swaps, replace=False)] = 0
        code[rng.choice(closed, swaps, replace=False)] = 1
        return code

    def _keep(self, code: Codes, cost: float) -> None:
        entry = (cost, code.tobytes())
        if entry not in self._pool:
            self._pool = sorted([*self._pool, entry])[:_POOL]


def _moved(code: Codes, on: np.intp, off: np.intp) -> Codes:
    changed = code.copy()
    # a flip names its one chip twice
    changed[list({int(on), int(off)})] ^= 1
    return changed
