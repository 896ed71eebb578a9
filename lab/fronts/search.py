"""Pareto search: non-dominated codes in the minimum of |H|, the noise and the light.

Codes are searched for every number of open chips with several mixes of minimum and noise, each
search from the codes of its neighbours. A Pareto local search then tries every swap of two chips
of every non-dominated code. Codes are selected on coarse samples, and measured on fine ones and,
for the minimum, on the continuum.

References
----------
Paquete, Chiarandini and Stuetzle, "Pareto local optimum sets in the biobjective traveling salesman
problem: an experimental study", in Metaheuristics for Multiobjective Optimisation, 2004: the local
search.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from cep.codes.published import for_chips
from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import COOLING, REHEATED, hottest_db, run_chains
from cep.search.annealing.cooling import anneal_chain
from cep.search.annealing.terms import Tables, lay_out
from cep.search.cost import CodeCost
from cep.search.problem import SearchProblem
from cep.search.search_result import Stopped
from lab.fronts.archive import EQUAL_DB, Archive, Codes, Judge
from lab.fronts.front import Front, FrontPoint, non_dominated

Progress = Callable[[float, str], None]

NOISE_SHARES = (0.0, 0.8, 1.0)
"""Shares of the noise's decibels in the mixes searched, the rest the minimum's: a decibel of noise
is worth several."""

_MOST_COUNTS = 64
_LEEWAY_DB = np.array([1.5, 0.6])  # by which a count's codes may be beaten before it is given up
_FIRST_LOOKS = 3  # codes looked around in one go
_LOOKS = 16
_RANDOM = 8  # random codes of each count, and copies of each neighbour's code with other light
_VARIANTS = 16
_OVERSAMPLING = 8
_CHAINS = 4
_FIRST_MOVES = 2**15  # of a chain in the first rounds and the last
_LAST_MOVES = 2**20
_GROWTH = 4


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
    """Search codes that no other beats; anytime: the time limit or Ctrl-C returns the front so
    far.

    Parameters
    ----------
    problem : SearchProblem
        Its objective does not matter; its rule must be the worst case.
    rng : numpy Generator
        The same seed and ``steps`` give the same front, as long as ``time_s`` is not reached.
    counts : sequence of int, optional
        Numbers of open chips; as many as the problem allows, or 64 evenly spread over them, when
        omitted.
    shares : sequence of float
        Shares of the noise in the mixes searched, 0..1, the rest being the minimum's; on curved
        paths noise alone.
    steps : int, optional
        Moves of the annealing, over all searches. None goes on for ``time_s``, and is not
        reproducible.
    time_s : float
        Upper limit, seconds, ``math.inf`` for none; the last judgement comes on top.
    progress : callable, optional
        Called repeatedly with the fraction done and a note on the current search. It may raise
        KeyboardInterrupt.
    threads : int, optional
        As many as there are cores when omitted.

    Raises
    ------
    ValueError
        If an argument is out of its range, or a count conflicts with the problem's limits.
    """
    if problem.rule != "worst":
        raise ValueError(
            f'rule: a front is over the worst scenario, "worst", got {problem.rule!r}'
        )
    if steps is not None and steps < 0:
        raise ValueError(f"steps: must be at least 0, got {steps}")
    if not time_s > 0:
        raise ValueError(f"time_s: must be above 0 seconds, got {time_s}")
    if not shares or not all(0 <= share <= 1 for share in shares):
        raise ValueError(f"shares: must be numbers within 0..1, got {tuple(shares)}")
    search = _Search(
        problem, _problems_by_count(problem, counts), rng, steps, time_s, progress, threads
    )
    stopped: Stopped = "steps"
    try:
        search.begin()
        search.rounds((1.0,) if search.judge.sampled_only else tuple(shares))
    except _TimeIsUp:
        stopped = "time"
    except KeyboardInterrupt:
        stopped = "interrupted"
    return search.front(stopped)


def front_points(problem: SearchProblem, codes: Iterable[ShutterCode]) -> tuple[FrontPoint, ...]:
    """Figures of codes as in a front, whether or not they keep the problem's limits."""
    return Judge(problem).points([code.array.astype(np.int8) for code in codes])


class _TimeIsUp(Exception):  # noqa: N818 - no error
    """Ends the search wherever it is."""


class _Search:
    """State of a search: an archive per count, and the remaining time and moves."""

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
        self.problem = problem
        self.rng = rng
        self.steps = steps
        self.time_s = time_s
        self._progress = progress
        self._threads = threads
        self._began = time.monotonic()
        self.moves = 0
        self.judge = Judge(problem)
        self._tables: dict[float, tuple[Tables, float]] = {}
        self.archives = {count: Archive(self.judge, p) for count, p in problems.items()}

    def begin(self) -> None:
        """Find first codes for every count, from the middle outwards."""
        begun_counts: list[int] = []
        published = np.array(
            [entry.code.array for entry in for_chips(self.problem.chips)], dtype=np.int8
        )
        for count in sorted(self.archives, key=lambda k: abs(2 * k - self.problem.chips)):
            archive = self.archives[count]
            archive.offer(archive.problem.random_codes(_RANDOM, rng=self.rng).astype(np.int8))
            if len(published):
                archive.offer(published)
            if begun_counts:
                archive.offer(
                    self._relit(
                        self.archives[min(begun_counts, key=lambda k: abs(k - count))].codes, count
                    )
                )
            begun_counts.append(count)
            self._settle(count, _FIRST_LOOKS)

    def rounds(self, shares: tuple[float, ...]) -> None:
        """Anneal with every mix for every count that is not given up, longer from round to
        round.
        """
        moves = _FIRST_MOVES
        while self.steps is None or self.moves < self.steps:
            counts = self._promising()
            if self.steps is not None:
                moves = min(
                    moves, -(-(self.steps - self.moves) // (len(counts) * len(shares) * _CHAINS))
                )
            for count in counts:
                for share in shares:
                    self._anneal(count, share, moves)
                self._settle(count, _LOOKS)
            moves = min(_GROWTH * moves, _LAST_MOVES)
        for count in self._promising():
            self._settle(count, None)

    def front(self, stopped: Stopped) -> Front:
        """Measure all figures of the codes found."""
        curves = {
            count: tuple(
                sorted(
                    self.judge.points(list(archive.codes)), key=lambda p: (p.minimum, p.code.bits)
                )
            )
            for count, archive in sorted(self.archives.items())
        }
        unbeaten = {ShutterCode(code).bits for code in self._unbeaten()}
        points = tuple(p for curve in curves.values() for p in curve if p.code.bits in unbeaten)
        unit = "light-true" if self.problem.scenarios else "chips"
        return Front(
            points,
            curves,
            f"{unit}, sampled" if self.judge.sampled_only else unit,
            self.problem,
            time.monotonic() - self._began,
            self.moves,
            stopped,
        )

    def _unbeaten(self) -> Codes:
        codes = np.concatenate([archive.codes for archive in self.archives.values()])
        counted = np.concatenate([archive.counted for archive in self.archives.values()])
        light = codes.sum(axis=1, dtype=np.float64)
        return np.asarray(
            codes[non_dominated(np.column_stack([np.round(counted / EQUAL_DB), light]))]
        )

    def _promising(self) -> list[int]:
        """List the counts whose codes are not beaten by far."""
        light = np.concatenate(
            [np.full(len(archive.values), count) for count, archive in self.archives.items()]
        )
        table = np.column_stack(
            [np.concatenate([archive.counted for archive in self.archives.values()]), light]
        )
        leeway = np.append(_LEEWAY_DB[-(table.shape[1] - 1) :], 0.0)
        far_beaten = (table[None] >= (table + leeway)[:, None]).all(axis=2).any(axis=1)
        return sorted({int(count) for count in light[~far_beaten]} or self.archives)

    def _settle(self, count: int, looks: int | None) -> None:
        """Evaluate the swaps of the count's codes, up to a number of codes."""
        settled = 0
        more = True
        while more and (looks is None or settled < looks):
            self._tick(f"{count} open")
            more = self.archives[count].look_around(self.rng)
            settled += 1

    def _anneal(self, count: int, share: float, moves: int) -> None:
        """Run chains from the count's codes, from neighbours' and from random ones, and offer
        their codes.
        """
        archive = self.archives[count]
        codes = list[Codes]()
        neighbours = sorted(
            (k for k in self.archives if k != count), key=lambda k: (abs(k - count), k)
        )[:2]
        relit = [self._relit(self.archives[k].codes, count, variants=1) for k in neighbours]
        random_codes = archive.problem.random_codes(_CHAINS, rng=self.rng).astype(np.int8)
        pool = np.concatenate([archive.codes, *relit])
        pool = pool[archive.problem.satisfied(pool)]
        good = self.rng.permutation(pool)[: _CHAINS // 4]
        starts = np.concatenate([good, random_codes])
        tables, hot = self._tables_of(share)
        seeds = [int(seed) for seed in self.rng.integers(1, 2**62, _CHAINS)]
        heats = [REHEATED * hot] * len(good) + [hot] * _CHAINS
        chains = [
            anneal_chain(
                archive.problem,
                tables,
                code,
                temperatures_db=(heat, hot / COOLING),
                moves=moves,
                seed=seed,
            )
            for code, heat, seed in zip(starts, heats, seeds, strict=False)
        ]

        def tick(made: int) -> bool:
            self.moves += made
            self._tick(f"{count} open")
            return True

        try:
            run_chains(chains, tick, codes.append, threads=self._threads)
        finally:
            archive.offer(np.concatenate([*codes, archive.codes[:0]]))

    def _tables_of(self, share: float) -> tuple[Tables, float]:
        """Tables of a mix for the compiled loops, cached, and the first temperature of its chains,
        dB.
        """
        if share not in self._tables:
            mix = tuple(
                (name, weight)
                for name, weight in (("min-mtf", 1 - share), ("noise", share))
                if weight > 0
            )
            tables = lay_out(
                CodeCost(replace(self.problem, objective=mix), oversampling=_OVERSAMPLING)
            )
            self._tables[share] = (tables, hottest_db(replace(self.problem, objective=mix)))
        return self._tables[share]

    def _relit(self, codes: Codes, count: int, *, variants: int = _VARIANTS) -> Codes:
        """Copy codes with chips opened or closed at random until ``count`` are open."""
        copies = np.repeat(codes, variants, axis=0)
        # chips in a random order, open ones first: the first are those that end up open
        order = np.argsort(self.rng.random(copies.shape) - copies, axis=1)
        relit = np.zeros_like(copies)
        np.put_along_axis(relit, order[:, :count], 1, axis=1)
        return relit

    def _tick(self, note: str) -> None:
        time_share = (time.monotonic() - self._began) / self.time_s
        if self._progress is not None:
            move_share = 0.0 if not self.steps else self.moves / self.steps
            self._progress(min(1.0, max(time_share, move_share)), note)
        if time_share >= 1:
            raise _TimeIsUp


def _problems_by_count(
    problem: SearchProblem, counts: Sequence[int] | None
) -> dict[int, SearchProblem]:
    """Narrow the problem to each count; of those not asked for by name, to the ones that some code
    keeps.
    """
    low, high = problem.open_limits
    if counts is not None:
        outside = [count for count in counts if not low <= count <= high]
        if outside or not counts:
            raise ValueError(f"counts: must lie within {low}..{high}, got {outside or 'none'}")
        return {
            int(count): replace(problem, open_range=(int(count), int(count)))
            for count in sorted(set(counts))
        }
    narrowed = {}
    for count in range(low, high + 1):
        try:
            narrowed[count] = replace(problem, open_range=(count, count))
        except ValueError:
            continue
    open_counts = np.array(list(narrowed))
    chosen = open_counts[
        np.unique(
            np.linspace(0, open_counts.size - 1, min(open_counts.size, _MOST_COUNTS))
            .round()
            .astype(int)
        )
    ]
    return {int(count): narrowed[int(count)] for count in chosen}
