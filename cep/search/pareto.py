"""What can be had at once: codes that no other beats in the minimum of |H|, the noise and the light together.

Codes are searched for every number of open chips with several mixes of minimum and noise, each search from what its
neighbours found; a Pareto local search then looks at every swap of two chips of every code that is not beaten. Codes
are picked on coarse samples, but judged on fine ones and, for the minimum, on the continuum.

References
----------
Paquete, Chiarandini and Stuetzle, "Pareto local optimum sets in the biobjective traveling salesman problem: an
experimental study", in Metaheuristics for Multiobjective Optimisation, 2004: the local search.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.band import straight_axis, uniform_length_px
from cep.baselines.published import for_chips
from cep.code import ShutterCode
from cep.minimum import min_chip, mtf_minimum
from cep.search.anneal import anneal
from cep.search.objective import Objective
from cep.search.problem import SearchProblem

__all__ = ["Front", "FrontPoint", "NOISE_SHARES", "front_points", "knees", "non_dominated", "pareto_front"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Codes = NDArray[np.int8]
Progress = Callable[[float, str], None]

NOISE_SHARES = (0.0, 0.7, 0.85, 1.0)
"""Shares of the noise's decibels in the mixes searched, the rest the minimum's: along a front of 52 chips a decibel less
noise costs three to six of the minimum."""

_MOST_COUNTS = 24
_HOPELESS_DB = 100.0  # noise of a code with a zero
_SLACK_DB = np.array([1e-3, 0.05])  # what coarse samples may make of the minimum, in float32, and of the noise
_EQUAL_DB = 1e-7  # figures of a code and its mirror image agree only up to rounding
_JUDGED = 32  # codes at once
_SWAPS = 4096  # neighbours of a code that are looked at
_RANDOM, _VARIANTS = 8, 16  # random codes of each count, and copies of each neighbour's code with other light
_FIRST_MOVES, _GROWTH = 2**14, 4  # of a search in the first round, and from round to round
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
        ``10 log10 mean 1/|H|^2``, light-true.
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
        For every number of open chips the codes not beaten by others of the same light, by minimum.
    unit : {"chips", "light-true", "light-true, sampled"}
        Of the minimum. In chips: of |P| over the whole unit circle. Light-true: of |H| over the band's continuum. Sampled:
        along a curved path nearly every code has true zeros between the samples, so that the minimum over the continuum
        tells codes apart no more. The one over the samples is shown, but the front is over noise and light alone.
    problem : SearchProblem
    seconds : float
    steps : int
        Moves tried by the annealing.
    interrupted : bool
        Whether Ctrl-C ended it, or the time limit a search that was asked for so many steps.
    """

    points: tuple[FrontPoint, ...]
    curves: Mapping[int, tuple[FrontPoint, ...]]
    unit: str
    problem: SearchProblem
    seconds: float
    steps: int
    interrupted: bool

    @property
    def sampled(self) -> bool:
        """Whether minima are over samples, and do not count."""
        return self.unit == "light-true, sampled"


def non_dominated(values: ArrayLike) -> BoolArray:
    """Tell which rows no other row beats: none is at least as good in every column and better in one.

    Parameters
    ----------
    values : (R, C) array_like
        Larger is better in every column.

    Returns
    -------
    (R,) bool ndarray
        Equal rows share their fate.

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
        raise ValueError(f"values: must be a table of numbers (R, C) without NaN, got shape {table.shape}")
    rows, place = np.unique(table, axis=0, return_inverse=True)
    keep = np.ones(len(rows), dtype=np.bool_)
    for index in range(len(rows) - 1, -1, -1):
        # rows ascend: only later ones can beat this one, and they are settled
        if keep[index]:
            keep[:index] &= (rows[:index] > rows[index]).any(axis=1)
    return np.asarray(keep[place.reshape(-1)])


def pareto_front(
    problem: SearchProblem,
    *,
    rng: np.random.Generator,
    counts: Sequence[int] | None = None,
    shares: Sequence[float] = NOISE_SHARES,
    steps: int | None = None,
    time_s: float = 60.0,
    progress: Progress | None = None,
    threads: int | None = None,
) -> Front:
    """Search codes that no other beats; anytime: the time limit or Ctrl-C returns the front so far.

    Parameters
    ----------
    problem : SearchProblem
        Its objective does not matter; its rule must be the worst case.
    rng : numpy Generator
        The same seed and ``steps`` give the same front, as long as ``time_s`` is not reached.
    counts : sequence of int, optional
        Numbers of open chips; as many as the problem allows, or 24 evenly spread over them, when omitted.
    shares : sequence of float
        Shares of the noise in the mixes searched, 0..1, the rest being the minimum's; on curved paths noise alone.
    steps : int, optional
        Moves of the annealing, over all searches. None goes on for ``time_s``, and is not reproducible.
    time_s : float
        Upper limit, seconds; the last judgement comes on top.
    progress : callable, optional
        Called now and then with the fraction done and a word on what is searched. It may raise KeyboardInterrupt.
    threads : int, optional
        As many as there are cores when omitted.

    Raises
    ------
    ValueError
        If an argument is out of its range, or a count conflicts with the problem's limits.
    """
    if problem.rule != "worst":
        raise ValueError(f'rule: a front is over the worst scenario, "worst", got {problem.rule!r}')
    if steps is not None and steps < 0:
        raise ValueError(f"steps: must be at least 0, got {steps}")
    if not time_s > 0:
        raise ValueError(f"time_s: must be above 0 seconds, got {time_s}")
    if not shares or not all(0 <= share <= 1 for share in shares):
        raise ValueError(f"shares: must be numbers within 0..1, got {tuple(shares)}")
    search = _Search(problem, _problems_by_count(problem, counts), rng, steps, time_s, progress, threads)
    interrupted = False
    try:
        search.begin()
        search.rounds((1.0,) if search.judge.sampled_only else tuple(shares))
        interrupted = steps is not None and search.moves < steps
    except _TimeIsUp:
        interrupted = steps is not None
    except KeyboardInterrupt:
        interrupted = True
    return search.front(interrupted)


def front_points(problem: SearchProblem, codes: Iterable[ShutterCode]) -> tuple[FrontPoint, ...]:
    """Judge codes as a front's are, whether or not they keep the problem's limits."""
    return _Judge(problem).points([code.array.astype(np.int8) for code in codes])


def knees(front: Front) -> dict[str, FrontPoint]:
    """Pick out the best minimum, the least noise, the most light, and the best compromise.

    The compromise loses the fewest decibels in all against the best of each: 20 log10 of the minimum, the noise, and 10
    log10 of the light. Where the minimum is a sampled one, it does not count.
    """
    if not front.points:
        return {}

    def worth(point: FrontPoint) -> float:
        minimum_db = 0.0 if front.sampled else 20 * float(np.log10(point.minimum))
        return minimum_db - point.noise_db + 10 * float(np.log10(point.open_chips))

    picked = {"best minimum": max(front.points, key=lambda p: (p.minimum, -p.noise_db))} if not front.sampled else {}
    return picked | {
        "least noise": min(front.points, key=lambda p: (p.noise_db, -p.open_chips)),
        "compromise": max(front.points, key=worth),
        "most light": max(front.points, key=lambda p: (p.open_chips, worth(p))),
    }


class _TimeIsUp(Exception):  # noqa: N818 - no error
    """Ends the search wherever it is."""


class _Judge:
    """Figures of codes: quick ones on coarse samples, and those that count."""

    def __init__(self, problem: SearchProblem) -> None:
        self._problem = replace(problem, objective="noise")
        lowest = replace(problem, objective="min-mtf")
        self.sampled_only = any(straight_axis(s.trajectory) is None for s in problem.scenarios)
        self._coarse = tuple(Objective(p, oversampling=8) for p in (lowest, self._problem))
        self._fine = tuple(
            Objective(p, oversampling=64, dtype=np.float64)
            for p in (lowest, self._problem, replace(problem, objective="mse"))
        )
        plain = problem.response is None and all(s.edges is None for s in problem.scenarios)
        self._mirrored = plain and all(uniform_length_px(s.trajectory) is not None for s in problem.scenarios)

    def key(self, code: Codes) -> bytes:
        """Name a code, shifted and mirrored ones alike where that changes nothing."""
        if not self._mirrored:
            return code.tobytes()
        bits = np.trim_zeros(code).tobytes()
        return min(bits, bits[::-1])

    def quick(self, codes: Codes) -> FloatArray:
        """(R, 2) minimum over coarse samples, dB, and the negative of the noise."""
        return self._figures(self._coarse, codes)

    def exact(self, codes: Codes) -> FloatArray:
        """(R, 2) minimum, dB, and the negative of the noise; -inf for a zero."""
        found = self._figures(self._fine[:2], codes)
        if not self.sampled_only:
            with np.errstate(divide="ignore"):
                found[:, 0] = 20 * np.log10([self._minimum(ShutterCode.from_array(code)) for code in codes])
        return found

    def points(self, codes: Sequence[Codes]) -> tuple[FrontPoint, ...]:
        """Judge codes in every figure."""
        if not len(codes):
            return ()
        every = np.array(codes, dtype=np.int8)
        mse_db = self._figures(self._fine[2:], every)[:, 0]
        unit = 1.0 if self._problem.scenarios else float(self._problem.chips)
        return tuple(
            FrontPoint(ShutterCode.from_array(code), unit * 10 ** (low / 20), -quiet, int(code.sum()), -mse)
            for code, (low, quiet), mse in zip(every, self.exact(every).tolist(), mse_db.tolist(), strict=True)
        )

    def _figures(self, objectives: Sequence[Objective], codes: Codes) -> FloatArray:
        step = max(1, _NUMBERS // objectives[0].rows[0, 0].size)
        parts = []
        for batch in (codes[i : i + step] for i in range(0, len(codes), step)):
            otf, duty = objectives[0].otf(batch), objectives[0].duty(batch)
            parts.append(np.stack([-objective.cost(otf, duty) for objective in objectives], axis=1))
        return np.concatenate(parts) if parts else np.empty((0, len(objectives)))

    def _minimum(self, code: ShutterCode) -> float:
        problem = self._problem
        if not problem.scenarios:
            return min_chip(code) / code.chips
        return min(
            mtf_minimum(
                scenario.path(reversed_path=turned), code, budget=0, response=problem.response, edges=scenario.edges
            ).upper
            for scenario in problem.scenarios
            for turned in ((False, True) if problem.both_directions(scenario.trajectory) else (False,))
        )


class _Archive:
    """Codes of one count that no other beats."""

    def __init__(self, judge: _Judge, problem: SearchProblem) -> None:
        self.judge, self.problem = judge, problem
        self.codes: Codes = np.empty((0, problem.chips), np.int8)
        self.values: FloatArray = np.empty((0, 2))
        self._first = 1 if judge.sampled_only else 0  # column from which figures count
        self._seen: set[bytes] = set()
        self._looked_around: set[bytes] = set()

    @property
    def counted(self) -> FloatArray:
        return self.values[:, self._first :]

    def offer(self, codes: Codes) -> None:
        """Judge the codes that might be better on coarse samples, and keep those that are."""
        codes = np.unique(codes[self.problem.satisfied(codes)], axis=0)
        hopes = (self.judge.quick(codes) + _SLACK_DB)[:, self._first :]
        while len(codes):
            # coarse samples flatter: what is beaten even so is beaten
            beaten = (self.counted[None] >= hopes[:, None]).all(axis=2).any(axis=1)
            codes, hopes = codes[~beaten], hopes[~beaten]
            chosen = np.flatnonzero(non_dominated(hopes))[:_JUDGED]
            self._judge([code for code in codes[chosen] if self.judge.key(code) not in self._seen])
            codes, hopes = np.delete(codes, chosen, axis=0), np.delete(hopes, chosen, axis=0)

    def look_around(self, rng: np.random.Generator) -> bool:
        """Offer all swaps of one code not looked around yet; False when there is none."""
        code = next((c for c in self.codes if c.tobytes() not in self._looked_around), None)
        if code is None:
            return False
        self._looked_around.add(code.tobytes())
        opened, closed = np.flatnonzero(code), np.flatnonzero(code == 0)
        pairs = np.arange(opened.size * closed.size)
        if pairs.size > _SWAPS:
            pairs = rng.choice(pairs, _SWAPS, replace=False)
        swapped = np.repeat(code[None], pairs.size, axis=0)
        if pairs.size:
            swapped[np.arange(pairs.size), opened[pairs // closed.size]] = 0
            swapped[np.arange(pairs.size), closed[pairs % closed.size]] = 1
        self.offer(swapped)
        return True

    def _judge(self, codes: list[Codes]) -> None:
        fresh = {self.judge.key(code): code for code in codes}
        if not fresh:
            return
        self._seen |= fresh.keys()
        new = np.array(list(fresh.values()))
        values = self.judge.exact(new)
        sound = np.isfinite(values).all(axis=1) & (values[:, 1] > -_HOPELESS_DB)
        every, codes_then = np.concatenate([self.values, values[sound]]), np.concatenate([self.codes, new[sound]])
        counted = np.round(every[:, self._first :] / _EQUAL_DB)
        keep = np.flatnonzero(non_dominated(counted))
        # of equal ones the first found
        keep = keep[np.sort(np.unique(counted[keep], axis=0, return_index=True)[1])]
        self.values, self.codes = every[keep], codes_then[keep]


class _Search:
    """State of a search: an archive per count, and what is left of time and moves."""

    def __init__(
        self,
        problem: SearchProblem,
        problems: Mapping[int, SearchProblem],
        rng: np.random.Generator,
        steps: int | None,
        time_s: float,
        progress: Progress | None,
        threads: int | None,
    ) -> None:
        self.problem, self.rng, self.steps, self.time_s = problem, rng, steps, time_s
        self._progress, self._threads = progress, threads
        self._began = time.monotonic()
        self.moves = 0
        self.judge = _Judge(problem)
        self.archives = {count: _Archive(self.judge, p) for count, p in problems.items()}

    def begin(self) -> None:
        """Find something for every count, from the middle outwards."""
        done: list[int] = []
        published = np.array([entry.code.array for entry in for_chips(self.problem.chips)], dtype=np.int8)
        for count in sorted(self.archives, key=lambda k: abs(2 * k - self.problem.chips)):
            archive = self.archives[count]
            archive.offer(archive.problem.random_codes(_RANDOM, rng=self.rng).astype(np.int8))
            if len(published):
                archive.offer(published)
            if done:
                archive.offer(self._relit(self.archives[min(done, key=lambda k: abs(k - count))].codes, count))
            done.append(count)
            self._settle(count)

    def rounds(self, shares: tuple[float, ...]) -> None:
        """Anneal with every mix for every count that has an unbeaten code, longer from round to round."""
        moves = _FIRST_MOVES
        while self.steps is None or self.moves < self.steps:
            counts = sorted({int(code.sum()) for code in self._unbeaten()} or self.archives)
            if self.steps is not None:
                moves = max(1, (self.steps - self.moves) // (len(counts) * len(shares)))
            for count in counts:
                for share in shares:
                    self._anneal(count, share, moves)
                self._settle(count)
            moves *= _GROWTH

    def front(self, interrupted: bool) -> Front:
        """Judge what was found in every figure."""
        curves = {
            count: tuple(sorted(self.judge.points(list(archive.codes)), key=lambda p: (p.minimum, p.code.bits)))
            for count, archive in sorted(self.archives.items())
        }
        unbeaten = {code.tobytes() for code in self._unbeaten()}
        points = tuple(p for curve in curves.values() for p in curve if p.code.array.astype(np.int8).tobytes() in unbeaten)
        unit = "light-true" if self.problem.scenarios else "chips"
        return Front(
            points,
            curves,
            f"{unit}, sampled" if self.judge.sampled_only else unit,
            self.problem,
            time.monotonic() - self._began,
            self.moves,
            interrupted,
        )

    def _unbeaten(self) -> Codes:
        codes = np.concatenate([archive.codes for archive in self.archives.values()])
        counted = np.concatenate([archive.counted for archive in self.archives.values()])
        light = codes.sum(axis=1, dtype=np.float64)
        return np.asarray(codes[non_dominated(np.column_stack([np.round(counted / _EQUAL_DB), light]))])

    def _settle(self, count: int) -> None:
        """Look around every code of the count until all swaps are known."""
        more = True
        while more:
            self._tick(f"{count} open")
            more = self.archives[count].look_around(self.rng)

    def _anneal(self, count: int, share: float, moves: int) -> None:
        mix = tuple((name, weight) for name, weight in (("min-mtf", 1 - share), ("noise", share)) if weight > 0)
        archive, seen = self.archives[count], list[Codes]()
        near = sorted((k for k in self.archives if k != count), key=lambda k: (abs(k - count), k))[:2]
        start = [*archive.codes, *(code for k in near for code in self._relit(self.archives[k].codes, count, variants=2))]
        before = self.moves

        def note(fraction: float, best: ShutterCode) -> None:
            self.moves = before + int(fraction * moves)
            seen.append(best.array.astype(np.int8))
            self._tick(f"{count} open")

        left = self.time_s - (time.monotonic() - self._began)
        found = anneal(
            replace(archive.problem, objective=mix),
            rng=self.rng,
            steps=moves,
            time_s=max(left, 1e-3),
            start=[ShutterCode.from_array(code) for code in start],
            progress=note,
            threads=self._threads,
        )
        self.moves = before + found.steps
        archive.offer(np.array([*seen, found.code.array], dtype=np.int8))
        if found.interrupted:
            raise _TimeIsUp if time.monotonic() - self._began >= self.time_s else KeyboardInterrupt

    def _relit(self, codes: Codes, count: int, *, variants: int = _VARIANTS) -> Codes:
        """Copies of codes with chips opened or closed at random until ``count`` are open."""
        copies = np.repeat(codes, variants, axis=0)
        # chips in a random order, open ones first: the first are those that end up open
        order = np.argsort(self.rng.random(copies.shape) - copies, axis=1)
        relit = np.zeros_like(copies)
        np.put_along_axis(relit, order[:, :count], 1, axis=1)
        return relit

    def _tick(self, note: str) -> None:
        used = (time.monotonic() - self._began) / self.time_s
        if self._progress is not None:
            done = 0.0 if not self.steps else self.moves / self.steps
            self._progress(min(1.0, max(used, done)), note)
        if used >= 1:
            raise _TimeIsUp


def _problems_by_count(problem: SearchProblem, counts: Sequence[int] | None) -> dict[int, SearchProblem]:
    """Narrow the problem to each count; of those not asked for by name, to the ones that some code keeps."""
    low, high = problem.open_limits
    if counts is not None:
        outside = [count for count in counts if not low <= count <= high]
        if outside or not counts:
            raise ValueError(f"counts: must lie within {low}..{high}, got {outside or 'none'}")
        return {int(count): replace(problem, open_range=(int(count), int(count))) for count in sorted(set(counts))}
    narrowed = {}
    for count in range(low, high + 1):
        try:
            narrowed[count] = replace(problem, open_range=(count, count))
        except ValueError:
            continue
    kept = np.array(list(narrowed))
    chosen = kept[np.unique(np.linspace(0, kept.size - 1, min(kept.size, _MOST_COUNTS)).round().astype(int))]
    return {int(count): narrowed[int(count)] for count in chosen}
