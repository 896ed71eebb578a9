"""Joint restoration of several frames of one scene: cost, figures and polish of their codes.

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

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cep.optics.band import straight_axis
from cep.optics.code import ShutterCode
from cep.search.annealing.polish import neighbours, otf_nearby
from cep.search.annealing.terms import Tables, lay_out
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from motdiff.types import FloatArray

Codes = NDArray[np.int8]
_FINE = 64
_BATCH = 2**18  # numbers of an OTF evaluated at once: they stay in the cache
_MOST_WORK = 2**37  # multiplications for all swaps of a frame; beyond, the polish leaves them out
_ZERO_POWER = 1e-24  # smaller is rounding


class JointFigures(NamedTuple):
    """Figures of frames restored together, light-true, the worst over a problem's scenarios and
    directions.

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


def joint_cost(objective: Objective, codes: NDArray[Any]) -> FloatArray:
    """Cost, dB, of frames restored together: of the root of sum |H|^2, in frames of their mean
    light.

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
    """Measure frames restored together on the fine grid; M times the same code gain 10 log10 M dB
    over one.
    """
    fine = Objective(problem, oversampling=_FINE, dtype=np.float64)
    power = _power(fine, np.stack([code.array for code in codes])).sum(axis=0)
    power = np.where(power < _ZERO_POWER, 0.0, power)
    with np.errstate(divide="ignore"):
        noise = max(
            float(motion.samples.weight @ (1 / power[motion.columns])) for motion in fine.parts
        )
    return JointFigures(float(np.sqrt(power.min())), float(10 * np.log10(noise)))


def joint_tables(objective: Objective, frames: int) -> Tables:
    """Lay a problem out for the compiled loops, whose code is then all frames' chips in a row."""
    chips = objective.problem.chips
    tables = lay_out(objective)
    mean_open = np.arange(frames * chips + 1) / frames
    noise = np.interp(mean_open, np.arange(chips + 1), objective.noise)
    light = np.array(
        [criterion.light(mean_open, noise) for criterion, _ in objective.problem.criteria],
        dtype=np.float32,
    )
    return tables._replace(rows=np.tile(tables.rows, (frames, 1, 1, 1, 1)), light=light)


def polish_jointly(problem: SearchProblem, ranked: Codes) -> Iterator[tuple[Codes, float]]:
    """Climb on the fine grid from the best of (R, M, n) codes, over flips and swaps within each
    frame.

    Yields
    ------
    (M, n) int8, float
        The best so far, and the fraction done; after every piece of work, so that the caller may
        stop.
    """
    fine = Objective(problem, oversampling=_FINE, dtype=np.float64)
    curved = any(straight_axis(scenario.trajectory) is None for scenario in problem.scenarios)
    costs = np.concatenate([joint_cost(fine, codes[None]) for codes in ranked])
    leaders = np.argsort(costs, kind="stable")[: 1 if curved else 4]
    best = ranked[leaders[0]]
    lowest = float(costs[leaders[0]])
    for number, leader in enumerate(leaders):
        for cost, codes in _climb(fine, ranked[leader].copy(), float(costs[leader])):
            if cost < lowest:
                best = codes.copy()
                lowest = cost
            yield best, number / len(leaders)


def _climb(fine: Objective, codes: Codes, cost: float) -> Iterator[tuple[float, Codes]]:
    """Change the codes in place until no neighbour is better; where they stand, after every piece
    of work.
    """
    frames, chips = codes.shape
    step = max(1, _BATCH // fine.rows[0].size)
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
        # a hair of gain does not count: rounding could exchange two equal codes without end
        if costs.size and costs.min() < cost - 1e-9:
            best = int(costs.argmin())
            cost, codes[frame], stuck = float(costs[best]), candidates[best], 0
        else:
            frame = (frame + 1) % frames
            stuck = stuck + 1
        yield cost, codes


def _power(objective: Objective, codes: NDArray[Any]) -> NDArray[Any]:
    """|H|^2, (R, F), of (R, n) codes."""
    return np.asarray((objective.otf(codes) ** 2).sum(axis=1))


def _cost_of_power(objective: Objective, power: NDArray[Any], duty: FloatArray) -> FloatArray:
    root = np.sqrt(power)
    return objective.cost(np.stack([root, np.zeros_like(root)], axis=1), duty)
