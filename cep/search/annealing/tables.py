"""A search problem laid out for the compiled loop: rows of the chip basis in blocks of frequencies, terms, limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cep.search.annealing.proposals import Limits
from cep.search.annealing.terms import BLOCK, FLATNESS, RECIPROCAL, STEEP, Tables
from cep.search.objective import Objective
from cep.search.problem import SearchProblem

__all__ = ["lay_out", "limits_of", "work_space"]

FloatArray = NDArray[np.float64]
_LEAST = 1e-9  # of a term's x, however deep a zero: 1 / x^4 must not overflow
_NEVER = 1e30  # offset of columns that fill up a block: their terms vanish


def limits_of(problem: SearchProblem) -> Limits:
    """Light and run limits for the compiled loop."""
    low, high = problem.open_limits
    return Limits(
        problem.chips,
        low,
        high,
        problem.min_open,
        problem.min_closed,
        problem.max_pulses or problem.chips,
        problem.max_open or problem.chips,
        problem.min_period,
        problem.limits_runs,
    )


def lay_out(objective: Objective) -> Tables:
    """Pack each part's columns into blocks, with what each objective makes of them."""
    problem = objective.problem
    columns: list[NDArray[np.intp]] = []
    layout: list[tuple[int, int, int]] = []
    blocks = 0
    for part in objective.parts:
        heavy = np.flatnonzero(part.samples.weight > 0) + part.columns.start
        size = -(-heavy.size // BLOCK)
        columns.append(np.concatenate([heavy, np.full(size * BLOCK - heavy.size, -1)]))
        layout.append((blocks, blocks + size, part.scenario))
        blocks += size
    places = np.concatenate(columns)
    filling = places < 0
    weight = np.concatenate([part.samples.weight for part in objective.parts])[places]
    chips = problem.chips
    mix = problem.objective_mix
    across = max((p.samples.radius2.shape[1] for p in objective.parts), default=1) if "mse" in dict(mix) else 1
    scale = np.zeros((len(mix), across, places.size))
    offset = np.full((len(mix), across, places.size), _NEVER)
    light = np.ones((len(mix), chips + 1))
    kinds = []
    for o, (name, _) in enumerate(mix):
        kept = ~filling
        kinds.append({"min-mtf": STEEP, "flatness": FLATNESS}.get(name, RECIPROCAL))
        if name == "min-mtf":
            scale[o, 0, kept], offset[o, 0, kept] = chips**-2, _LEAST
        elif name == "noise":
            scale[o, 0, kept], offset[o, 0, kept] = 1 / (weight[kept] * chips**2), _LEAST
        elif name == "flatness":
            scale[o, 0, kept] = weight[kept]
            light[o, 1:] = 1.0 / np.arange(1, chips + 1) ** 2
        else:
            share = (objective.shares_across[places] * weight[:, None]).T * ~filling
            some = share > 0
            scale[o][some] = 1 / (share[some] * chips**2)
            offset[o][some] = objective.priors[places].T[some] / share[some]
            light[o] = 1 / objective.noise
    rows = (chips * objective.rows)[..., np.where(filling, 0, places)]
    rows[..., filling] = 0
    packed = rows.reshape(*rows.shape[:3], -1, BLOCK).transpose(0, 1, 3, 2, 4)
    return Tables(
        rows=_contiguous(packed),
        layout=np.array(layout, dtype=np.int64),
        kinds=np.array(kinds, dtype=np.int64),
        weights=np.array([weight for _, weight in mix]),
        scale=_contiguous(scale.reshape(len(mix), across, -1, BLOCK).transpose(0, 2, 1, 3)),
        offset=_contiguous(offset.reshape(len(mix), across, -1, BLOCK).transpose(0, 2, 1, 3)),
        light=_contiguous(light),
        shares=objective.scenario_shares,
        mean_rule=problem.rule == "mean",
    )


def work_space(tables: Tables, problem: SearchProblem) -> NDArray[np.float32] | None:
    """Work space for the compiled loops: None where moves change two chips at most and one plain sum decides."""
    usual = len(tables.kinds) == 1 and tables.kinds[0] != FLATNESS and tables.scale.shape[2] == 1
    return None if usual and not problem.limits_runs else np.empty((3, BLOCK), np.float32)


def _contiguous(array: FloatArray) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, dtype=np.float32)
