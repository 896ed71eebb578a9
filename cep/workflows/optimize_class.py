"""One code for a class of motions, where the order of a single one in time cannot be had."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.io.files import StoredCode, write_code
from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_frame, check_resolved
from cep.search.objective import Objective
from cep.search.problem import SearchProblem
from cep.search.recipe import Found
from cep.search.scenarios import class_scenarios
from cep.workflows.optimize import Search, described_search, ended_early, search, stored_search
from motdiff.gyro import GyroTrace
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.trajectory import Trajectory

__all__ = [
    "CLASS_OBJECTIVES",
    "DRAWN",
    "OTHERS",
    "ClassOptimum",
    "ClassRow",
    "check_class",
    "draw_motions",
    "optimize_class",
    "per_motion_db",
]

FloatArray = NDArray[np.float64]
CLASS_OBJECTIVES = ("noise", "mse")
"""Objectives whose mean over a class says something: along most curved paths a minimum is a true zero."""

DRAWN, OTHERS = 100, 300
"""Motions drawn to search a code on, and others to judge it by: docs/decisions/search.md."""

_TOLERANCE_PX = 0.01  # of the drawn paths: a walk of 2000 samples takes eight times as long
_AT_ONCE = 32  # motions in memory while codes are judged
_SEARCH_SHARE = 0.8  # of the time: judging takes the rest
_FEW = 20  # motions below which a class code has mostly learned them by heart


@dataclass(frozen=True)
class ClassRow:
    """A code and its mean over the motions of a class.

    Attributes
    ----------
    name : str
        "this code", or of a :class:`cep.search.recipe.Baseline`.
    code : ShutterCode
    within_limits : bool
    mean_db : float
        Mean of the objective's decibels over the motions of the search, lower is better.
    others_db : float or None
        The same over motions that the search has not seen; None where there are none.
    behind_db, behind_error_db : float
        Excess over this code's decibels in the mean over the motions not seen, or where there are none over all, and
        its standard error.
    """

    name: str
    code: ShutterCode
    within_limits: bool
    mean_db: float
    others_db: float | None
    behind_db: float
    behind_error_db: float

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        return {
            "bits": self.code.bits,
            "open": self.code.open_chips,
            "within_limits": self.within_limits,
            "mean_db": self.mean_db,
            "others_db": self.others_db,
            "behind_db": self.behind_db,
            "behind_error_db": self.behind_error_db,
        }


@dataclass(frozen=True)
class ClassOptimum:
    """A code searched for a class of motions, and what it is worth.

    Attributes
    ----------
    problem : SearchProblem
        Of the rule "mean".
    how : Search
    found : Found
    rows : tuple of ClassRow
        The code first, then what would be used instead of it.
    motions, others : int
        Motions of the search, and others that judge it.
    """

    problem: SearchProblem
    how: Search
    found: Found
    rows: tuple[ClassRow, ...]
    motions: int
    others: int

    @property
    def code(self) -> ShutterCode:
        """The code."""
        return self.rows[0].code

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know besides the figures, one sentence each."""
        few = (
            [f"{self.motions} motions are few for a class, the code may suit no others; {_FEW} or more are better"]
            if self.motions < _FEW
            else []
        )
        return (*ended_early(self.how, self.found.stopped, self.how.moves(self.problem)), *few)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``cep optimize --class --json`` prints them."""
        code, found, own = self.code, self.found, self.rows[0]
        return {
            "bits": code.bits,
            "chips": code.chips,
            "open": code.open_chips,
            "duty": code.duty,
            "chip_ns": code.chip_ns,
            "objective": self.problem.objective,
            "motions": self.motions,
            "other_motions": self.others,
            "mean_db": own.mean_db,
            "others_db": own.others_db,
            "seconds": found.seconds,
            "steps": found.steps,
            "stopped": found.stopped,
            "interrupted": found.stopped == "interrupted",
            "baselines": {row.name: row.to_dict() for row in self.rows[1:]},
        }

    def save(self, path: Path | str, *, described: Mapping[str, Any] | None = None) -> None:
        """Write a ``code.json``, whole or not at all; it has no certificate, which is for a single motion."""
        own = self.rows[0]
        about = stored_search(described or described_search(self.problem, self.how), self.found)
        figures = {"mean_db": own.mean_db, "others_db": own.others_db}
        write_code(path, StoredCode(self.code, {}, {**about, "motions": self.motions, **figures}, {}))


def draw_motions(
    count: int,
    *,
    length_px: float,
    rng: np.random.Generator,
    gyro: GyroTrace | None = None,
    exposure_s: float | None = None,
) -> tuple[Trajectory, ...]:
    """Draw hand shakes: simulated walks, or pieces of a recording.

    Parameters
    ----------
    count : int
    length_px : float
        Length of each path, or with a recording the larger side of its bounding box, px.
    rng : numpy Generator
    gyro : GyroTrace, optional
        Recording; walks as of :func:`motdiff.motions.boracchi_foi` when omitted.
    exposure_s : float, optional
        Length of each piece of the recording, seconds; needed with one.

    Raises
    ------
    ValueError
        If the length is not positive, or the recording is too short or too still.
    """
    if gyro is None:
        drawn = [boracchi_foi(rng, max_length_px=length_px) for _ in range(count)]
    else:
        assert exposure_s is not None
        drawn = [random_gyro_motion(gyro, rng, exposure_s=exposure_s, extent_px=length_px) for _ in range(count)]
    return tuple(path.thinned(_TOLERANCE_PX) for path in drawn)


def check_class(problem: SearchProblem) -> None:
    """Refuse a problem that has no meaningful mean over a class of motions.

    Raises
    ------
    ValueError
        If the objective is none of :data:`CLASS_OBJECTIVES`, a path cannot be measured, or all are too short for so
        many chips.
    """
    for name, _ in problem.objective_mix:
        if name not in CLASS_OBJECTIVES:
            raise ValueError(f"objective: a class is searched by {' or '.join(CLASS_OBJECTIVES)} alone, got {name}")
    paths = [one.trajectory for one in problem.scenarios]
    for path in paths:
        check_frame(path)
    check_resolved(max(paths, key=lambda path: path.length_px), problem.chips)


def optimize_class(
    motions: Sequence[Trajectory],
    problem: SearchProblem,
    how: Search,
    *,
    others: Sequence[Trajectory] = (),
    threads: int | None = None,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
    on_found: Callable[[ShutterCode, Found], None] = lambda _code, _found: None,
) -> ClassOptimum:
    """Search the code whose mean decibels over a class of motions are best, and judge it on others.

    Parameters
    ----------
    motions : sequence of Trajectory
        One of unknown direction counts both ways, with half the weight each.
    problem : SearchProblem
        Chips, limits, light, objective; its scenarios, rule and direction are replaced.
    how : Search
        Of the method "anneal".
    others : sequence of Trajectory, optional
        Motions of the same class that the search does not see.
    threads : int, optional
        As many as there are cores when omitted; the code does not depend on it.
    progress : callable, optional
        Called with the finished share, 0..1, and a note.
    on_found : callable, optional
        Called with the code before it is judged.

    Raises
    ------
    ValueError
        If there are no motions, or as of :func:`check_class`.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> walks, unseen = (draw_motions(count, length_px=20.0, rng=rng) for count in (4, 2))
    >>> problem = SearchProblem(chips=8, open_range=(4, 4), objective="mse")
    >>> best = optimize_class(walks, problem, Search(steps=500), others=unseen)
    >>> best.code.open_chips, best.rows[0].mean_db <= min(row.mean_db for row in best.rows if row.within_limits)
    (4, True)
    """
    problem = replace(problem, scenarios=class_scenarios(motions), rule="mean", direction="forward")
    check_class(problem)
    found = search(
        problem, how, threads=threads,
        progress=lambda share, best: progress(_SEARCH_SHARE * share, f"{best.open_chips} open"),
    )  # fmt: skip
    code = replace(found.code, chip_ns=problem.chip_ns)
    on_found(code, found)
    known = {"this code": (code, True)} | {
        one.name: (ShutterCode(one.code.bits, problem.chip_ns), one.within_limits) for one in found.baselines
    }
    codes = [one for one, _ in known.values()]
    seen = per_motion_db(problem, motions, codes)
    progress(0.9, "judging on other motions" if others else "")
    unseen = per_motion_db(problem, others, codes) if others else None
    judged = seen if unseen is None else unseen
    rows = tuple(
        ClassRow(
            name, one, kept, float(seen[:, index].mean()), None if unseen is None else float(unseen[:, index].mean()),
            *_mean_and_error(judged[:, index] - judged[:, 0]),
        )
        for index, (name, (one, kept)) in enumerate(known.items())
    )  # fmt: skip
    progress(1.0, "")
    return ClassOptimum(problem, how, found, rows, len(motions), len(others))


def per_motion_db(problem: SearchProblem, motions: Iterable[Trajectory], codes: Sequence[ShutterCode]) -> FloatArray:
    """Judge codes by a problem's objective on each motion, (motions, codes) dB; ways of unknown direction averaged."""
    paths, chips = list(motions), np.array([code.array for code in codes], dtype=np.int8)
    costs: list[FloatArray] = []
    for start in range(0, len(paths), _AT_ONCE):
        for path_costs in _each_db(problem, paths[start : start + _AT_ONCE], chips):
            costs.append(path_costs)
    return np.array(costs)


def _each_db(problem: SearchProblem, paths: Sequence[Trajectory], chips: NDArray[np.int8]) -> list[FloatArray]:
    ways = [class_scenarios([path]) for path in paths]
    scenarios = tuple(one for both in ways for one in both)
    objective = Objective(
        replace(problem, scenarios=scenarios, rule="mean", direction="forward"), oversampling=16, dtype=np.float64
    )
    rows = objective.each_cost_of(chips)
    ends = np.cumsum([len(both) for both in ways])
    return [np.asarray(piece.mean(axis=0)) for piece in np.split(rows, ends[:-1])]


def _mean_and_error(values: FloatArray) -> tuple[float, float]:
    error = float(values.std(ddof=1)) / math.sqrt(values.size) if values.size > 1 else math.nan
    return float(values.mean()), error
