"""A second look at a code: where its zeros are, and which codes a few flips away are better."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray

from cep.band import band_samples
from cep.code import ShutterCode
from cep.exposure import chip_basis
from cep.minimum import Minimum, chip_minimum, min_chip, mtf_minimum
from motdiff.trajectory import Trajectory

__all__ = ["Neighbour", "better_neighbours", "minimum_along", "null_threshold"]

ComplexArray = NDArray[np.complex128]

_BATCH = 512
_REFINED = 12  # candidates of the grid whose minimum over the continuum is found
_WORTH = 1.001  # a neighbour must be better by more than rounding


@dataclass(frozen=True)
class Neighbour:
    """A code a few flips away.

    Attributes
    ----------
    flips : tuple of int
        Chips that differ, counted from 1.
    code : ShutterCode
    minimum : float
        Its minimum over the continuum: |P| in chips, or |H| along the trajectory.
    """

    flips: tuple[int, ...]
    code: ShutterCode
    minimum: float


def minimum_along(code: ShutterCode, trajectory: Trajectory | None) -> Minimum:
    """Bounds of the minimum: |P| over the circle in chips without a trajectory, else |H| for the worse direction."""
    if trajectory is None:
        return chip_minimum(code)
    forward = mtf_minimum(trajectory, code)
    if trajectory.direction == "known":
        return forward
    backward = mtf_minimum(trajectory.reversed(), code)
    worse = min(forward, backward, key=lambda found: found.upper)
    return Minimum(min(forward.lower, backward.lower), worse.upper, worse.at, worse.method)


def null_threshold(code: ShutterCode, trajectory: Trajectory | None) -> float:
    """Minimum below which a code has, for every practical purpose, a zero: a ten-thousandth of its DC."""
    return 1e-4 * (code.open_chips if trajectory is None else code.duty)


def better_neighbours(
    code: ShutterCode, trajectory: Trajectory | None = None, *, flips: int = 2, keep: int = 1
) -> tuple[Neighbour, ...]:
    """Find, for each number of flips up to ``flips``, the best codes that beat this one's minimum.

    Every combination is looked at on a grid of frequencies, and the best ones then over the continuum.

    Parameters
    ----------
    code : ShutterCode
    trajectory : Trajectory, optional
        Where the minimum counts; an unknown direction counts as the worse one. Chip units when omitted.
    flips : int
        Most chips changed.
    keep : int
        Codes returned per number of flips.

    Returns
    -------
    tuple of Neighbour, fewest flips first, better ones first within; empty when no neighbour is better.
    """
    basis = _basis(code.chips, trajectory)
    chips = code.array
    spectra = np.stack([chips @ part for part in basis])
    here = _exact(code, trajectory)
    found: list[Neighbour] = []
    for count in range(1, flips + 1):
        scored: list[tuple[float, tuple[int, ...]]] = []
        for places in _batches(code.chips, count):
            index = np.array(places)
            change = (1 - 2 * chips)[index]
            lowest = np.full(len(index), np.inf)
            for spectrum, part in zip(spectra, basis, strict=True):
                moved = np.broadcast_to(spectrum, (len(index), spectrum.size)).copy()
                for step in range(count):
                    moved += change[:, step, None] * part[index[:, step]]
                lowest = np.minimum(lowest, np.abs(moved).min(axis=1))
            scored.extend(zip(lowest.tolist(), places, strict=True))
            scored = sorted(scored, reverse=True)[:_REFINED]
        neighbours = [Neighbour(tuple(k + 1 for k in places), _flipped(code, places), 0.0) for _, places in scored]
        exact = [Neighbour(n.flips, n.code, _exact(n.code, trajectory)) for n in neighbours if n.code is not code]
        exact.sort(key=lambda n: n.minimum, reverse=True)
        found.extend(n for n in exact[:keep] if n.minimum > _WORTH * here)
    return tuple(found)


def _basis(chips: int, trajectory: Trajectory | None) -> list[ComplexArray]:
    """Spectra (n, F) of single chips, one table per direction that counts."""
    if trajectory is None:
        cycles = np.linspace(0, 0.5, 8 * chips + 1)
        return [np.exp(-2j * np.pi * np.arange(chips)[:, None] * cycles)]
    samples = band_samples(trajectory, oversampling=8)
    forward = chip_basis(trajectory, chips, samples.fx, samples.fy)
    # the reversed path draws the same chips in the opposite order
    return [forward] if trajectory.direction == "known" else [forward, forward[::-1]]


def _batches(chips: int, count: int) -> Iterator[list[tuple[int, ...]]]:
    every = combinations(range(chips), count)
    while batch := list(islice(every, _BATCH)):
        yield batch


def _flipped(code: ShutterCode, places: tuple[int, ...]) -> ShutterCode:
    chips = code.array
    chips[list(places)] = 1 - chips[list(places)]
    return code if not chips.any() else ShutterCode.from_array(chips, chip_ns=code.chip_ns)


def _exact(code: ShutterCode, trajectory: Trajectory | None) -> float:
    if trajectory is None:
        return min_chip(code)
    paths = [trajectory] if trajectory.direction == "known" else [trajectory, trajectory.reversed()]
    return min(mtf_minimum(path, code, budget=0).upper for path in paths)
