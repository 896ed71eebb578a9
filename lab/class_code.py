"""One shutter code for a class of motions, by its mean decibels over them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cep.codes.published import PUBLISHED
from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_frame, check_resolved
from cep.search.limits import RunLimits
from cep.search.objective import Objective
from cep.search.objectives import OBJECTIVES
from cep.search.playable import unplayable
from cep.search.problem import SearchProblem
from cep.search.recipe import Found
from cep.search.scenarios import class_scenarios
from cep.search.search import Search, described_search, ended_early, search
from motdiff.files.gyro_tables import read_gyro
from motdiff.files.trajectories import read_motion
from motdiff.gyro import GyroTrace
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

DRAWN = 100
OTHERS = 300
"""Motions drawn to search a code on, and others to judge it by: docs/decisions/search.md."""

WALKS = "walks"
"""Class of simulated hand shakes; another class is named by a gyro recording."""

_MOTION = "trajectory.json"
_LENGTH_PX = 60.0
_PUBLISHED = "published: "
_STANDARD = "raskar-52"  # compared with where no published code has as many chips
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
        A published one may have another number of chips, with the exposure as long.
    within_limits : bool
    mean_db : float
        Mean of the objective's decibels over the motions of the search, lower is better.
    others_db : float or None
        The same over motions that the search has not seen; None where there are none.
    behind_db, behind_error_db : float
        Excess over this code's decibels in the mean over the motions not seen, or where there are
        none over all, and its standard error.
    """

    name: str
    code: ShutterCode
    within_limits: bool
    mean_db: float
    others_db: float | None
    behind_db: float
    behind_error_db: float

    @property
    def label(self) -> str:
        """The name, and whether the code breaks the limits, for tables."""
        return self.name if self.within_limits else f"{self.name} (outside the limits)"

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON."""
        return {
            "bits": self.code.bits,
            "chips": self.code.chips,
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
    def unsearched(self) -> bool:
        """Whether the time or Ctrl-C ended the search before its first move."""
        return self.found.steps == 0 and self.found.stopped in ("time", "interrupted")

    @property
    def verdict(self) -> str:
        """What to do, and what it gains over the best snapshot and over the best published code:
        one or two sentences.

        Nothing is recommended that loses to a row of the table.
        """
        code = self.code
        rivals = self.rows[1:]
        if self.unsearched:
            ending_clause = (
                "Ctrl-C ended it"
                if self.found.stopped == "interrupted"
                else f"{self.how.limit_s:g} s passed"
            )
            return (
                f"Nothing was searched: {ending_clause} before the first move. This code is only"
                " the best of those that it is compared with; give the search more time by --time,"
                " or moves by --steps."
            )
        where = f"in the mean over {self.others or self.motions} motions"
        where += " that the search has not seen" if self.others else ""
        gains = [
            f"{_amount(best)} better than {_in_words(best.code, best.name)}"
            for kind in ("best snapshot", _PUBLISHED)
            for best in sorted(
                (row for row in rivals if row.name.startswith(kind)), key=lambda row: row.behind_db
            )[:1]
            if best.behind_db > 0
        ]
        better = min(rivals, key=lambda row: row.behind_db, default=None)
        if better is not None and better.behind_db < 0:
            gain_text = f": {' and '.join(gains)}" if gains else ""
            return (
                f"Use {_in_words(better.code, better.name)} instead if the limits can be loosened:"
                f" it is {_amount(better)} better than this code, {where}. Within the limits use"
                f" this code{gain_text}."
            )
        clause = f": {' and '.join(gains)}, {where}" if gains else ""
        if code.pulses == 1:
            return (
                f"A short exposure is best, {_in_words(code, 'one opening')}{clause}. No code that"
                " was found beats it."
            )
        return f"Use this code{clause}."

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know besides the figures, one sentence each."""
        few = (
            [
                f"{self.motions} motions are few for a class, the code may suit no others; {_FEW}"
                " or more are better"
            ]
            if self.motions < _FEW
            else []
        )
        return (*ended_early(self.how, self.found.stopped, self.how.moves(self.problem)), *few)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``python -m lab design-class --json`` prints them."""
        code = self.code
        result = self.found
        class_row = self.rows[0]
        return {
            "verdict": self.verdict,
            "bits": code.bits,
            "chips": code.chips,
            "open": code.open_chips,
            "duty": code.duty,
            "chip_ns": code.chip_ns,
            "objective": self.problem.objective,
            "motions": self.motions,
            "other_motions": self.others,
            "mean_db": class_row.mean_db,
            "others_db": class_row.others_db,
            "seconds": result.seconds,
            "steps": result.steps,
            "stopped": result.stopped,
            "interrupted": result.stopped == "interrupted",
            "baselines": {row.name: row.to_dict() for row in self.rows[1:]},
        }

    def save(self, path: Path | str, *, source: Mapping[str, object] | None = None) -> None:
        """Write a ``code.json``, whole or not at all.

        It has no certificate, which is for a single motion.

        Parameters
        ----------
        path : Path or str
        source : mapping, optional
            Where the motions come from.
        """
        about = {
            **(source or {}),
            **described_search(
                self.problem, self.how, steps=self.found.steps, stopped=self.found.stopped
            ),
            "proof": self.found.proof,
            "motions": self.motions,
            "mean_db": self.rows[0].mean_db,
            "others_db": self.rows[0].others_db,
        }
        write_code(path, StoredCode(self.code, problem=about))


@dataclass(frozen=True)
class MotionClass:
    """Motions of a class.

    Attributes
    ----------
    searched, others : tuple of Trajectory
        Motions to search a code on, and others of the same class to judge it by.
    source : mapping
        Where they come from, for the code file.
    warnings : tuple of str
        Of the recording.
    """

    searched: tuple[Trajectory, ...]
    others: tuple[Trajectory, ...]
    source: Mapping[str, object]
    warnings: tuple[str, ...] = ()


def motion_class(
    kind: str,
    *,
    length_px: float | None = None,
    count: int | None = None,
    exposure_s: float,
    seed: int = 0,
) -> MotionClass:
    """Draw the motions of a class, or read those of a folder.

    Parameters
    ----------
    kind : str
        :data:`WALKS`; a gyro recording, whose z axis is the line of sight and whose x and y may
        point anywhere; or a folder with motions, as ``cep calibrate FOLDER`` writes it.
    length_px, count : optional
        Of the drawn motions; 60 px and :data:`DRAWN` when omitted.
    exposure_s : float
        Length of each shake that is cut from a recording.
    seed : int

    Raises
    ------
    ValueError
        If there are no motions, one cannot be read, or the length is out of range.
    """
    if Path(kind).is_dir():
        if length_px is not None or count is not None:
            option = "--motions" if length_px is None else "--length"
            raise ValueError(f"{option}: not valid with a folder, whose motions are all taken")
        read = tuple(read_motion(path).trajectory for path in motions_in(kind).values())
        return MotionClass(read, (), {"folder": kind, "class": None})
    length_px = _LENGTH_PX if length_px is None else length_px
    if not 1 <= length_px <= 1000:
        raise ValueError(f"--length: must lie within 1..1000 px, got {length_px:g}")
    if kind != WALKS and not Path(kind).exists():
        raise ValueError(
            f"CLASS: must be {WALKS}, a gyro recording or a folder, and there is no file {kind}"
        )
    gyro = None if kind == WALKS else read_gyro(kind)
    motions = []
    for number, size in enumerate((count or DRAWN, OTHERS)):
        rng = np.random.default_rng([seed, 4, number])
        try:
            motions.append(
                draw_motions(size, length_px=length_px, rng=rng, gyro=gyro, exposure_s=exposure_s)
            )
        except ValueError as error:  # only a recording's
            raise ValueError(
                f"{kind}: {str(error).partition(': ')[2]}; --exposure says how long a shake is"
            ) from None
    source = {"folder": None, "class": {"kind": kind, "length_px": length_px}}
    return MotionClass(motions[0], motions[1], source, () if gyro is None else gyro.warnings)


def motions_in(folder: Path | str) -> dict[str, Path]:
    """List the motions that ``cep calibrate FOLDER`` wrote, by the names of their folders.

    Raises
    ------
    ValueError
        If the folder holds no motions.
    """
    root = Path(folder)
    motions = {
        path.parent.name: path for path in sorted(root.glob(f"*/{_MOTION}")) if not path.is_dir()
    }
    if not motions:
        single = root / _MOTION
        hint = (
            f"; for a single motion: cep optimize --trajectory {single}"
            if single.is_file()
            else ""
        )
        raise ValueError(
            f"{root}: holds no */{_MOTION}, as cep calibrate FOLDER writes them{hint}"
        )
    return motions


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
        walks = [boracchi_foi(rng, max_length_px=length_px) for _ in range(count)]
    else:
        assert exposure_s is not None
        walks = [
            random_gyro_motion(gyro, rng, exposure_s=exposure_s, extent_px=length_px)
            for _ in range(count)
        ]
    return tuple(path.thinned(_TOLERANCE_PX) for path in walks)


def check_class(problem: SearchProblem) -> None:
    """Refuse a problem that has no meaningful mean over a class of motions.

    Raises
    ------
    ValueError
        If the objective's mean says nothing, a path cannot be measured, or all are too short for
        so many chips.
    """
    for criterion, _ in problem.criteria:
        if not criterion.averages:
            names = [name for name, objective in OBJECTIVES.items() if objective.averages]
            raise ValueError(
                f"objective: a class is searched by {' or '.join(names)} alone, got"
                f" {criterion.name}"
            )
    paths = [scenario.trajectory for scenario in problem.scenarios]
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
    on_found: Callable[[StoredCode], None] = lambda _stored: None,
) -> ClassOptimum:
    """Search the code whose mean decibels over a class of motions are best, and judge it on
    others.

    Where a code of the comparison that keeps the limits is better on the others, that one is
    returned.

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
        If there are no motions, the device cannot play the code, or as of :func:`check_class`.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> walks, unseen = (draw_motions(count, length_px=20.0, rng=rng) for count in (4, 2))
    >>> problem = SearchProblem.along(chips=8, open_range=(4, 4), objective="mse")
    >>> best = optimize_class(walks, problem, Search(steps=500), others=unseen)
    >>> others_db = [row.others_db for row in best.rows if row.within_limits]
    >>> best.code.open_chips, best.rows[0].others_db <= min(others_db)
    (4, True)
    """
    problem = replace(
        problem, scenarios=class_scenarios(motions), rule="mean", direction="forward"
    )
    check_class(problem)
    result = search(
        problem,
        how,
        threads=threads,
        progress=lambda share, best: progress(_SEARCH_SHARE * share, f"{best.open_chips} open"),
    )
    code = replace(result.code, chip_ns=problem.chip_ns)
    if reason := unplayable(code.bits, problem.device, code.chip_ns):
        raise ValueError(reason)
    on_found(
        StoredCode(
            code,
            problem=described_search(problem, how, steps=result.steps, stopped=result.stopped),
        )
    )
    rivals = {
        baseline.name: (ShutterCode(baseline.code.bits, problem.chip_ns), baseline.within_limits)
        for baseline in result.baselines
    }
    if problem.response is None and not any(name.startswith(_PUBLISHED) for name in rivals):
        rivals[_PUBLISHED + _STANDARD] = (_standard_code(problem), False)
    codes = [code, *(rival for rival, _ in rivals.values())]
    class_figures = _judged(problem, motions, codes)
    progress(0.9, "judging on other motions" if others else "")
    figures = _judged(problem, others, codes) if others else class_figures
    means = figures.mean(axis=0)
    allowed = [0, *(index for index, (_, within) in enumerate(rivals.values(), 1) if within)]
    best = min(allowed, key=means.__getitem__)
    order = [best, *range(1, len(codes))]
    names = ["this code", *rivals]
    rows = tuple(
        ClassRow(
            names[place],
            codes[index],
            place == 0 or rivals[names[place]][1],
            float(class_figures[:, index].mean()),
            float(means[index]) if others else None,
            *_mean_and_error(figures[:, index] - figures[:, best]),
        )
        for place, index in enumerate(order)
    )
    progress(1.0, "")
    return ClassOptimum(problem, how, result, rows, len(motions), len(others))


def per_motion_db(
    problem: SearchProblem, motions: Iterable[Trajectory], codes: Sequence[ShutterCode]
) -> FloatArray:
    """Judge codes by a problem's objective on each motion, (motions, codes) dB; ways of unknown
    direction averaged.
    """
    paths = list(motions)
    chips = np.array([code.array for code in codes], dtype=np.int8)
    costs: list[FloatArray] = []
    for start in range(0, len(paths), _AT_ONCE):
        for path_costs in _each_db(problem, paths[start : start + _AT_ONCE], chips):
            costs.append(path_costs)
    return np.array(costs)


def _judged(
    problem: SearchProblem, motions: Sequence[Trajectory], codes: Sequence[ShutterCode]
) -> FloatArray:
    """As :func:`per_motion_db`, of codes of any number of chips, all as long as the exposure."""
    costs = np.empty((len(motions), len(codes)))
    for chips in {code.chips for code in codes}:
        places = [index for index, code in enumerate(codes) if code.chips == chips]
        same = problem if chips == problem.chips else _with_chips(problem, chips)
        costs[:, places] = per_motion_db(same, motions, [codes[index] for index in places])
    return costs


def _with_chips(problem: SearchProblem, chips: int) -> SearchProblem:
    return replace(
        problem,
        chips=chips,
        open_range=None,
        runs=RunLimits(),
        scenarios=(),
        response=None,
        chip_ns=max(1, round(problem.chip_ns * problem.chips / chips)),
    )


def _standard_code(problem: SearchProblem) -> ShutterCode:
    code = PUBLISHED[_STANDARD]
    return replace(code, chip_ns=_with_chips(problem, code.chips).chip_ns)


def _amount(row: ClassRow) -> str:
    return f"{abs(row.behind_db):.2f} dB (standard error {row.behind_error_db:.2f})"


def _in_words(code: ShutterCode, name: str) -> str:
    if name.startswith(_PUBLISHED):
        return f"the published code {name.removeprefix(_PUBLISHED)}"
    if name == "random code, median":
        return "a random code"
    light = f"open for {code.open_chips} of {code.chips} chips"
    return f"{name if name.startswith('one') else f'the {name}'} ({light})"


def _each_db(
    problem: SearchProblem, paths: Sequence[Trajectory], chips: NDArray[np.int8]
) -> list[FloatArray]:
    scenario_lists = [class_scenarios([path]) for path in paths]
    scenarios = tuple(scenario for scenario_list in scenario_lists for scenario in scenario_list)
    objective = Objective(
        replace(problem, scenarios=scenarios, rule="mean", direction="forward"),
        oversampling=16,
        dtype=np.float64,
    )
    rows = objective.each_cost_of(chips)
    bounds = np.cumsum([len(scenario_list) for scenario_list in scenario_lists])
    return [np.asarray(piece.mean(axis=0)) for piece in np.split(rows, bounds[:-1])]


def _mean_and_error(values: FloatArray) -> tuple[float, float]:
    error = float(values.std(ddof=1)) / math.sqrt(values.size) if values.size > 1 else math.nan
    return float(values.mean()), error
