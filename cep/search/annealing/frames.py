"""Codes of several exposures of one scene, searched together: where one of them is blind, another one sees.

Frames taken along the same motion, each with its own code, are restored jointly: the inverse sees the sum of their
|H|^2, so all that a single code does with |H| they do with the root of that sum. Their common noise gain is
``10 log10 mean 1 / sum |H|^2``, and under the camera's noise the sum stands over the noise of a frame of mean light.

References
----------
Agrawal, Xu and Raskar, "Invertible motion blur in video", SIGGRAPH 2009: exposures whose joint transform has no null.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.band import straight_axis
from cep.code import ShutterCode
from cep.search.annealing.anneal import Budget, hottest_db
from cep.search.annealing.cooling import Chain, cool
from cep.search.annealing.polish import neighbours
from cep.search.annealing.proposals import Limits
from cep.search.annealing.states import fresh_otf, total_cost, worst_first
from cep.search.annealing.tables import lay_out, limits_of
from cep.search.annealing.terms import BLOCK, Tables
from cep.search.objective import Objective
from cep.search.problem import SearchProblem

__all__ = ["FramesResult", "JointFigures", "anneal_frames", "joint_cost", "joint_figures"]

Codes = NDArray[np.int8]
FloatArray = NDArray[np.float64]
Progress = Callable[[float, tuple[ShutterCode, ...]], None]
_OVERSAMPLING, _FINE = 8, 64
_CHAINS = 8
_COOLING = 3.0  # hottest over coldest
_REHEATED = 0.6
_SLICE, _VISIT = 4096, 256  # moves until the OTF is summed anew, and in one frame until the next one has its turn
_ELITES = 16
_BATCH = 2**21  # numbers evaluated at once: 16 MB
_MOST_WORK = 2**37  # multiplications for all swaps of a frame; beyond, the polish leaves them out
_ZERO_POWER = 1e-24  # smaller is rounding


class JointFigures(NamedTuple):
    """What frames are worth together, light-true, the worst over a problem's scenarios and directions.

    Attributes
    ----------
    minimum : float
        Smallest root of sum |H|^2 on the fine grid of frequencies: sampled, unlike a single code's proven minimum.
    noise_gain_db : float
        ``10 log10 mean 1 / sum |H|^2``; infinite when a sample falls on a common zero.
    """

    minimum: float
    noise_gain_db: float


@dataclass(frozen=True)
class FramesResult:
    """What a joint search found.

    Attributes
    ----------
    codes : tuple of ShutterCode
        One for each frame.
    objective : float
        Joint cost in dB on the fine grid, lower is better; see :func:`joint_cost`.
    minimum, noise_gain_db : float
        As :class:`JointFigures` has them; the minimum is sampled.
    seconds : float
    steps : int
        Moves tried.
    interrupted : bool
        Whether Ctrl-C or the time limit ended it: a time limit makes the outcome depend on the machine.
    """

    codes: tuple[ShutterCode, ...]
    objective: float
    minimum: float
    noise_gain_db: float
    seconds: float
    steps: int
    interrupted: bool


def joint_cost(objective: Objective, codes: NDArray[Any]) -> FloatArray:
    """Cost, dB, of frames restored together: of the root of sum |H|^2, in frames of their mean light.

    Parameters
    ----------
    objective : Objective
    codes : (R, M, n) array
        R choices of M codes.

    Returns
    -------
    (R,) float
    """
    power = sum(_power(objective, codes[:, frame]) for frame in range(codes.shape[1]))
    duty = np.mean([objective.duty(codes[:, frame]) for frame in range(codes.shape[1])], axis=0)
    return _cost_of_power(objective, np.asarray(power), duty)


def joint_figures(problem: SearchProblem, codes: Sequence[ShutterCode]) -> JointFigures:
    """Measure frames restored together on the fine grid; M times the same code gain 10 log10 M dB over one."""
    fine = Objective(problem, oversampling=_FINE, dtype=np.float64)
    power = _power(fine, np.stack([code.array for code in codes])).sum(axis=0)
    power = np.where(power < _ZERO_POWER, 0.0, power)
    with np.errstate(divide="ignore"):
        noise = max(float(part.samples.weight @ (1 / power[part.columns])) for part in fine.parts)
    return JointFigures(float(np.sqrt(power.min())), float(10 * np.log10(noise)))


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
    """Search the codes of several frames that restore best together; anytime, as :func:`cep.search.annealing.anneal`.

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
        Upper limit, seconds; the closing polish comes on top.
    start : iterable of sequences of ShutterCode
        Codes of all frames to start from, besides random ones; those that break a limit are left out.
    progress : callable, optional
        Called now and then with the fraction done, 0..1, and the best codes so far. It may raise KeyboardInterrupt.
    threads : int, optional
        As many as there are cores when omitted; the outcome does not depend on it.

    Raises
    ------
    ValueError
        If a limit is not positive or a start has another number of frames or chips.
    """
    if frames < 1:
        raise ValueError(f"frames: must be at least 1, got {frames}")
    if steps is not None and steps < 1:
        raise ValueError(f"steps: must be at least 1, got {steps}")
    if not time_s > 0:
        raise ValueError(f"time_s: must be above 0 seconds, got {time_s}")
    given = [[code.array for code in codes] for codes in start]
    if any(len(codes) != frames or any(bits.size != problem.chips for bits in codes) for codes in given):
        raise ValueError(f"start: every one must be {frames} codes of {problem.chips} chips")
    budget = Budget(steps, time_s, time.monotonic())
    elites = _Elites(Objective(problem, oversampling=_OVERSAMPLING))
    seeds = np.array([*given, problem.random_codes(frames, rng=rng)], dtype=np.int8)
    elites.offer(seeds[[bool(problem.satisfied(codes).all()) for codes in seeds]])
    free = np.flatnonzero([mark == "?" for mark in problem.fixed or "?" * problem.chips])
    interrupted = False
    try:
        if free.size:
            joint = _Joint.of(elites.coarse, frames, free)
            with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
                round_number = 0
                while budget.left():
                    _round(joint, elites, budget, round_number, rng, pool, progress)
                    round_number += 1
            interrupted = steps is not None and budget.done < steps
    except KeyboardInterrupt:
        interrupted = True
    fine = Objective(problem, oversampling=_FINE, dtype=np.float64)
    ranked = elites.ranked(frames)
    try:
        best = _polish(fine, ranked)
    except KeyboardInterrupt:
        interrupted, best = True, ranked[0]
    codes = _as_codes(best)
    cost = float(joint_cost(fine, best[None])[0])
    return FramesResult(codes, cost, *joint_figures(problem, codes), budget.elapsed(), budget.done, interrupted)


@dataclass
class _Elites:
    """Best distinct choices of codes seen, their frames one after the other."""

    coarse: Objective
    costs: dict[bytes, float] = field(default_factory=dict)

    def offer(self, choices: Codes) -> None:
        for codes in choices:
            self.costs[codes.astype(np.int8).tobytes()] = float(joint_cost(self.coarse, codes[None])[0])
        self.costs = dict(sorted(self.costs.items(), key=lambda item: item[1])[:_ELITES])

    def ranked(self, frames: int) -> Codes:
        return np.array([np.frombuffer(key, dtype=np.int8).reshape(frames, -1) for key in self.costs])


@dataclass(frozen=True)
class _Joint:
    """A problem of several frames for the compiled loop, whose code is all frames' chips in a row."""

    problem: SearchProblem
    frames: int
    tables: Tables
    limits: Limits
    free: NDArray[np.int64]

    @classmethod
    def of(cls, coarse: Objective, frames: int, free: NDArray[np.intp]) -> _Joint:
        problem, tables = coarse.problem, lay_out(coarse)
        mean_open = np.arange(frames * problem.chips + 1) / frames
        light = np.ones((len(tables.kinds), mean_open.size), np.float32)
        for o, (name, _) in enumerate(problem.objective_mix):
            if name == "flatness":
                light[o, 1:] = mean_open[1:] ** -2.0
            elif name == "mse":
                light[o] = 1 / np.interp(mean_open, np.arange(problem.chips + 1), coarse.noise)
        tables = tables._replace(rows=np.tile(tables.rows, (frames, 1, 1, 1, 1)), light=light)
        return cls(problem, frames, tables, limits_of(problem), free.astype(np.int64))

    def chain(self, codes: Codes, seed: int) -> tuple[Tables, Chain]:
        """Start a chain at (M, n) codes, with the tables that it sorts for itself."""
        tables = self.tables._replace(
            rows=self.tables.rows.copy(), scale=self.tables.scale.copy(), offset=self.tables.offset.copy()
        )
        code = codes.ravel()
        otf = np.empty((self.frames, tables.rows.shape[2], 2, BLOCK), np.float32)
        costs, random = np.array([np.inf, np.inf, 0.0]), np.array([seed | 1], dtype=np.uint64)
        return tables, Chain(code.copy(), code.copy(), code.copy(), otf, costs, random)

    def advance(self, tables: Tables, chain: Chain, heats_db: FloatArray, moves: int) -> None:
        """Cool a chain: the frames take turns, so that each keeps its own light."""
        chips = self.problem.chips
        fresh_otf(tables, chain.code, chips, chain.otf)
        worst_first(tables, chain.otf)
        chain.cost[0] = total_cost(tables, chips, chain.code, chain.otf)
        if chain.cost[0] < chain.cost[1]:
            chain.cost[1] = chain.cost[0]
            chain.best[:] = chain.code
        work = np.empty((3, BLOCK), np.float32)
        for visit, first in enumerate(range(0, moves, _VISIT)):
            count, frame = min(_VISIT, moves - first), visit % self.frames
            own = slice(frame * chips, (frame + 1) * chips)
            others = int(chain.code.sum()) - int(chain.code[own].sum())
            limits = self.limits._replace(low=self.limits.low + others, high=self.limits.high + others)
            heats = heats_db[0] * (heats_db[1] / heats_db[0]) ** (np.array([first, first + count]) / moves)
            cool(tables, limits, chain, self.free + own.start, work, heats, count)


def _round(
    joint: _Joint,
    elites: _Elites,
    budget: Budget,
    round_number: int,
    rng: np.random.Generator,
    pool: ThreadPoolExecutor,
    progress: Progress | None,
) -> None:
    """Cool chains side by side, from the best and from anywhere, and offer what they found, whatever ends them."""
    best = elites.ranked(joint.frames)
    kept = min(len(best), _CHAINS // 2 if round_number else _CHAINS)
    drawn = joint.problem.random_codes(_CHAINS * joint.frames, rng=rng).astype(np.int8)
    codes = [*best[:kept], *drawn.reshape(_CHAINS, joint.frames, -1)[kept:]]
    runs = [joint.chain(one, int(rng.integers(1, 2**62))) for one in codes]
    # a move in one of the frames changes less
    hot = hottest_db(joint.problem) / joint.frames
    heats = [hot * (_REHEATED if round_number and index < kept else 1.0) for index in range(_CHAINS)]
    moves = budget.chain(round_number)
    try:
        for first in range(0, moves, _SLICE):
            count = min(_SLICE, moves - first)
            jobs = []
            for (tables, chain), heat in zip(runs, heats, strict=True):
                ends = heat * (hot / _COOLING / heat) ** (np.array([first, first + count]) / moves)
                jobs.append(pool.submit(joint.advance, tables, chain, ends, count))
            for job in jobs:
                job.result()
            budget.done += count * _CHAINS
            if progress is not None:
                progress(budget.used(), _as_codes(best[0]))
            if budget.elapsed() >= budget.time_s:
                break
    finally:
        for _, chain in runs:
            # the deepest is only kept for the minimum's objective
            found = [chain.best, chain.deepest] if chain.cost[2] > 0 else [chain.best]
            elites.offer(np.stack(found).reshape(len(found), joint.frames, -1))


def _polish(fine: Objective, ranked: Codes) -> Codes:
    """Climb on the fine grid from the best of (R, M, n) codes, over flips and swaps within each frame."""
    curved = any(straight_axis(scenario.trajectory) is None for scenario in fine.problem.scenarios)
    costs = np.concatenate([joint_cost(fine, codes[None]) for codes in ranked])
    leaders = np.argsort(costs, kind="stable")[: 1 if curved else 4]
    climbed = [_climb(fine, ranked[leader].copy(), float(costs[leader])) for leader in leaders]
    return min(climbed, key=lambda pair: pair[0])[1]


def _climb(fine: Objective, codes: Codes, cost: float) -> tuple[float, Codes]:
    frames, chips = codes.shape
    step = max(1, _BATCH // fine.rows[0].size)
    swaps = chips**2 // 4 * fine.rows[0].size * chips <= _MOST_WORK
    stuck = frame = 0
    while stuck < frames:
        others = np.delete(codes, frame, axis=0)
        power, duty = _power(fine, others).sum(axis=0), fine.duty(others).sum()
        near = neighbours(fine.problem, codes[frame], swaps=swaps)
        batches = [near[first : first + step] for first in range(0, len(near), step)]
        judged = [
            _cost_of_power(fine, _power(fine, batch) + power, (fine.duty(batch) + duty) / frames) for batch in batches
        ]
        found = np.concatenate(judged) if judged else np.array([np.inf])
        best = int(found.argmin())
        if found[best] < cost - 1e-9:
            cost, codes[frame], stuck = float(found[best]), near[best], 0
        else:
            frame, stuck = (frame + 1) % frames, stuck + 1
    return cost, codes


def _power(objective: Objective, codes: NDArray[Any]) -> NDArray[Any]:
    """|H|^2, (R, F), of (R, n) codes."""
    return np.asarray((objective.otf(codes) ** 2).sum(axis=1))


def _cost_of_power(objective: Objective, power: NDArray[Any], duty: FloatArray) -> FloatArray:
    root = np.sqrt(power)
    return objective.cost(np.stack([root, np.zeros_like(root)], axis=1), duty)


def _as_codes(codes: Codes) -> tuple[ShutterCode, ...]:
    return tuple(ShutterCode.from_array(code) for code in codes)
