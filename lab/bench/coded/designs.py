"""Code designs of the table, and the motion prior that each one has: none, the length, an
estimate, or the truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cep.codes.published import published
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.search.baselines import best_snapshot, best_strobe, dnf_problem, median_random_code
from cep.search.code_search import SearchOptions, search_code
from cep.search.cost import CodeCost
from cep.search.problem import Scenario, SearchProblem
from lab.class_code.motions import class_scenarios
from lab.trainings.dce.shipped_code import DCE_CODE
from motdiff.trajectory import Trajectory


@dataclass(frozen=True)
class Design:
    """A way to choose a code.

    Parameters
    ----------
    label : str
        For people.
    path : str
        Motion prior: "none"; "class", other motions of the protocol's kind; "length", the true
        one; "ours" or "parametric", an estimate from an open photo; a kind of
        :mod:`lab.bench.coded.calibrations`, an estimate from other photos; "parametric oracle",
        the best quadratic path for the truth; "true".
    compared : bool
        Whether a table has its differences from every other row.
    only_named : bool
        Whether it is measured only where it is asked for: its calibrations take long, or few need
        it.
    """

    label: str
    path: str
    compared: bool = False
    only_named: bool = False

    @property
    def uses_truth(self) -> bool:
        """Whether its prior is the true motion, which no camera has: such rows are limits, not
        rivals.
        """
        return self.path in ("true", "parametric oracle")


DESIGNS: dict[str, Design] = {
    "open": Design("w/o CEP (open shutter)", "none"),
    "snapshot": Design("snapshot, best short exposure", "ours"),
    "strobe": Design("best strobe", "ours"),
    "random": Design("random code, median of 15", "ours"),
    "raskar-52": Design("Raskar-52, published", "none"),
    "dnf": Design("DNF (length known, direction ignored)", "length"),
    "dce": Design("DCE (one learned code)", "none"),
    "class-snapshot": Design(
        "snapshot, best for such motions (no calibration)", "class", only_named=True
    ),
    "class": Design("class code (mean over such motions, no calibration)", "class", compared=True),
    "parametric": Design("parametric (estimated quadratic path)", "parametric"),
    "parametric-oracle": Design("parametric oracle (best quadratic path)", "parametric oracle"),
    "one-way": Design("ours, one way (as the paper)", "ours"),
    "posterior": Design("ours, both ways, all alternatives", "ours"),
    "both-ways": Design("ours, both ways", "ours", compared=True),
    "calibrated-2": Design(
        "ours, calibrated by open + one coded", "open + one", compared=True, only_named=True
    ),
    "calibrated-4": Design(
        "ours, calibrated by open + three coded", "open + three", compared=True, only_named=True
    ),
    "calibrated-point": Design(
        "ours, calibrated by a point light", "point", compared=True, only_named=True
    ),
    "oracle": Design("oracle (true path)", "true"),
}
"""Rows of the table, in its order."""
USUAL_DESIGNS = tuple(name for name, design in DESIGNS.items() if not design.only_named)
"""Those that are measured where none is named."""


def design_of(name: str) -> Design:
    """Return the design of a row: one of :data:`DESIGNS`, or a code of the user's own, which has
    no motion prior.
    """
    return DESIGNS.get(name) or Design(name, "none", compared=True)


_RANDOM_CODES = 15


@dataclass(frozen=True)
class MotionPrior:
    """Motion prior of a design: paths with weights, or only the length, px."""

    paths: tuple[Trajectory, ...] = ()
    weights: tuple[float, ...] = ()
    length_px: float | None = None


def design_code(
    design: str,
    prior: MotionPrior,
    *,
    chips: int,
    open_range: tuple[int, int],
    objective: str,
    camera: Camera,
    steps: int,
    rng: np.random.Generator,
) -> ShutterCode:
    """Choose a code.

    Parameters
    ----------
    design : str
        One of :data:`DESIGNS`.
    prior : MotionPrior
    chips : int
    open_range : (int, int)
        Fewest and most open chips; snapshots and strobes need not keep it, published codes have
        their own.
    objective : str
    camera : Camera
        Camera of the objective.
    steps : int
        Moves of a search, the same for all that search.
    rng : numpy Generator

    Raises
    ------
    ValueError
        If the design is unknown.
    """
    if design == "open":
        return ShutterCode("1" * chips)
    if design == "dce":
        return DCE_CODE
    if design == "dnf":
        assert prior.length_px is not None
        return _searched(
            dnf_problem(prior.length_px, chips, open_range=open_range), steps=steps, rng=rng
        )
    if design == "raskar-52":
        return published(design).code
    if design not in DESIGNS:
        raise ValueError(f"design: must be one of {', '.join(DESIGNS)}, got {design!r}")
    problem = _problem(
        design, prior, chips=chips, open_range=open_range, objective=objective, camera=camera
    )
    if design in ("snapshot", "class-snapshot", "strobe"):
        best = (best_strobe if design == "strobe" else best_snapshot)(
            CodeCost(problem, oversampling=8)
        )
        if best is None:
            raise ValueError(f"chips: a strobe needs at least 3, got {chips}")
        return best
    if design == "random":
        return median_random_code(CodeCost(problem, oversampling=8), _RANDOM_CODES, rng=rng)
    return _searched(problem, steps=steps, rng=rng)


def _searched(problem: SearchProblem, *, steps: int, rng: np.random.Generator) -> ShutterCode:
    # on one thread: other cells run beside
    result = search_code(problem, SearchOptions(steps=steps), rng=rng, threads=1)
    if result.stopped == "interrupted":
        # an interrupted search had a smaller budget than the others, and cells are cached
        raise KeyboardInterrupt
    return result.code


def _problem(
    design: str,
    prior: MotionPrior,
    *,
    chips: int,
    open_range: tuple[int, int],
    objective: str,
    camera: Camera,
) -> SearchProblem:
    path_count = len(prior.paths) if design == "posterior" else 1
    one_way = design == "one-way" or DESIGNS[design].path == "class"
    scenarios = (
        class_scenarios(prior.paths)
        if DESIGNS[design].path == "class"
        else tuple(
            Scenario(path, weight=weight)
            for path, weight in zip(
                prior.paths[:path_count], prior.weights[:path_count], strict=True
            )
            if weight > 0
        )
    )
    return SearchProblem.along(
        *scenarios,
        chips=chips,
        open_range=open_range,
        objective=objective,
        # coded photos tell the direction: such an estimate has a known one
        direction="forward" if one_way or DESIGNS[design].uses_truth else "auto",
        rule="mean" if design == "posterior" or DESIGNS[design].path == "class" else "worst",
        camera=camera,
    )
