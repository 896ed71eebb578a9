"""From a search problem to a code and what it is worth: the search or proof, baselines, certificate, bound."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from cep.io.files import StoredCode, plain
from cep.optics.code import ShutterCode
from cep.proofs.measure import CodeMetrics
from cep.search.problem import SearchProblem
from motdiff.trajectory import Trajectory

if TYPE_CHECKING:
    from cep.jobs.cells import Figure
    from cep.search.recipe import Baseline, Found
    from cep.workflows.compare import BaselineRow

__all__ = [
    "STANDARD_TIME_S",
    "Appraisal",
    "Search",
    "appraise",
    "code_from_figures",
    "optimize_motion",
    "report",
    "search",
]

STANDARD_TIME_S = 60.0
"""Limit of an annealing that is given neither moves nor a time, seconds."""

_RELAXED = 128  # chips to which the relaxation takes seconds
_ROUNDED = 16  # codes drawn from it


@dataclass(frozen=True, kw_only=True)
class Search:
    """How a code is searched.

    Attributes
    ----------
    method : {"anneal", "exact"}
    effort : {"quick", "sdp"}
        Of the bound; "sdp" also draws codes from the relaxation to start from.
    steps : int, optional
        Moves of an annealing. The same seed and moves give the same code, unless the time ends the search.
    time_s : float, optional
        Limit of an annealing, seconds; a proof runs to its end. With a time alone the annealing goes on for it,
        however many moves that are; without moves or a time it makes as many as suit the problem, for
        :data:`STANDARD_TIME_S` at most.
    seed : int

    Raises
    ------
    ValueError
        If the time is not above 0, or moves or a time are given for a proof.
    """

    method: Literal["anneal", "exact"] = "anneal"
    effort: Literal["quick", "sdp"] = "quick"
    steps: int | None = None
    time_s: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.time_s is not None and not self.time_s > 0:
            raise ValueError(f"time_s: must be above 0 seconds, got {self.time_s}")
        for name in ("steps", "time_s"):
            if self.method == "exact" and getattr(self, name) is not None:
                raise ValueError(f"{name}: not valid with method='exact', which judges every code there is")

    @property
    def limit_s(self) -> float:
        """Limit of an annealing, seconds; infinite where only its moves are given."""
        if self.time_s is not None:
            return self.time_s
        return STANDARD_TIME_S if self.steps is None else math.inf

    def moves(self, problem: SearchProblem) -> int | None:
        """Say how many moves an annealing makes; None where the time alone ends it."""
        from cep.search.annealing.anneal import standard_moves

        return standard_moves(problem) if self.steps is None and self.time_s is None else self.steps


@dataclass(frozen=True)
class Appraisal:
    """What a code is worth.

    Attributes
    ----------
    ours : BaselineRow
        The code, worst of each figure over the problem's motions.
    others : tuple of BaselineRow
        What would be used instead of it.
    certificate : dict
        Of the code's smallest MTF.
    figure : str
        Name of what is bounded, with its unit; empty where nothing bounds the objective.
    bound, gap : float or None
        What no code of so much light can exceed, and how far off this one is: 0..1, or dB for the noise.
    """

    ours: BaselineRow
    others: tuple[BaselineRow, ...]
    certificate: dict[str, Any]
    figure: str
    bound: float | None
    gap: float | None


def search(
    problem: SearchProblem,
    how: Search,
    *,
    length_px: float | None = None,
    threads: int | None = None,
    progress: Callable[[float, ShutterCode], None] | None = None,
) -> Found:
    """Search a code, or count all codes for the best.

    Parameters
    ----------
    problem : SearchProblem
    how : Search
    length_px : float, optional
        Of the path, for the length-only code among the baselines; of the problem's when omitted.
    threads : int, optional
        As many as there are cores when omitted; the code does not depend on it.
    progress : callable, optional
        Called with the fraction done and the best code so far.

    Returns
    -------
    Found
        No baseline within the limits has a lower cost. Along a path a proof is over the band's samples, though: it
        stands, whatever a baseline is worth between them.

    Raises
    ------
    ValueError
        If the problem is not one that the method solves.
    """
    from cep.search.recipe import search_code

    if how.method == "exact":
        return _proven(problem, how, length_px=length_px, threads=threads, progress=progress)
    return search_code(
        problem,
        rng=np.random.default_rng(how.seed),
        steps=how.moves(problem),
        time_s=how.limit_s,
        start=_rounded(problem, how.seed) if how.effort == "sdp" else (),
        length_px=length_px,
        progress=progress,
        threads=threads,
    )


def _proven(
    problem: SearchProblem,
    how: Search,
    *,
    length_px: float | None,
    threads: int | None,
    progress: Callable[[float, ShutterCode], None] | None,
) -> Found:
    """Count all codes; where Ctrl-C stops that, a baseline may be the best yet."""
    from cep.search.exhaustive.exact import codes_to_count, exact
    from cep.search.recipe import Found, baselines_so_far, best_of, judge_of

    proven = exact(problem, threads=threads, progress=progress)
    judge = judge_of(problem)
    rng = np.random.default_rng(how.seed)
    known, _ = baselines_so_far(problem, judge, rng=rng, length_px=length_px, time_s=how.limit_s, threads=threads)
    code, cost = proven.code, judge.exact_cost(proven.code)
    if not proven.proven:
        code, cost = best_of(code, cost, known)
    return Found(
        code, cost, codes_to_count(problem), proven.seconds, "proven" if proven.proven else "interrupted", known,
        proven.proof.to_dict(),
    )  # fmt: skip


def appraise(
    problem: SearchProblem,
    code: ShutterCode,
    *,
    along: Trajectory | None,
    baselines: Iterable[Baseline],
    effort: Literal["quick", "sdp"] = "quick",
) -> Appraisal:
    """Compare a code with what would be used instead, certify its minimum, and hold it against a bound.

    Parameters
    ----------
    problem : SearchProblem
        To measure on.
    code : ShutterCode
    along : Trajectory or None
        What the certificate is for; None: the unit circle, where only the code's polynomial matters.
    baselines : iterable of Baseline
        What it is compared with: as its search returned them, or :func:`cep.search.recipe.baselines`.
    effort : {"quick", "sdp"}
    """
    from cep.proofs.certify.certificate import certify
    from cep.workflows.compare import compare

    ours, *others = compare(problem, code, baselines=baselines)
    certificate = certify(code, along).to_dict()
    return Appraisal(
        ours, tuple(others), certificate, *_bounded(problem, ours.metrics, straight=along is None, effort=effort)
    )


def report(found: Found, appraisal: Appraisal) -> dict[str, Any]:
    """Put together what ``cep optimize --json`` says of a code."""
    code = appraisal.ours.code
    return {
        "bits": code.bits,
        "chips": code.chips,
        "open": code.open_chips,
        "duty": code.duty,
        "chip_ns": code.chip_ns,
        **appraisal.ours.metrics.to_dict(),
        "objective": found.objective,
        "proven": found.stopped == "proven",
        "certificate": appraisal.certificate,
        "bound": appraisal.bound,
        "gap": appraisal.gap,
        "seconds": found.seconds,
        "steps": found.steps,
        "stopped": found.stopped,
        "interrupted": found.stopped == "interrupted",
        "baselines": {
            row.name: {
                "bits": row.code.bits,
                "open": row.code.open_chips,
                "within_limits": row.within_limits,
                "stopped_early": row.stopped_early,
            }
            | row.metrics.to_dict()
            for row in appraisal.others
        },
    }


def optimize_motion(
    *, problem: SearchProblem, searched: SearchProblem, along: Trajectory | None, chip_ns: int, how: Search
) -> dict[str, str]:
    """Search and appraise a code on one thread: the work of a cell, see :mod:`cep.jobs.engine`.

    Parameters
    ----------
    problem : SearchProblem
        To measure on.
    searched : SearchProblem
        To search: the unit circle where only the code's polynomial matters.
    along : Trajectory or None
        As of :func:`appraise`.
    chip_ns : int
    how : Search

    Returns
    -------
    dict of texts
        For :func:`code_from_figures`.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C ended the search: half a search must not count as a finished one.
    """
    from cep.search.recipe import mean_length_px

    found = search(searched, how, length_px=mean_length_px(problem), threads=1)
    if found.stopped == "interrupted":
        raise KeyboardInterrupt
    code = replace(found.code, chip_ns=chip_ns)
    appraisal = appraise(problem, code, along=along, baselines=found.baselines, effort=how.effort)
    parts = {
        "report": report(found, appraisal),
        "metrics": appraisal.ours.metrics.to_dict(),
        "proof": found.proof,
    }
    return {name: json.dumps(plain(part), allow_nan=False) for name, part in parts.items()}


def code_from_figures(figures: Mapping[str, Figure], described: Mapping[str, Any]) -> tuple[dict[str, Any], StoredCode]:
    """Return the report of a code, and what its file holds, from what :func:`optimize_motion` returned.

    Parameters
    ----------
    figures : mapping
    described : mapping
        What the file says of the problem; the search's steps and proof are added.
    """
    told, metrics, proof = (json.loads(str(figures[part])) for part in ("report", "metrics", "proof"))
    problem = {**described, "steps": told["steps"], "stopped": told["stopped"], "proof": proof}
    return told, StoredCode(ShutterCode(told["bits"], told["chip_ns"]), metrics, problem, told["certificate"])


def _rounded(problem: SearchProblem, seed: int) -> list[ShutterCode]:
    """Codes drawn from the relaxation along a path; on the unit circle it knows nothing of the code."""
    from cep.search.bounding.bounds import relaxed_minimum
    from cep.search.bounding.relaxation import rounded_codes

    low, high = problem.open_limits
    k = min(max((low + high) // 2, 2), problem.chips - 1)
    if not problem.scenarios or problem.response is not None or not low <= k <= high or problem.chips > _RELAXED:
        return []
    try:
        codes = rounded_codes(relaxed_minimum(problem, k), _ROUNDED, rng=np.random.default_rng([seed, 3]))
    except ValueError:  # no solver found an optimum: the search does without
        return []
    return [ShutterCode.from_array(code) for code in codes]


def _bounded(
    problem: SearchProblem, metrics: CodeMetrics, *, straight: bool, effort: Literal["quick", "sdp"]
) -> tuple[str, float | None, float | None]:
    """Name, bound and gap of the figure that was optimised, None where nothing bounds it."""
    from cep.search.bounding.bounds import bound

    if problem.objective not in ("min-mtf", "noise"):
        return "", None, None
    limits = bound(problem, effort=effort)
    if problem.objective == "noise":
        return "noise gain, dB", limits.noise, metrics.noise_gain_db - limits.noise
    limit, reached = (limits.min_chip, metrics.min_chip) if straight else (limits.min_mtf, metrics.min_mtf)
    assert reached is not None  # along a uniform straight motion |P| is measured
    # with so many open chips every code may have a zero: then the limit is 0, and reached
    return "min |P|, chips" if straight else "min MTF", limit, 1 - reached / limit if limit > 0 else 0.0
