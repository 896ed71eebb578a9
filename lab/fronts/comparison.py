"""From a search problem to its front: the codes that no other beats, and the published codes
beside them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cep.codes.published import for_chips
from cep.optics.path_limits import check_frame, check_resolved
from cep.plots.canvas import save
from cep.proofs.measure import HOPELESS_DB
from cep.search.code_search import SearchOptions
from cep.search.exposures import check_light
from cep.search.problem import SearchProblem
from cep.search.verdict import Verdict, verdict
from lab.fronts.front import Front, FrontPoint, knees
from lab.fronts.plot import pareto_figure
from lab.fronts.search import front_points, pareto_front
from motdiff.files.json_files import json_text
from motdiff.files.outputs import new_files, write_text

FRONT_SCHEMA = "cep.front/1"


@dataclass(frozen=True)
class FrontComparison:
    """A front, and the published codes of as many chips.

    Attributes
    ----------
    how : SearchOptions
        Its steps, time and seed.
    front : Front
    published : mapping from a name to FrontPoint
        Whether or not they keep the problem's limits.
    verdict : Verdict or None
        Whether to use one of the front's codes, by the restoration expected with the problem's
        camera; None without a motion.
    single : FrontPoint or None
        The best single exposure within the limits, measured as the front is.
    """

    how: SearchOptions
    front: Front
    published: Mapping[str, FrontPoint]
    verdict: Verdict | None = None
    single: FrontPoint | None = None

    @property
    def knees(self) -> dict[str, FrontPoint]:
        """The best minimum, the least noise, the most light, and the best compromise."""
        return knees(self.front)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know besides the figures, one sentence each."""
        warnings = []
        if self.front.stopped == "interrupted":
            warnings.append("the search was stopped early, this is the front so far")
        elif self.front.stopped == "time" and self.how.steps is not None:
            moves = f"{self.how.steps:,} moves"
            warnings.append(
                f"the limit of {self.how.limit_s:g} s ended the search before its {moves}:"
                " another run may give another front"
            )
        if self.front.sampled:
            warnings.append(
                "along a curved path minima over samples prove nothing: the front is over noise"
                " and light"
            )
        return tuple(warnings)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``python -m lab pareto --json`` prints them."""
        front = self.front
        front_verdict = self.verdict
        return {
            "verdict": None if front_verdict is None else front_verdict.sentence,
            "choice": None if front_verdict is None else front_verdict.choice,
            "gains_db": None if front_verdict is None else front_verdict.gains_db,
            "unit": front.unit,
            "points": _listed(front.points),
            "knees": _named(self.knees),
            "published": _named(self.published),
            "single": None if self.single is None else _figures(self.single),
            "seconds": front.seconds,
            "steps": front.steps,
            "stopped": front.stopped,
            "interrupted": front.stopped == "interrupted",
        }

    def stored(self, source: Mapping[str, object] | None = None) -> dict[str, Any]:
        """Return what a ``front.json`` holds of it.

        Parameters
        ----------
        source : mapping, optional
            ``trajectory`` and ``linear_px`` as they were given.
        """
        problem = self.front.problem
        front = self.front
        return {
            "schema": FRONT_SCHEMA,
            "unit": front.unit,
            "chip_ns": problem.chip_ns,
            "points": _listed(front.points),
            "knees": _named(self.knees),
            "curves": {count: _listed(curve) for count, curve in front.curves.items() if curve},
            "published": _named(self.published),
            "problem": {
                **(source or {}),
                "chips": problem.chips,
                "open_range": problem.open_limits,
                "direction": problem.direction,
                **asdict(problem.runs),
                "camera": problem.camera.to_dict(),
                "steps": front.steps,
                "stopped": front.stopped,
                "seed": self.how.seed,
            },
        }

    def save(
        self, path: Path | str, plot: Path | str, *, source: Mapping[str, object] | None = None
    ) -> None:
        """Write :meth:`stored` as a ``front.json``, and its figure as .png, .pdf or .svg: both or
        neither.
        """
        document = Path(path)
        figure = Path(plot)
        with new_files([document, figure]) as staged:
            write_text(staged[document], json_text(self.stored(source)))
            save(pareto_figure(self.front, self.published), staged[figure])


def pareto(
    problem: SearchProblem,
    *,
    steps: int | None = None,
    time_s: float | None = None,
    seed: int = 0,
    path_error_px: float = 0.0,
    progress: Callable[[float, str], None] | None = None,
    on_checked: Callable[[], None] = lambda: None,
) -> FrontComparison:
    """Search the codes that no other beats in minimum, noise and light, and measure the published
    ones beside them.

    Parameters
    ----------
    problem : SearchProblem
        Its objective does not matter.
    steps, time_s, seed
        As of :class:`cep.search.code_search.SearchOptions`; without moves it goes on for the time.
    path_error_px : float
        Rms error of the path where it is an estimate: the verdict counts it, the search does not.
    progress : callable, optional
        Called with the finished share, 0..1, and a note.
    on_checked : callable, optional
        Called before the work, when paths and limits have been checked.

    Raises
    ------
    ValueError
        If a path cannot be measured or is too short for so many chips, an argument is out of its
        range, or every code found has a zero.
    """
    how = SearchOptions(steps=steps, time_s=time_s, seed=seed)
    for scenario in problem.scenarios:
        check_frame(scenario.trajectory)
        check_resolved(scenario.trajectory, problem.chips)
    if problem.scenarios:
        check_light(problem)
    on_checked()
    front = pareto_front(
        problem,
        rng=np.random.default_rng(seed),
        steps=steps,
        time_s=how.limit_s,
        progress=progress,
    )
    if not front.points:
        raise ValueError(
            "open_range: every code found of so many open chips has a zero, allow others or search"
            " longer"
        )
    entries = for_chips(problem.chips)
    points = front_points(problem, (entry.code for entry in entries))
    published = dict(zip((entry.name for entry in entries), points, strict=True))
    if not problem.scenarios:
        return FrontComparison(how, front, published)
    front_verdict = verdict(
        problem,
        *(point.code for point in front.points),
        path_error_px=path_error_px,
        photographs=(),  # some twenty codes, by the model
    )
    single = front_verdict.best("snapshot")
    beside = [] if single is None else front_points(problem, [single.code])
    return FrontComparison(how, front, published, front_verdict, next(iter(beside), None))


def _listed(points: Iterable[FrontPoint]) -> list[dict[str, Any]]:
    return [_figures(point) for point in points]


def _named(points: Mapping[str, FrontPoint]) -> dict[str, dict[str, Any]]:
    return {name: _figures(point) for name, point in points.items()}


def _figures(point: FrontPoint) -> dict[str, Any]:
    """Return a point as JSON has it; the noise of a code with a zero is null."""
    code = point.code
    noise_db = point.noise_db if point.noise_db <= HOPELESS_DB else math.inf
    return {
        "bits": code.bits,
        "open": point.open_chips,
        "duty": code.duty,
        "minimum": point.minimum,
        "noise_gain_db": noise_db,
        "dnf_db": noise_db + 20 * math.log10(code.duty),
        "mse_db": point.mse_db,
    }
