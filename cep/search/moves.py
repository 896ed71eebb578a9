"""Moves of the annealer, one for each of many chains: flips and swaps, and shifts of blocks under run limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.search.problem import SearchProblem

__all__ = ["Change", "propose"]

_TRIES = 8  # proposals a chain draws under run limits, to have one that keeps them


@dataclass(frozen=True)
class Change:
    """Proposed codes.

    Attributes
    ----------
    codes : (R, n) int8
    opened : (R,) int
        Chips opened less chips closed.
    allowed : (R,) bool
        Whether the code keeps the limits.
    on, off : (R,) int
        Chip that opens and chip that closes, -1 for none; ``difference`` says it when more chips change.
    difference : (R, n) int8 or None
    """

    codes: NDArray[np.int8]
    opened: NDArray[np.intp]
    allowed: NDArray[np.bool_]
    on: NDArray[np.intp]
    off: NDArray[np.intp]
    difference: NDArray[np.int8] | None

    def applied(self, otf: NDArray[Any], basis: NDArray[Any]) -> NDArray[Any]:
        """(R, 2, F) OTFs of the new codes from those of the old: one row of the basis per chip that changes."""
        if self.difference is not None:
            flat = self.difference.astype(basis.dtype) @ basis.reshape(len(basis), -1)
            return np.asarray(otf + flat.reshape(otf.shape))
        changed = otf.copy()
        some = self.on >= 0
        if some.all():
            changed += basis[self.on]
        else:
            changed[some] += basis[self.on[some]]
        some = self.off >= 0
        if some.all():
            changed -= basis[self.off]
        else:
            changed[some] -= basis[self.off[some]]
        return changed


def propose(problem: SearchProblem, codes: NDArray[np.int8], *, rng: np.random.Generator) -> Change:
    """Propose one move per chain for (R, n) codes within the limits."""
    if problem.constrained:
        return _block_moves(problem, codes, rng)
    return _flips_and_swaps(problem, codes, rng)


def _flips_and_swaps(problem: SearchProblem, codes: NDArray[np.int8], rng: np.random.Generator) -> Change:
    count, n = codes.shape
    low, high = problem.open_limits
    rows = np.arange(count)
    # the largest of random keys among open chips is a uniform draw among them
    keys = rng.random((count, n), dtype=np.float32)
    off = np.where(codes == 1, keys, -1).argmax(axis=1)
    on = np.where(codes == 0, keys, -1).argmax(axis=1)
    open_chips = codes.sum(axis=1, dtype=np.intp)
    on[open_chips == n] = -1
    if low < high:
        kind = rng.random(count)
        on[kind < 0.25] = -1
        off[kind > 0.75] = -1
    new = codes.copy()
    has_on, has_off = on >= 0, off >= 0
    new[rows[has_on], on[has_on]] = 1
    new[rows[has_off], off[has_off]] = 0
    opened = has_on.astype(np.intp) - has_off.astype(np.intp)
    total = open_chips + opened
    return Change(new, opened, (total >= low) & (total <= high), on, off, None)


def _block_moves(problem: SearchProblem, codes: NDArray[np.int8], rng: np.random.Generator) -> Change:
    """Swap two chips, flip a block, or cut a block out and put it elsewhere; the first that keeps the limits."""
    count, n = codes.shape
    low, high = problem.open_limits
    trial = np.repeat(codes, _TRIES, axis=0)
    longest = min(n, max(problem.min_open, problem.min_closed) + 1)
    kinds = rng.choice(3, len(trial), p=(0.2, 0.3 if low < high else 0.0, 0.5 if low < high else 0.8))
    ends = rng.integers(0, n, (len(trial), 2))
    lengths = rng.integers(1, longest + 1, len(trial))
    for row, kind, (first, second), length in zip(trial, kinds, ends, lengths, strict=True):
        if kind == 0:
            row[first], row[second] = row[second], row[first]
        elif kind == 1:
            row[first : first + length] = 1 - row[first]
        else:
            # rolling an interval by `length` moves a block from one of its ends to the other
            low_end, high_end = min(first, second), max(first, second) + 1
            sign = 1 if first < second else -1
            row[low_end:high_end] = np.roll(row[low_end:high_end], sign * length)
    fits = (problem.satisfied(trial) & (trial != np.repeat(codes, _TRIES, axis=0)).any(axis=1)).reshape(count, _TRIES)
    pick = fits.argmax(axis=1)
    new = trial.reshape(count, _TRIES, n)[np.arange(count), pick]
    allowed = fits.any(axis=1)
    new[~allowed] = codes[~allowed]
    difference = new - codes
    nobody = np.full(count, -1)
    return Change(new, difference.sum(axis=1, dtype=np.intp), allowed, nobody, nobody, difference)
