"""Pareto front as data: non-dominated codes in the minimum of |H|, the noise and the light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.code import ShutterCode
from cep.search.problem import SearchProblem
from cep.search.search_result import Stopped
from motdiff.types import BoolArray


@dataclass(frozen=True)
class FrontPoint:
    """A code and its figures, each the worst over the problem's motions and directions.

    Attributes
    ----------
    code : ShutterCode
    minimum : float
        Smallest |H|, or |P| in chips; see :attr:`Front.unit`.
    noise_db : float
        ``10 log10 mean 1/|H|^2``, light-true; infinite for a zero on the unit circle or along a
        straight motion.
    open_chips : int
    mse_db : float
        ``10 log10`` of the Wiener restoration's mean square error under the problem's camera.
    """

    code: ShutterCode
    minimum: float
    noise_db: float
    open_chips: int
    mse_db: float


@dataclass(frozen=True)
class Front:
    """Codes that no code found beats; those with a zero, or noise above 100 dB, are left out.

    Attributes
    ----------
    points : tuple of FrontPoint
        Not beaten by any code found, darkest first, then by minimum.
    curves : mapping of int to tuple of FrontPoint
        For every number of open chips the codes not beaten by others of the same light, by
        minimum.
    unit : {"chips", "light-true", "light-true, sampled"}
        Of the minimum. In chips: of |P| over the whole unit circle. Light-true: of |H| over the
        band's continuum. Sampled: along a curved path nearly every code has true zeros between the
        samples, so that the minimum over the continuum does not distinguish codes. The one over
        the samples is shown, but the front is over noise and light alone.
    problem : SearchProblem
    seconds : float
    steps : int
        Moves tried by the annealing.
    stopped : {"steps", "time", "interrupted"}
        Reason of its end: all moves made, the time limit, which makes the front depend on the
        machine, or Ctrl-C.
    """

    points: tuple[FrontPoint, ...]
    curves: Mapping[int, tuple[FrontPoint, ...]]
    unit: str
    problem: SearchProblem
    seconds: float
    steps: int
    stopped: Stopped

    @property
    def sampled(self) -> bool:
        """Whether minima are over samples, and do not count."""
        return self.unit == "light-true, sampled"


def non_dominated(values: ArrayLike) -> BoolArray:
    """Mask of the non-dominated rows: no other row is at least as good in every column and better
    in one.

    Parameters
    ----------
    values : (R, C) array_like
        Larger is better in every column.

    Returns
    -------
    (R,) bool ndarray
        Equal rows have the same value.

    Raises
    ------
    ValueError
        If the array has another shape, or a NaN in it.

    Examples
    --------
    >>> non_dominated([[1, 5], [2, 4], [2, 3], [1, 5]]).tolist()
    [True, True, False, True]
    """
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 2 or np.isnan(table).any():
        raise ValueError(
            f"values: must be a table of numbers (R, C) without NaN, got shape {table.shape}"
        )
    rows, place = np.unique(table, axis=0, return_inverse=True)
    keep = np.ones(len(rows), dtype=np.bool_)
    for index in range(len(rows) - 1, -1, -1):
        # rows ascend: only later ones can beat this one, and they are settled
        if keep[index]:
            keep[:index] &= (rows[:index] > rows[index]).any(axis=1)
    return np.asarray(keep[place.reshape(-1)])


def knees(front: Front) -> dict[str, FrontPoint]:
    """Select the best minimum, the least noise, the most light, and the best compromise.

    The compromise loses the fewest decibels in all against the best of each: 20 log10 of the
    minimum, the noise, and 10 log10 of the light. Where the minimum is a sampled one, it does not
    count.
    """
    if not front.points:
        return {}

    def worth(point: FrontPoint) -> float:
        minimum_db = 0.0 if front.sampled else 20 * float(np.log10(point.minimum))
        return minimum_db - point.noise_db + 10 * float(np.log10(point.open_chips))

    picked = (
        {"best minimum": max(front.points, key=lambda p: (p.minimum, -p.noise_db))}
        if not front.sampled
        else {}
    )
    return picked | {
        "least noise": min(front.points, key=lambda p: (p.noise_db, -p.open_chips)),
        "compromise": max(front.points, key=worth),
        "most light": max(front.points, key=lambda p: (p.open_chips, worth(p))),
    }
