"""Search of a code: annealing over flips and swaps, many chains at once; tabu walks; a polish on the continuum."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cep.band import straight_axis
from cep.code import ShutterCode
from cep.mtf import CodeMetrics
from cep.search.moves import propose
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from cep.search.tabu import TabuWalk, fits

__all__ = ["SearchResult", "anneal", "standard_moves"]

Progress = Callable[[float, ShutterCode], None]
_SEARCH_OVERSAMPLING = 8  # coarse: the polish judges on 64 and the continuum
_HOT_DB = {"min-mtf": 0.3, "noise": 0.3, "flatness": 0.1, "mse": 0.1}  # as their single moves differ: docs/decisions.md
_COOLING = 6.0  # hottest over coldest
_ROUND = 3000  # moves per chain from hot to cold
_CHECK = 64  # moves between looks at the clock
_ELITES = 24
_MOVES, _MOVES_WALKING = 1_000_000, 5_000_000  # a walk judges a move in a tenth of the time
_HOPEFUL = 8  # neighbours judged on the continuum in a step of the polish
_BATCH = 2**21  # numbers evaluated at once in it: 16 MB


@dataclass(frozen=True)
class SearchResult:
    """What a search found.

    Attributes
    ----------
    code : ShutterCode
    objective : float
        Cost in dB, lower is better, with minima over the continuum; see :mod:`cep.search.objective`.
    metrics : CodeMetrics
        Worst of each figure over the problem's scenarios and directions.
    seconds : float
    steps : int
        Moves tried.
    interrupted : bool
        Whether Ctrl-C or the time limit ended it: a time limit makes the outcome depend on the machine.
    """

    code: ShutterCode
    objective: float
    metrics: CodeMetrics
    seconds: float
    steps: int
    interrupted: bool


@dataclass
class _Elites:
    """Best distinct codes seen."""

    costs: dict[bytes, float] = field(default_factory=dict)

    def offer(self, codes: NDArray[np.int8], costs: NDArray[np.float64]) -> None:
        for code, cost in zip(codes, costs, strict=True):
            if np.isfinite(cost):
                self.costs[code.tobytes()] = float(cost)
        if len(self.costs) > _ELITES:
            self.costs = dict(sorted(self.costs.items(), key=lambda item: item[1])[:_ELITES])

    def ranked(self) -> NDArray[np.int8]:
        order = sorted(self.costs, key=self.costs.__getitem__)
        return np.array([np.frombuffer(key, dtype=np.int8) for key in order])


def anneal(
    problem: SearchProblem,
    *,
    rng: np.random.Generator,
    steps: int | None = 1_000_000,
    time_s: float = 60.0,
    start: Iterable[ShutterCode] = (),
    progress: Progress | None = None,
) -> SearchResult:
    """Search a code; anytime: a limit or Ctrl-C returns the best so far.

    Parameters
    ----------
    problem : SearchProblem
    rng : numpy Generator
        The same seed and ``steps`` give the same code, as long as ``time_s`` is not reached.
    steps : int, optional
        Moves to try, over all chains. None searches for ``time_s``, and is not reproducible.
    time_s : float
        Upper limit, seconds; the closing polish and measurement come on top.
    start : iterable of ShutterCode
        Codes to start from besides random ones, such as published ones; those that break a limit are left out.
    progress : callable, optional
        Called now and then with the fraction done, 0..1, and the best code so far. It may raise KeyboardInterrupt.

    Raises
    ------
    ValueError
        If a limit is not positive or a starting code has another length.
    """
    if steps is not None and steps < 1:
        raise ValueError(f"steps: must be at least 1, got {steps}")
    if not time_s > 0:
        raise ValueError(f"time_s: must be above 0 seconds, got {time_s}")
    given = [code.array for code in start]
    if any(bits.size != problem.chips for bits in given):
        raise ValueError(f"start: every code must have {problem.chips} chips")
    began = time.monotonic()
    coarse = Objective(problem, oversampling=_SEARCH_OVERSAMPLING)
    elites = _Elites()
    seeds = np.array([*given, problem.random_codes(1, rng=rng)[0]], dtype=np.int8)
    seeds = seeds[problem.satisfied(seeds)]
    elites.offer(seeds, coarse.cost_of(seeds))
    chains = int(np.clip(2**17 // coarse.basis[0].size, 4, 64))
    done, interrupted = 0, False

    def fraction() -> float:
        return max((time.monotonic() - began) / time_s, 0.0 if steps is None else done / steps)

    def judge(codes: NDArray[np.int8]) -> None:
        elites.offer(codes, coarse.cost_of(codes))

    walks: TabuWalk | None = None
    try:
        while not interrupted and (steps is None or done < steps):
            # walks go further from what a first round has annealed, where their neighbourhoods are affordable
            if done and fits(coarse):
                walks = walks or TabuWalk(coarse, elites.ranked()[:1])
                tries = walks.walk(rng, judge)
            else:
                rounds = _ROUND if steps is None else min(_ROUND, -(-(steps - done) // chains))
                codes = _starts(problem, elites, chains, rng, fresh=done == 0)
                tries = (tried * chains for tried in _round(problem, coarse, codes, rounds, judge, rng))
            for tried in tries:
                done += tried
                if time.monotonic() - began > time_s:
                    interrupted = steps is not None
                    raise TimeoutError
                if progress is not None:
                    progress(min(fraction(), 1.0), ShutterCode.from_array(elites.ranked()[0]))
    except TimeoutError:
        pass
    except KeyboardInterrupt:
        interrupted = True
    fine = Objective(problem, oversampling=64, dtype=np.float64)
    try:
        code, cost = _polish(problem, fine, elites)
    except KeyboardInterrupt:
        interrupted = True
        code = ShutterCode.from_array(elites.ranked()[0])
        cost = fine.exact_cost(code)
    return SearchResult(code, cost, problem.measure(code), time.monotonic() - began, done, interrupted)


def standard_moves(problem: SearchProblem) -> int:
    """Say after how many moves more rarely find a better code; more where tabu walks are affordable."""
    return _MOVES_WALKING if fits(Objective(problem, oversampling=_SEARCH_OVERSAMPLING)) else _MOVES


def _starts(
    problem: SearchProblem, elites: _Elites, chains: int, rng: np.random.Generator, *, fresh: bool
) -> NDArray[np.int8]:
    """Draw starting codes of a round: first everything given, later a quarter from the best; the rest random."""
    codes = problem.random_codes(chains, rng=rng)
    best = elites.ranked()
    kept = min(len(best), chains if fresh else max(1, chains // 4))
    codes[:kept] = best[:kept]
    return codes


def _round(
    problem: SearchProblem,
    objective: Objective,
    codes: NDArray[np.int8],
    moves: int,
    judge: Callable[[NDArray[np.int8]], None],
    rng: np.random.Generator,
) -> Iterable[int]:
    """Cool all chains once from hot to cold; yields the moves made since the last look at the clock."""
    otf = objective.otf(codes)
    cost = objective.cost(otf, codes.sum(axis=1, dtype=np.intp), soft=True)
    best_codes, best = codes.copy(), cost.copy()
    hot_db = sum(weight * _HOT_DB[name] for name, weight in problem.objective_mix)
    made = 0
    for move in range(moves):
        temperature = hot_db * _COOLING ** (-move / max(1, moves - 1))
        change = propose(problem, codes, rng=rng)
        trial_otf = change.applied(otf, objective.basis)
        trial_open = codes.sum(axis=1, dtype=np.intp) + change.opened
        trial = np.where(change.allowed, objective.cost(trial_otf, trial_open, soft=True), np.inf)
        accepted = trial - cost < temperature * rng.exponential(size=len(codes))
        codes[accepted] = change.codes[accepted]
        otf[accepted], cost[accepted] = trial_otf[accepted], trial[accepted]
        better = cost < best
        best[better], best_codes[better] = cost[better], codes[better]
        made += 1
        if made == _CHECK or move == moves - 1:
            # float32 sums drift
            otf = objective.otf(codes)
            # the soft cost leads the search, the plain one judges
            for seen in (best_codes, codes):
                judge(seen)
            yield made
            made = 0


def _polish(problem: SearchProblem, fine: Objective, elites: _Elites) -> tuple[ShutterCode, float]:
    """Judge the best codes on the continuum and climb from the leaders over all single flips and swaps."""
    curved = any(straight_axis(s.trajectory) is None for s in problem.scenarios)
    judged, climbed = (4, 1) if curved else (_ELITES, 4)
    ranked = [ShutterCode.from_array(code) for code in elites.ranked()[:judged]]
    leaders = sorted((fine.exact_cost(code), code.bits, code) for code in ranked)[:climbed]
    cost, code = min((_climb(problem, fine, code, cost) for cost, _, code in leaders), key=lambda pair: pair[0])
    return code, cost


def _climb(problem: SearchProblem, fine: Objective, code: ShutterCode, cost: float) -> tuple[float, ShutterCode]:
    step = max(1, _BATCH // fine.basis[0].size)
    while True:
        codes = _neighbours(problem, code)
        if not len(codes):
            return cost, code
        sampled = np.concatenate([fine.cost_of(codes[i : i + step]) for i in range(0, len(codes), step)])
        # a minimum over the continuum is never above the sampled one: only these can win
        hopeful = np.argsort(sampled)[:_HOPEFUL]
        hopeful = hopeful[sampled[hopeful] < cost - 1e-9]
        found = [(fine.exact_cost(c), c) for c in (ShutterCode.from_array(codes[i]) for i in hopeful)]
        best = min(found, key=lambda pair: pair[0], default=(cost, code))
        if best[0] >= cost - 1e-9:
            return cost, code
        cost, code = best


def _neighbours(problem: SearchProblem, code: ShutterCode) -> NDArray[np.int8]:
    """Codes within the limits that differ by one flip, or by swapping an open chip with a closed one."""
    bits = code.array.astype(np.int8)
    opened, closed = np.flatnonzero(bits), np.flatnonzero(bits == 0)
    flips = np.repeat(bits[None], len(bits), axis=0)
    flips[np.arange(len(bits)), np.arange(len(bits))] ^= 1
    first, second = (grid.ravel() for grid in np.meshgrid(opened, closed))
    swaps = np.repeat(bits[None], first.size, axis=0)
    swaps[np.arange(first.size), first] = 0
    swaps[np.arange(first.size), second] = 1
    codes = np.concatenate([flips, swaps])
    return codes[problem.satisfied(codes)]
