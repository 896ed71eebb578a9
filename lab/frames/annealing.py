"""Joint search of the codes of several exposures of one scene, with complementary spectra.

Frames taken along the same motion, each with its own code, are restored jointly: the inverse sees
the sum of their |H|^2, so all that a single code does with |H| they do with the root of that sum.
Their common noise gain is ``10 log10 mean 1 / sum |H|^2``, and under the camera's noise the sum
stands over the noise of a frame of mean light.

References
----------
Agrawal, Xu and Raskar, "Invertible motion blur in video", SIGGRAPH 2009: exposures whose joint
transform has no null.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.search.annealing.anneal import (
    CHAINS,
    COOLING,
    MOVES_SHARE,
    REHEATED,
    SEARCH_OVERSAMPLING,
    Budget,
    Elites,
    hottest_db,
)
from cep.search.annealing.cooling import (
    Chain,
    best_codes,
    cool,
    new_chain,
    own_tables,
    refresh,
)
from cep.search.annealing.polish import BATCH, GAIN_DB, neighbours, otf_nearby
from cep.search.annealing.proposals import LoopLimits
from cep.search.annealing.terms import BLOCK, Tables, lay_out
from cep.search.cost import CodeCost
from cep.search.problem import SearchProblem
from cep.search.search_result import Stopped
from motdiff.types import FloatArray

Codes = NDArray[np.int8]
Progress = Callable[[float, tuple[ShutterCode, ...]], None]
_SLICE = 4096  # moves until the OTF is summed anew: float32 sums drift
_VISIT = 256  # moves in one frame until the next one has its turn
_ELITES = 16  # choices from which chains start and the polish climbs
_MOST_WORK = 2**37  # multiplications for all swaps of a frame; beyond, the polish leaves them out
_ZERO_POWER = 1e-24  # smaller is rounding


@dataclass(frozen=True)
class FramesResult:
    """Result of a joint search.

    Attributes
    ----------
    codes : tuple of ShutterCode
        One for each frame.
    objective : float
        Joint cost in dB on the fine grid, lower is better; see
        :func:`joint_cost`.
    minimum, noise_gain_db : float
        As :class:`JointFigures` has them; the minimum is sampled.
    seconds : float
    steps : int
        Moves tried.
    stopped : {"steps", "time", "interrupted", "complete"}
        Reason of its end, as of :class:`cep.search.search_result.SearchResult`.
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
    """Search the codes of several frames that restore best together; anytime, as ``anneal``.

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
    coarse = CodeCost(problem, oversampling=SEARCH_OVERSAMPLING)

    def cost_of(choices: Codes) -> FloatArray:
        # one by one: rounding must not make a cost depend on what it is judged beside
        return np.concatenate([joint_cost(coarse, codes[None]) for codes in choices])

    elites = Elites(cost_of, _ELITES)
    seeds = np.array([*starts, problem.random_codes(frames, rng=rng)], dtype=np.int8)
    seeds = seeds[[bool(problem.satisfied(codes).all()) for codes in seeds]]
    elites.offer(seeds)
    stopped: Stopped = "complete"

    try:
        joint = _Joint.of(coarse, frames)
        with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
            round_number = 0
            while budget.remains():
                _round(joint, elites, budget, round_number, rng, pool, progress)
                round_number += 1
        stopped = budget.stopped()
    except KeyboardInterrupt:
        stopped = "interrupted"
    # no start may beat what is returned on the fine grid
    ranked = np.concatenate([elites.ranked().reshape(-1, frames, problem.chips), seeds])

    def report(piece: tuple[NDArray[np.int8], float], over: bool) -> None:
        if progress is not None:
            share = 1.0 if over else MOVES_SHARE + (1 - MOVES_SHARE) * piece[1]
            progress(share, _as_codes(piece[0]))

    (best, _), stopped = budget.polished(
        (ranked[0], 0.0), polish_jointly(problem, ranked), report, stopped=stopped
    )
    codes = _as_codes(best)
    cost = float(joint_cost(CodeCost.fine(problem), best[None])[0])
    return FramesResult(
        codes, cost, *joint_figures(problem, codes), budget.elapsed(), budget.moves, stopped
    )


@dataclass(frozen=True)
class _Joint:
    """A problem of several frames for the compiled loop: its code is their chips in a row."""

    problem: SearchProblem
    frames: int
    tables: Tables
    limits: LoopLimits

    @classmethod
    def of(cls, coarse: CodeCost, frames: int) -> _Joint:
        problem = coarse.problem
        tables = joint_tables(coarse, frames)
        return cls(problem, frames, tables, LoopLimits.of(problem))

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
            free = np.arange(chips_here.start, chips_here.stop)
            cool(tables, limits, chain, free, work, heats, count)


def _round(
    joint: _Joint,
    elites: Elites,
    budget: Budget,
    round_number: int,
    rng: np.random.Generator,
    pool: ThreadPoolExecutor,
    progress: Progress | None,
) -> None:
    """Cool chains side by side, and offer their best codes, whatever ends them."""
    best = elites.ranked().reshape(-1, joint.frames, joint.problem.chips)
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
            chain_codes = best_codes(chain)
            elites.offer(chain_codes.reshape(len(chain_codes), joint.frames, -1))


def _as_codes(codes: Codes) -> tuple[ShutterCode, ...]:
    return tuple(ShutterCode(code) for code in codes)


class JointFigures(NamedTuple):
    """Figures of frames restored together, light-true, the worst of scenarios and directions.

    Attributes
    ----------
    minimum : float
        Smallest root of sum |H|^2 on the fine grid of frequencies: sampled, unlike a single code's
        proven minimum.
    noise_gain_db : float
        ``10 log10 mean 1 / sum |H|^2``; infinite when a sample falls on a common zero.
    """

    minimum: float
    noise_gain_db: float


def joint_cost(code_cost: CodeCost, codes: NDArray[Any]) -> FloatArray:
    """Cost, dB, of frames restored together: of the root of sum |H|^2, at their mean light.

    Parameters
    ----------
    code_cost : CodeCost
    codes : (R, M, n) array
        R choices of M codes.

    Returns
    -------
    (R,) float
    """
    frames = np.moveaxis(codes, 1, 0)
    power = sum(_power(code_cost, frame) for frame in frames)
    duty = np.mean([code_cost.duty(frame) for frame in frames], axis=0)
    return _cost_of_power(code_cost, np.asarray(power), duty)


def joint_figures(problem: SearchProblem, codes: Sequence[ShutterCode]) -> JointFigures:
    """Measure frames restored together; M times one code gain 10 log10 M dB over it."""
    fine = CodeCost.fine(problem)
    power = _power(fine, np.stack([code.array for code in codes])).sum(axis=0)
    power = np.where(power < _ZERO_POWER, 0.0, power)
    with np.errstate(divide="ignore"):
        inverse = 1 / power
    noise = max(float(motion.samples.weight @ inverse[motion.columns]) for motion in fine.parts)
    return JointFigures(float(np.sqrt(power.min())), float(10 * np.log10(noise)))


def joint_tables(code_cost: CodeCost, frames: int) -> Tables:
    """Lay a problem out for the compiled loops, whose code is then all frames' chips in a row."""
    chips = code_cost.problem.chips
    tables = lay_out(code_cost)
    # of M frames the light counts by their mean, which need not be a whole number of chips
    mean_open = np.arange(frames * chips + 1) / frames
    noise = np.interp(mean_open, np.arange(chips + 1), code_cost.noise)
    light = np.array(
        [criterion.light(mean_open, noise) for criterion, _ in code_cost.problem.criteria],
        dtype=np.float32,
    )
    return tables._replace(rows=np.tile(tables.rows, (frames, 1, 1, 1, 1)), light=light)


def polish_jointly(problem: SearchProblem, ranked: Codes) -> Iterator[tuple[Codes, float]]:
    """Climb on the fine grid from the best of (R, M, n) codes, by flips and swaps in each frame.

    Yields
    ------
    (M, n) int8, float
        The best so far, and the fraction done; after every piece of work, so that the caller may
        stop.
    """
    fine = CodeCost.fine(problem)
    costs = np.concatenate([joint_cost(fine, codes[None]) for codes in ranked])
    # a curved path has so many more frequencies
    leaders = np.argsort(costs, kind="stable")[: 4 if problem.straight else 1]
    best = ranked[leaders[0]]
    lowest = float(costs[leaders[0]])
    for number, leader in enumerate(leaders):
        for cost, codes in _climb(fine, ranked[leader].copy(), float(costs[leader])):
            if cost < lowest:
                best = codes.copy()
                lowest = cost
            yield best, number / len(leaders)


def _climb(fine: CodeCost, codes: Codes, cost: float) -> Iterator[tuple[float, Codes]]:
    """Change the codes in place until no neighbour is better; yields them now and then."""
    frames, chips = codes.shape
    step = max(1, BATCH // fine.rows[0].size)
    swaps = chips**2 // 4 * fine.rows[0].size * chips <= _MOST_WORK
    stuck = frame = 0
    while stuck < frames:
        other_frames = np.delete(codes, frame, axis=0)
        power = _power(fine, other_frames).sum(axis=0)
        duty = fine.duty(other_frames).sum()
        otf = fine.otf(codes[frame][None])[0]
        candidates = neighbours(fine.problem, codes[frame], swaps=swaps)
        costs = np.full(len(candidates), np.inf)
        for first in range(0, len(candidates), step):
            batch = candidates[first : first + step]
            frame_power = (otf_nearby(fine, codes[frame], otf, batch) ** 2).sum(axis=1)
            costs[first : first + step] = _cost_of_power(
                fine, frame_power + power, (fine.duty(batch) + duty) / frames
            )
            yield cost, codes
        if costs.size and costs.min() < cost - GAIN_DB:
            best = int(costs.argmin())
            cost = float(costs[best])
            codes[frame] = candidates[best]
            stuck = 0
        else:
            frame = (frame + 1) % frames
            stuck = stuck + 1
        yield cost, codes


def _power(code_cost: CodeCost, codes: NDArray[Any]) -> NDArray[Any]:
    """|H|^2, (R, F), of (R, n) codes."""
    return np.asarray((code_cost.otf(codes) ** 2).sum(axis=1))


def _cost_of_power(code_cost: CodeCost, power: NDArray[Any], duty: FloatArray) -> FloatArray:
    root = np.sqrt(power)
    return code_cost.cost(np.stack([root, np.zeros_like(root)], axis=1), duty)
