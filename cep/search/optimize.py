"""Best shutter code for a motion, with its comparison, certificate and bound."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cep.files.code_files import StoredCode, write_code
from cep.optics.camera import LIGHT_RANGE
from cep.optics.code import ShutterCode
from cep.optics.path_limits import check_frame, check_resolved
from cep.proofs.certify.certificate import Certificate, certify
from cep.proofs.measure import CodeMetrics
from cep.search.baselines import Comparison, compare, mean_length_px
from cep.search.bounds import bound
from cep.search.chip_count import ChipCount, choose_chips
from cep.search.code_search import (
    NO_TIME_S,
    SearchOptions,
    SearchResult,
    described_search,
    ended_early,
    search_code,
    searched_problem,
)
from cep.search.cost import FINE, CodeCost
from cep.search.exhaustive.exact import codes_to_count
from cep.search.playable import unplayable
from cep.search.problem import SearchProblem
from cep.search.verdict import Verdict, verdict
from cep.search.ways import WayFinder, check_light
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

_CHOOSING = 0.3  # of the time: the number of chips, where it is to be chosen
_LEAST_LEFT = 0.1  # of the time, for the search after that choice
_SEARCH_SHARE = 0.5  # of the time: then it is measured
_MEASURED_SHARE = 0.95  # of the time: comparing and certifying take the rest
_LESS_LIGHT = (3, 10)  # factors of the light that rivals of the code are searched for
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class OptimizedCode:
    """A searched code and what it is worth.

    Attributes
    ----------
    problem : SearchProblem
    how : SearchOptions
    search : SearchResult
        The search or the proof: cost, moves, seconds, and what ended it.
    comparison : Comparison
        The code first, then what would be used instead of it.
    verdict : Verdict
        Whether to use it, by the restoration that is expected with the problem's camera.
    along : Trajectory or None
        What the certificate is for; None: the unit circle, where only the code's polynomial
        matters.
    certificate : Certificate
        Of the code's smallest MTF.
    figure : str
        Name of what is bounded, with its unit; empty where nothing bounds the objective.
    bound, gap : float or None
        What no code of so much light can exceed, and how far off this one is: 0..1, or dB for the
        noise. Of a code proven on the unit circle, the bound that the proof gives to all codes
        within the limits.
    chip_count : ChipCount or None
        How the number of chips was chosen, where it was not given.
    """

    problem: SearchProblem
    how: SearchOptions
    search: SearchResult
    comparison: Comparison
    verdict: Verdict
    along: Trajectory | None
    certificate: Certificate
    figure: str
    bound: float | None
    gap: float | None
    chip_count: ChipCount | None = None

    @property
    def code(self) -> ShutterCode:
        """The code."""
        return self.comparison[0].code

    @property
    def metrics(self) -> CodeMetrics:
        """Its figures, worst of each over the problem's motions and directions."""
        return self.comparison[0].metrics

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, one sentence each."""
        outcome = self.search
        moves = self.how.moves(searched_problem(self.problem))
        early = [row.name for row in self.comparison if row.stopped_early]
        if not (outcome.stopped == "interrupted" or self.how.method == "exact" or moves):
            early = []  # with a time alone every run differs anyway
        return (
            *ended_early(self.how, outcome.stopped, moves),
            *(
                f"the search of the {name} was stopped early, by the time or Ctrl-C: another run"
                " may give another"
                for name in early
            ),
            *certificate_warnings(self.problem),
            # the search does not know the well: only the verdict does
            *(
                "the code saturates at this light: search with fewer open chips, or give what can"
                " be recorded"
                for exposure in self.verdict.ways
                if exposure.saturates and exposure.code.bits == self.code.bits
            ),
            *(self.chip_count.warnings if self.chip_count else ()),
        )

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``cep optimize --json`` prints them."""
        code = self.code
        outcome = self.search
        return {
            "verdict": self.verdict.sentence,
            "choice": self.verdict.choice,
            "gains_db": self.verdict.gains_db,
            "bits": code.bits,
            "chips": code.chips,
            "open": code.open_chips,
            "duty": code.duty,
            "chip_ns": code.chip_ns,
            "exposure_s": code.duration_ns * 1e-9,
            **self.metrics.to_dict(),
            "objective": outcome.objective,
            "proven": outcome.stopped == "proven",
            "proof": (outcome.proof or {}).get("file"),
            "certificate": self.certificate.to_dict(),
            "bound": self.bound,
            "gap": self.gap,
            "seconds": outcome.seconds,
            "steps": outcome.steps,
            "stopped": outcome.stopped,
            "interrupted": outcome.stopped == "interrupted",
            "baselines": {
                row.name: (
                    {
                        "bits": row.code.bits,
                        "open": row.code.open_chips,
                        "within_limits": row.within_limits,
                        "stopped_early": row.stopped_early,
                    }
                    | row.metrics.to_dict()
                )
                for row in self.comparison[1:]
            },
            **({"other_chips_db": self.chip_count.gains_db} if self.chip_count else {}),
        }

    def save(self, path: Path | str, *, source: Mapping[str, object] | None = None) -> None:
        """Write a ``code.json``, whole or not at all.

        Parameters
        ----------
        path : Path or str
        source : mapping, optional
            Where the motion comes from, for the file's description of the problem.
        """
        about = {**(source or {}), **_described(self.problem, self.how, self.search)}
        write_code(
            path,
            StoredCode(self.code, self.metrics.to_dict(), about, self.certificate.to_dict()),
        )

    def __repr__(self) -> str:
        lines = [
            self.verdict.sentence,
            f"{self.code.bits}: {self.code.open_chips} of {self.code.chips} chips open",
            repr(self.comparison),
        ]
        if self.bound is not None:
            lines.append(
                f"no code with so many open chips has a {self.figure.split(',')[0]} beyond"
                f" {self.bound:.4g}"
            )
        return "\n".join([*lines, *self.warnings])

    def _repr_png_(self) -> bytes:
        from cep.plots import mtf_figure, png_bytes

        path = self.along or self.problem.scenarios[0].trajectory
        return png_bytes(mtf_figure(path, {"open shutter": None, "this code": self.code}))


def optimize(
    problem: SearchProblem | Callable[[int], SearchProblem],
    *,
    method: Literal["anneal", "exact"] = "anneal",
    steps: int | None = None,
    time_s: float | None = None,
    seed: int = 0,
    start: Sequence[ShutterCode] = (),
    along: Trajectory | None = None,
    path_error_px: float = 0.0,
    photographs: Sequence[FloatArray] | None = None,
    threads: int | None = None,
    announce: Callable[[str], None] = lambda _text: None,
    progress: Progress = lambda _share, _note: None,
    on_found: Callable[[StoredCode], None] = lambda _stored: None,
    on_best: Callable[[ShutterCode], None] = lambda _code: None,
) -> OptimizedCode:
    """Search the best code along a problem's motions, certify it, and compare it with others.

    No code of the comparison that keeps the problem's limits is better by its objective. Whether
    to use the code at all is decided by photographs, see :class:`cep.search.verdict.Verdict`.

    Parameters
    ----------
    problem : SearchProblem or callable
        A callable returns the problem with so many chips: as many as pay are chosen, see
        :func:`cep.search.chip_count.choose_chips`. After Ctrl-C within that choice the best of the
        codes to start from and to compare with is returned.
    method, steps, time_s, seed
        As of :class:`SearchOptions`. The choice of the number of chips is within the time.
    start : sequence of ShutterCode
        Codes to start an annealing from, besides those that the code is compared with.
    along : Trajectory, optional
        What the certificate is for; the first scenario's path when omitted. Where the code's
        polynomial alone decides, it is for the unit circle.
    path_error_px : float
        Rms error of the path where it is an estimate: the verdict counts it, the search does not.
    photographs : sequence of (H, W) float ndarrays, linear light, optional
        On which the verdict is measured, as of :func:`cep.search.advise.advise`. With the
        objective "mse" the code is the best on them of those searched for its light, a third and a
        tenth of it, unless a limit or Ctrl-C ended the search.
    threads : int, optional
        As many as there are cores when omitted; the code does not depend on it.
    announce : callable, optional
        As of :func:`cep.search.advise.advise`.
    progress : callable, optional
        Called with the finished share, 0..1, and a note.
    on_found : callable, optional
        Called with the code before it is compared and certified, which may take seconds.
    on_best : callable, optional
        Called with the best code so far while the search goes on, as often as ``progress``.

    Raises
    ------
    ValueError
        If the problem has no motion, its paths cannot be measured or are too short for so many
        chips, even the shortest opening saturates at its light, the method does not solve it, or
        its device cannot play the code.

    Examples
    --------
    >>> problem = SearchProblem.along(Trajectory.straight(16.0), chips=16, open_range=(8, 8))
    >>> best = optimize(problem, method="exact")
    >>> best.code.bits, best.search.stopped
    ('1010111100100100', 'proven')
    """
    how = SearchOptions(method=method, steps=steps, time_s=time_s, seed=seed)
    searched_how = how
    chosen: ChipCount | None = None
    if not isinstance(problem, SearchProblem):
        problem, searched_how, chosen = _with_chips(
            problem,
            how,
            path_error_px=path_error_px,
            threads=threads,
            progress=_part(progress, 0.0, _CHOOSING),
        )
        progress = _part(progress, _CHOOSING, 1.0)
        if chosen.code is not None:  # best by the expected error: a start by any objective
            start = [*start, chosen.code]
    motion = checked_motion(problem, along)
    outcome = _searched(
        problem,
        searched_how,
        start=start,
        threads=threads,
        on_best=on_best,
        progress=_part(progress, 0.0, _SEARCH_SHARE),
    )
    if chosen is not None and chosen.early == "interrupted":
        outcome = replace(outcome, stopped="interrupted")
    stored = _stored(problem, how, outcome)
    on_found(stored)  # what follows takes seconds: a caller can keep the code before
    judgement = _judged(
        problem,
        outcome,
        seed=seed,
        threads=threads,
        path_error_px=path_error_px,
        photographs=photographs,
        announce=announce,
        progress=_part(progress, _SEARCH_SHARE, _MEASURED_SHARE),
    )
    if judgement.user_code is not None and judgement.user_code.code.bits != outcome.code.bits:
        rival = ShutterCode(judgement.user_code.code.bits)
        outcome = replace(outcome, code=rival, objective=_costs_db(problem, [rival])[0])
        stored = _stored(problem, how, outcome)
        on_found(stored)
    progress(_MEASURED_SHARE, "comparing with other codes")
    comparison = compare(problem, stored.code, baselines=outcome.baselines)
    path: Trajectory | None = None  # of a straight motion |P| is certified, whatever its speed
    if not problem.on_circle:
        path = _as_designed(motion, problem.direction)
    certificate = certify(stored.code, path)
    bounded = _bounded(problem, outcome, comparison[0].metrics, straight=path is None)
    progress(1.0, "")
    return OptimizedCode(
        problem,
        how,
        outcome,
        comparison,
        judgement,
        path,
        certificate,
        *bounded,
        chip_count=chosen,
    )


def _with_chips(
    problem: Callable[[int], SearchProblem],
    how: SearchOptions,
    *,
    path_error_px: float,
    threads: int | None,
    progress: Progress,
) -> tuple[SearchProblem, SearchOptions, ChipCount]:
    """Choose the number of chips: the problem with so many, its search in the time left, why."""
    started = time.monotonic()
    chosen = choose_chips(
        problem,
        path_error_px=path_error_px,
        seed=how.seed,
        time_s=_CHOOSING * (how.time_s or math.inf),
        threads=threads,
        progress=progress,
    )
    if chosen.early == "interrupted":
        how = replace(how, time_s=NO_TIME_S)
    elif how.time_s is not None:
        left_s = how.time_s - (time.monotonic() - started)
        how = replace(how, time_s=max(left_s, _LEAST_LEFT * how.time_s))
    return problem(chosen.chips), how, chosen


def _searched(
    problem: SearchProblem,
    how: SearchOptions,
    *,
    start: Sequence[ShutterCode],
    threads: int | None,
    on_best: Callable[[ShutterCode], None],
    progress: Progress,
) -> SearchResult:
    """Search the code, and report the best so far."""
    searched = searched_problem(problem)
    progress(0.0, f"{codes_to_count(searched):.2g} codes" if how.method == "exact" else "")

    def report(share: float, best: ShutterCode) -> None:
        on_best(best)
        progress(share, f"{best.open_chips} open")

    return search_code(
        searched,
        how,
        start=start,
        length_px=mean_length_px(problem),
        threads=threads,
        progress=report,
    )


def _part(progress: Progress, first: float, last: float) -> Progress:
    """Report a part of the work, from one share of the whole to another."""
    return lambda share, note: progress(first + (last - first) * share, note)


def _described(
    problem: SearchProblem, how: SearchOptions, outcome: SearchResult
) -> dict[str, Any]:
    about = described_search(problem, how, steps=outcome.steps, stopped=outcome.stopped)
    return {**about, "proof": outcome.proof}


def _stored(problem: SearchProblem, how: SearchOptions, outcome: SearchResult) -> StoredCode:
    """Return a search's code, which knows no times yet, as a file describes it."""
    code = replace(outcome.code, chip_ns=problem.chip_ns)
    # the limits already keep to the device: its own check has the last word
    if reason := unplayable(code.bits, problem.device, code.chip_ns):
        raise ValueError(reason)
    return StoredCode(code, problem=_described(problem, how, outcome))


def _judged(
    problem: SearchProblem,
    outcome: SearchResult,
    *,
    seed: int,
    threads: int | None,
    path_error_px: float,
    photographs: Sequence[FloatArray] | None,
    announce: Callable[[str], None],
    progress: Progress,
) -> Verdict:
    """Judge the code on photographs, beside codes for less light unless its search ended early."""
    note = "measuring on photographs"
    progress(0.0, note)
    rivals: list[ShutterCode] = []
    if problem.objective == "mse" and outcome.stopped == "steps":
        rivals = _for_less_light(problem, outcome, seed=seed, threads=threads)
    return verdict(
        problem,
        replace(outcome.code, chip_ns=problem.chip_ns),
        rivals=rivals,
        path_error_px=path_error_px,
        photographs=photographs,
        announce=announce,
        progress=lambda share: progress(share, note),
    )


def _for_less_light(
    problem: SearchProblem, outcome: SearchResult, *, seed: int, threads: int | None
) -> list[ShutterCode]:
    """Search codes for less light, which stand more noise, and what is unknown beyond borders.

    Only those that no baseline within the limits beats by the objective.
    """
    finder = WayFinder(problem)
    camera = problem.camera
    starts = [outcome.code]
    # each search starts from the codes for more light: they are near
    for factor in _LESS_LIGHT:
        darker = camera.at(max(camera.photons_full_scale / factor, LIGHT_RANGE[0]))
        starts += finder.codes(darker, starts, seed=seed, threads=threads)
    rivals = starts[1:]
    highest_db = min(
        (baseline.cost_db for baseline in outcome.baselines if baseline.within_limits),
        default=math.inf,
    )
    costs_db = _costs_db(problem, rivals)
    return [
        code
        for code, cost_db in zip(rivals, costs_db, strict=True)
        if cost_db <= highest_db
        and problem.allows(code)
        and not unplayable(code.bits, problem.device, problem.chip_ns)
    ]


def _costs_db(problem: SearchProblem, codes: Sequence[ShutterCode]) -> list[float]:
    """Cost of codes by the objective "mse", dB."""
    if not codes:
        return []
    code_cost = CodeCost(problem, **FINE)
    costs_db = code_cost.cost_of(np.array([code.array for code in codes]))
    return [float(cost_db) for cost_db in costs_db]


def checked_motion(problem: SearchProblem, along: Trajectory | None = None) -> Trajectory:
    """Return the path that a code is certified along.

    Parameters
    ----------
    problem : SearchProblem
    along : Trajectory, optional
        The first scenario's path when omitted.

    Raises
    ------
    ValueError
        If the problem has no motion, its path cannot be measured or is too short for so many
        chips, or even the shortest opening saturates at its light.
    """
    if not problem.scenarios:
        raise ValueError("scenarios: need a motion to compare and certify codes along")
    motion = along or problem.scenarios[0].trajectory
    check_frame(motion)
    check_resolved(motion, problem.chips)
    check_light(problem)
    return motion


def _as_designed(motion: Trajectory, direction: str) -> Trajectory:
    """Return a motion with the direction that a problem counts: "auto" is the motion's own."""
    if direction == "auto":
        return motion
    return replace(motion, direction="known" if direction == "forward" else "unknown")


def certificate_warnings(problem: SearchProblem) -> list[str]:
    """Warn where a certificate does not cover all that the search counted."""
    if problem.response is None and len(problem.scenarios) == 1:
        return []
    return [
        "the certificate is for a shutter that opens at once and on time, along the motion as it"
        " was given"
    ]


def _bounded(
    problem: SearchProblem,
    outcome: SearchResult,
    metrics: CodeMetrics,
    *,
    straight: bool,
) -> tuple[str, float | None, float | None]:
    """Name, bound and gap of the figure that was optimised, None where nothing bounds it."""
    # no bound is known for a mix, the flatness or the expected error
    if problem.objective not in ("min-mtf", "noise"):
        return "", None, None
    if straight and outcome.proof is not None and outcome.stopped == "proven":
        limit = outcome.proof["upper"]  # tighter than the bound: it counted every code
        return "min |P|, chips", limit, max(0.0, _gap(metrics.min_chip, limit))
    limits = bound(problem)
    if problem.objective == "noise":
        return "noise gain, dB", limits.noise, metrics.noise_gain_db - limits.noise
    if straight:
        return "min |P|, chips", limits.min_chip, _gap(metrics.min_chip, limits.min_chip)
    return "min MTF", limits.min_mtf, _gap(metrics.min_mtf, limits.min_mtf)


def _gap(reached: float | None, limit: float) -> float:
    """Return how far a minimum is below its limit, relative to that."""
    assert reached is not None  # along a uniform straight motion |P| is measured
    if limit > 0:
        return 1 - reached / limit
    return 0.0  # with so many open chips every code may have a zero
