"""Joint search of the codes of several exposures of one scene, whose spectra complement each
other.

The joint cost is in :mod:`cep.search.annealing.joint`.

References
----------
Agrawal, Xu and Raskar, "Invertible motion blur in video", SIGGRAPH 2009: exposures whose joint
transform has no null.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import (
    CHAINS,
    COOLING,
    MOVES_SHARE,
    REHEATED,
    Budget,
    Stopped,
    hottest_db,
)
from cep.search.annealing.chains import cool
from cep.search.annealing.joint import joint_cost, joint_figures, joint_tables, polish_jointly
from cep.search.annealing.proposals import Limits
from cep.search.annealing.states import Chain, found_by, new_chain, own_tables, refresh
from cep.search.annealing.terms import BLOCK, Tables, limits_of
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from motdiff.types import FloatArray

Codes = NDArray[np.int8]
Progress = Callable[[float, tuple[ShutterCode, ...]], None]
_OVERSAMPLING = 8
_SLICE = 4096  # moves until the OTF is summed anew: float32 sums drift
_VISIT = 256  # moves in one frame until the next one has its turn
_ELITES = 16


@dataclass(frozen=True)
class FramesResult:
    """Result of a joint search.

    Attributes
    ----------
    codes : tuple of ShutterCode
        One for each frame.
    objective : float
        Joint cost in dB on the fine grid, lower is better; see
        :func:`cep.search.annealing.joint.joint_cost`.
    minimum, noise_gain_db : float
        As :class:`cep.search.annealing.joint.JointFigures` has them; the minimum is sampled.
    seconds : float
    steps : int
        Moves tried.
    stopped : {"steps", "time", "interrupted", "complete"}
        Reason of its end, as of :class:`cep.search.annealing.anneal.SearchResult`.
    """

    codes: tuple[ShutterCode, ...]
    objective: float
    minimum: float
    noise_gain_db: float
    seconds: float
    steps: int
    stopped: Stopped


def anneal_frames(
    problem: SearchProblem,
    frames: int,
    *,
    rng: np.random.Generator,
    steps: int | None = 1_000_000,
    time_s: float = 60.0,
    start: Iterable[Sequence[ShutterCode]] = (),
    progress: Progress | None = None,
    threads: int | None = None,
) -> FramesResult:
    """Search the codes of several frames that restore best together; anytime, as
    :func:`cep.search.annealing.anneal`.

    Every frame keeps all of the problem's limits.

    Parameters
    ----------
    problem : SearchProblem
        Of one frame; all of them are taken along the same motion.
    frames : int
    rng : numpy Generator
        The same seed and ``steps`` give the same codes, as long as ``time_s`` is not reached.
    steps : int, optional
        Moves to try, over all chains. None searches for ``time_s``, and is not reproducible.
    time_s : float
        Upper limit of the moves, seconds; of the closing polish, a tenth of it or half a second
        more; ``math.inf`` for none.
    start : iterable of sequences of ShutterCode
        Codes of all frames to start from, besides random ones; those that break a limit are left
        out.
    progress : callable, optional
        Called now and then with the fraction done, 0..1, and the best codes so far. It may raise
        KeyboardInterrupt.
    threads : int, optional
        As many as there are cores when omitted; the outcome does not depend on it.

    Raises
    ------
    ValueError
        If a limit is not positive or a start has another number of frames or chips.
    """
    if frames < 1:
        raise ValueError(f"frames: must be at least 1, got {frames}")
    budget = Budget(steps, time_s, time.monotonic())
    starts = [[code.array for code in codes] for codes in start]
    if any(
        len(codes) != frames or any(bits.size != problem.chips for bits in codes)
        for codes in starts
    ):
        raise ValueError(f"start: every one must be {frames} codes of {problem.chips} chips")
    elites = _Elites(Objective(problem, oversampling=_OVERSAMPLING))
    seeds = np.array([*starts, problem.random_codes(frames, rng=rng)], dtype=np.int8)
    seeds = seeds[[bool(problem.satisfied(codes).all()) for codes in seeds]]
    elites.offer(seeds)
    free = problem.free_chips
    stopped: Stopped = "complete"

    try:
        if free.size:
            joint = _Joint.of(elites.coarse, frames, free)
            with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
                round_number = 0
                while budget.remains():
                    _round(joint, elites, budget, round_number, rng, pool, progress)
                    round_number += 1
            stopped = budget.stopped()
    except KeyboardInterrupt:
        stopped = "interrupted"
    # no start may beat what is returned on the fine grid
    ranked = np.concatenate([elites.ranked(frames), seeds])

    def report(piece: tuple[NDArray[np.int8], float], over: bool) -> None:
        if progress is not None:
            progress(
                1.0 if over else MOVES_SHARE + (1 - MOVES_SHARE) * piece[1], _as_codes(piece[0])
            )

    (best, _), stopped = budget.polished(
        (ranked[0], 0.0), polish_jointly(problem, ranked), report, stopped=stopped
    )
    codes = _as_codes(best)
    cost = float(joint_cost(Objective(problem, oversampling=64, dtype=np.float64), best[None])[0])
    return FramesResult(
        codes, cost, *joint_figures(problem, codes), budget.elapsed(), budget.moves, stopped
    )


@dataclass
class _Elites:
    """Best distinct choices of codes seen, their frames one after the other."""

    coarse: Objective
    costs: dict[bytes, float] = field(default_factory=dict)

    def offer(self, choices: Codes) -> None:
        for codes in choices:
            self.costs[codes.astype(np.int8).tobytes()] = float(
                joint_cost(self.coarse, codes[None])[0]
            )
        self.costs = dict(sorted(self.costs.items(), key=lambda item: item[1])[:_ELITES])

    def ranked(self, frames: int) -> Codes:
        return np.array(
            [np.frombuffer(key, dtype=np.int8).reshape(frames, -1) for key in self.costs]
        )


@dataclass(frozen=True)
class _Joint:
    """A problem of several frames for the compiled loop, whose code is all frames' chips in a
    row.
    """

    problem: SearchProblem
    frames: int
    tables: Tables
    limits: Limits
    free: NDArray[np.int64]

    @classmethod
    def of(cls, coarse: Objective, frames: int, free: NDArray[np.intp]) -> _Joint:
        problem = coarse.problem
        tables = joint_tables(coarse, frames)
        return cls(problem, frames, tables, limits_of(problem), free.astype(np.int64))

    def chain(self, codes: Codes, seed: int) -> tuple[Tables, Chain]:
        """Start a chain at (M, n) codes, with the tables that it sorts for itself."""
        tables = own_tables(self.tables)
        return tables, new_chain(tables, codes.ravel(), seed, frames=self.frames)

    def advance(self, tables: Tables, chain: Chain, heats_db: FloatArray, moves: int) -> None:
        """Cool a chain: the frames take turns, so that each keeps its own light."""
        chips = self.problem.chips
        refresh(tables, chain, chips)
        work = np.empty((3, BLOCK), np.float32)
        for visit, first in enumerate(range(0, moves, _VISIT)):
            count = min(_VISIT, moves - first)
            frame = visit % self.frames
            chips_here = slice(frame * chips, (frame + 1) * chips)
            open_elsewhere = int(chain.code.sum()) - int(chain.code[chips_here].sum())
            limits = self.limits._replace(
                low=self.limits.low + open_elsewhere, high=self.limits.high + open_elsewhere
            )
            heats = heats_db[0] * (heats_db[1] / heats_db[0]) ** (
                np.array([first, first + count]) / moves
            )
            cool(tables, limits, chain, self.free + chips_here.start, work, heats, count)


def _round(
    joint: _Joint,
    elites: _Elites,
    budget: Budget,
    round_number: int,
    rng: np.random.Generator,
    pool: ThreadPoolExecutor,
    progress: Progress | None,
) -> None:
    """Cool chains side by side, from the best and from anywhere, and offer what they found,
    whatever ends them.
    """
    best = elites.ranked(joint.frames)
    # first round: every code known starts a chain; later half of them start anywhere
    leaders = min(len(best), CHAINS)
    if round_number:
        leaders = min(leaders, CHAINS // 2)
    random = joint.problem.random_codes(CHAINS * joint.frames, rng=rng).astype(np.int8)
    codes = [*best[:leaders], *random.reshape(CHAINS, joint.frames, -1)[leaders:]]
    runs = [joint.chain(start, int(rng.integers(1, 2**62))) for start in codes]
    # a move in one frame changes a sum of so many less, and colder still found better codes
    hot = hottest_db(joint.problem) / joint.frames**2
    heats = [hot] * CHAINS
    if round_number:
        heats[:leaders] = [REHEATED * hot] * leaders
    moves = budget.chain(round_number)
    try:
        for first in range(0, moves, _SLICE):
            count = min(_SLICE, moves - first)
            jobs = []
            for (tables, chain), heat in zip(runs, heats, strict=True):
                temperatures = heat * (hot / COOLING / heat) ** (
                    np.array([first, first + count]) / moves
                )
                jobs.append(pool.submit(joint.advance, tables, chain, temperatures, count))
            for job in jobs:
                job.result()
            budget.moves += count * CHAINS
            if progress is not None:
                progress(MOVES_SHARE * budget.share(), _as_codes(best[0]))
            if budget.elapsed() >= budget.time_s:
                break
    finally:
        for _, chain in runs:
            best_codes = found_by(chain)
            elites.offer(best_codes.reshape(len(best_codes), joint.frames, -1))


def _as_codes(codes: Codes) -> tuple[ShutterCode, ...]:
    return tuple(ShutterCode.from_array(code) for code in codes)
