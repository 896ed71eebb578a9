"""Pareto front as data: non-dominated codes in the minimum of |H|, the noise and the light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.optics.band import uniform_length_px
from cep.optics.code import ShutterCode
from cep.proofs.measure import HOPELESS_DB
from cep.search.cost import CodeCost, continuum_minimum
from cep.search.problem import SearchProblem
from cep.search.search_result import Stopped
from motdiff.types import BoolArray, FloatArray

Codes = NDArray[np.int8]

EQUAL_DB = 1e-7
"""Figures as close are equal: those of a code and its mirror image agree only up to rounding."""

# what coarse samples may make of the minimum, in float32, and of the noise
_SLACK_DB = np.array([1e-3, 0.05])
_SAMPLES = 1024  # of coarse ones on the unit circle, or 8 a chip
_JUDGED = 32  # codes at once
_SWAPS = 4096  # neighbours of a code that are looked at
_NUMBERS = 2**22  # evaluated at once: 16 MB


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


class Judge:
    """Figures of codes: quick ones on coarse samples, and exact ones.

    Parameters
    ----------
    problem : SearchProblem

    Attributes
    ----------
    sampled_only : bool
        Whether a path is curved: minima are then over the samples.
    """

    def __init__(self, problem: SearchProblem) -> None:
        self._problem = replace(problem, objective="noise")
        self.sampled_only = not problem.straight
        coarse = int(np.clip(_SAMPLES // problem.chips, 8, 64))
        noise = CodeCost(self._problem, oversampling=coarse)
        self._coarse = (noise.instead("min-mtf"), noise)
        noise = CodeCost(self._problem, oversampling=64, dtype=np.float64)
        self._fine = (noise.instead("min-mtf"), noise, noise.instead("mse"))
        self._mirrored = problem.response is None and all(
            uniform_length_px(s.trajectory) is not None for s in problem.scenarios
        )

    def key(self, code: Codes) -> bytes:
        """Key of a code, the same for shifted and mirrored ones where these are equivalent."""
        if not self._mirrored:
            return code.tobytes()
        bits = np.trim_zeros(code).tobytes()
        return min(bits, bits[::-1])

    def quick(self, codes: Codes) -> FloatArray:
        """(R, 2) minimum over coarse samples, dB, and the negative of the noise."""
        return self._figures(self._coarse, codes)

    def exact(self, codes: Codes) -> FloatArray:
        """(R, 2) minimum, dB, and the negative of the noise; -inf for a zero."""
        figures = self._figures(self._fine[:2], codes)
        if not self.sampled_only:
            with np.errstate(divide="ignore"):
                figures[:, 0] = 20 * np.log10(
                    [self._minimum(ShutterCode.from_array(code)) for code in codes]
                )
        return figures

    def points(self, codes: Sequence[Codes]) -> tuple[FrontPoint, ...]:
        """Judge codes in every figure."""
        if not len(codes):
            return ()
        array = np.array(codes, dtype=np.int8)
        mse_db = self._figures(self._fine[2:], array)[:, 0]
        unit = 1.0 if self._problem.scenarios else float(self._problem.chips)
        return tuple(
            FrontPoint(
                ShutterCode.from_array(code),
                unit * 10 ** (low / 20),
                (
                    -quiet if np.isfinite(low) else np.inf
                ),  # samples may well miss a zero, the mean over all does not
                int(code.sum()),
                -mse,
            )
            for code, (low, quiet), mse in zip(
                array, self.exact(array).tolist(), mse_db.tolist(), strict=True
            )
        )

    def _figures(self, code_costs: Sequence[CodeCost], codes: Codes) -> FloatArray:
        step = max(1, _NUMBERS // code_costs[0].rows[0, 0].size)
        parts = []
        for batch in (codes[i : i + step] for i in range(0, len(codes), step)):
            arguments = (
                code_costs[0].otf(batch),
                code_costs[0].duty(batch),
                code_costs[0].noise_of(batch),
            )
            parts.append(
                np.stack([-code_cost.cost(*arguments) for code_cost in code_costs], axis=1)
            )
        return np.concatenate(parts) if parts else np.empty((0, len(code_costs)))

    def _minimum(self, code: ShutterCode) -> float:
        problem = self._problem
        return min(
            continuum_minimum(problem, path, code) for path in problem.directed_paths() or (None,)
        )


class Archive:
    """Codes that no other beats.

    Parameters
    ----------
    judge : Judge
    problem : SearchProblem
        Its limits are kept.

    Attributes
    ----------
    codes : (R, n) int8
    values : (R, 2) float
        Minimum, dB, and the negative of the noise.
    """

    def __init__(self, judge: Judge, problem: SearchProblem) -> None:
        self.judge = judge
        self.problem = problem
        self.codes: Codes = np.empty((0, problem.chips), np.int8)
        self.values: FloatArray = np.empty((0, 2))
        self._first = 1 if judge.sampled_only else 0  # column from which figures count
        self._seen: set[bytes] = set()
        self._looked_around: set[bytes] = set()

    @property
    def counted(self) -> FloatArray:
        """Return the figures that count, (R, 2), or (R, 1) where minima do not."""
        return self.values[:, self._first :]

    def offer(self, codes: Codes) -> None:
        """Judge the codes that might be better on coarse samples, and keep those that are."""
        codes = np.unique(codes[self.problem.satisfied(codes)], axis=0)
        hopes = (self.judge.quick(codes) + _SLACK_DB)[:, self._first :]
        while len(codes):
            # coarse samples overestimate: a code dominated on them is dominated
            beaten = (self.counted[None] >= hopes[:, None]).all(axis=2).any(axis=1)
            codes = codes[~beaten]
            hopes = hopes[~beaten]
            chosen = np.flatnonzero(non_dominated(hopes))[:_JUDGED]
            self._judge([code for code in codes[chosen] if self.judge.key(code) not in self._seen])
            codes = np.delete(codes, chosen, axis=0)
            hopes = np.delete(hopes, chosen, axis=0)

    def look_around(self, rng: np.random.Generator) -> bool:
        """Offer all swaps of one code whose neighbours are not yet evaluated; False when there is
        none.
        """
        code = next((c for c in self.codes if c.tobytes() not in self._looked_around), None)
        if code is None:
            return False
        self._looked_around.add(code.tobytes())
        open_chips = np.flatnonzero(code)
        closed_chips = np.flatnonzero(code == 0)
        pairs = np.arange(open_chips.size * closed_chips.size)
        if pairs.size > _SWAPS:
            pairs = rng.choice(pairs, _SWAPS, replace=False)
        swapped = np.repeat(code[None], pairs.size, axis=0)
        if pairs.size:
            swapped[np.arange(pairs.size), open_chips[pairs // closed_chips.size]] = 0
            swapped[np.arange(pairs.size), closed_chips[pairs % closed_chips.size]] = 1
        self.offer(swapped)
        return True

    def _judge(self, codes: list[Codes]) -> None:
        fresh = {self.judge.key(code): code for code in codes}
        if not fresh:
            return
        self._seen |= fresh.keys()
        new = np.array(list(fresh.values()))
        values = self.judge.exact(new)
        sound = np.isfinite(values).all(axis=1) & (values[:, 1] > -HOPELESS_DB)
        all_values = np.concatenate([self.values, values[sound]])
        codes_of = np.concatenate([self.codes, new[sound]])
        counted = np.round(all_values[:, self._first :] / EQUAL_DB)
        keep = np.flatnonzero(non_dominated(counted))
        # of equal ones the first found
        keep = keep[np.sort(np.unique(counted[keep], axis=0, return_index=True)[1])]
        self.values = all_values[keep]
        self.codes = codes_of[keep]
