"""Optimised code: what it is worth beside other codes, its certificate and bound, and its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode
from cep.proofs.certify.certificate import Certificate, certify
from cep.proofs.measure import CodeMetrics, PairMetrics
from cep.search.baselines import Comparison, compare
from cep.search.bounds import bound
from cep.search.code_search import (
    SearchOptions,
    described_search,
    ended_early,
    searched_problem,
)
from cep.search.pairs import compare_pairs
from cep.search.problem import SearchProblem
from cep.search.search_result import SearchResult
from cep.search.verdict import Verdict
from motdiff.trajectory import Trajectory


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
    certificate : Certificate or None
        Of the code's smallest MTF; None of a code and its complement in two cameras.
    figure : str
        Name of what is bounded, with its unit; empty where nothing bounds the objective.
    bound, gap : float or None
        What no code of so much light can exceed, and how far off this one is: 0..1, or dB for the
        noise. Of a code proven on the unit circle, the bound that the proof gives to all codes
        within the limits.
    """

    problem: SearchProblem
    how: SearchOptions
    search: SearchResult
    comparison: Comparison
    verdict: Verdict
    along: Trajectory | None
    certificate: Certificate | None
    figure: str
    bound: float | None
    gap: float | None

    @property
    def code(self) -> ShutterCode:
        """The code."""
        return self.comparison[0].code

    @property
    def complement(self) -> ShutterCode | None:
        """The code of the second camera, if there is one."""
        return self.code.complement() if self.problem.frames == 2 else None

    @property
    def metrics(self) -> CodeMetrics | PairMetrics:
        """Its figures, worst of each over the problem's motions and directions."""
        return self.comparison[0].metrics

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, one sentence each."""
        search = self.search
        moves = self.how.moves(searched_problem(self.problem))
        early = [row.name for row in self.comparison if row.stopped_early]
        if not (search.stopped == "interrupted" or self.how.method == "exact" or moves):
            early = []  # with a time alone every run differs anyway
        return (
            *ended_early(self.how, search.stopped, moves),
            *(
                f"the search of the {name} was stopped early, by the time or Ctrl-C: another run"
                " may give another"
                for name in early
            ),
            *(certificate_warnings(self.problem) if self.certificate else ()),
            # the search does not know the well: only the verdict does
            *(
                "the code saturates at this light: search with fewer open chips, or give what can"
                " be recorded"
                for exposure in self.verdict.exposures
                if exposure.saturates and exposure.code.bits == self.code.bits
            ),
        )

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``cep optimize --json`` prints them."""
        code = self.code
        search = self.search
        return {
            "verdict": self.verdict.sentence,
            "choice": self.verdict.choice,
            "gains_db": self.verdict.gains_db,
            "bits": code.bits,
            **({"complement": self.complement.bits} if self.complement else {}),
            "chips": code.chips,
            "open": code.open_chips,
            "duty": code.duty,
            "chip_ns": code.chip_ns,
            "exposure_s": code.duration_ns * 1e-9,
            **self.metrics.to_dict(),
            "objective": search.objective,
            "proven": search.stopped == "proven",
            "proof": (search.proof or {}).get("file"),
            "certificate": self.certificate and self.certificate.to_dict(),
            "bound": self.bound,
            "gap": self.gap,
            "seconds": search.seconds,
            "steps": search.steps,
            "stopped": search.stopped,
            "interrupted": search.stopped == "interrupted",
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
        }

    def save(self, path: Path | str, *, source: Mapping[str, object] | None = None) -> None:
        """Write a ``code.json``, whole or not at all.

        Parameters
        ----------
        path : Path or str
        source : mapping, optional
            Where the motion comes from, for the file's description of the problem.
        """
        stored = stored_code(self.problem, self.how, self.search)
        about = {**(source or {}), **stored.problem}
        metrics = self.metrics
        if isinstance(metrics, PairMetrics):
            about["pair"] = metrics.to_dict()
            metrics = self.problem.measure(self.code)
        certificate = self.certificate.to_dict() if self.certificate else {}
        write_code(path, StoredCode(stored.code, metrics.to_dict(), about, certificate))

    def __repr__(self) -> str:
        lines = [
            self.verdict.sentence,
            f"{self.code.bits}: {self.code.open_chips} of {self.code.chips} chips open",
            *([f"{self.complement.bits}: its complement"] if self.complement else []),
            repr(self.comparison),
        ]
        if self.bound is not None:
            lines.append(
                f"no code with so many open chips has a {self.figure.split(',')[0]} beyond"
                f" {self.bound:.4g}"
            )
        return "\n".join([*lines, *self.warnings])

    def _repr_png_(self) -> bytes:
        from cep.plots.canvas import png_bytes
        from cep.plots.codes import mtf_figure

        path = self.along or self.problem.scenarios[0].trajectory
        codes: dict[str, ShutterCode | None] = {"open shutter": None, "this code": self.code}
        if self.complement:
            codes["its complement"] = self.complement
        return png_bytes(mtf_figure(path, codes))


def described(
    problem: SearchProblem,
    how: SearchOptions,
    search: SearchResult,
    judgement: Verdict,
    *,
    motion: Trajectory,
) -> OptimizedCode:
    """Compare a searched code with others, and of one camera certify it, and bound it."""
    if problem.frames == 2:
        best_snapshot = judgement.best("snapshot")
        comparison = compare_pairs(
            problem,
            search.code,
            baselines=search.baselines,
            snapshot=None if best_snapshot is None else best_snapshot.code,
        )
    else:
        comparison = compare(problem, search.code, baselines=search.baselines)
    path: Trajectory | None = None  # of a straight motion |P| is certified, whatever its speed
    if not problem.on_circle or problem.frames == 2:
        path = _as_designed(motion, problem.direction)
    certificate = certify(search.code, path) if problem.frames == 1 else None
    bounded = _bounded(problem, search, comparison[0].metrics, straight=path is None)
    return OptimizedCode(problem, how, search, comparison, judgement, path, certificate, *bounded)


def stored_code(problem: SearchProblem, how: SearchOptions, search: SearchResult) -> StoredCode:
    """Return a searched code as a file describes it, without its figures."""
    about = described_search(problem, how, steps=search.steps, stopped=search.stopped)
    return StoredCode(search.code, problem={**about, "proof": search.proof})


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
    search: SearchResult,
    metrics: CodeMetrics | PairMetrics,
    *,
    straight: bool,
) -> tuple[str, float | None, float | None]:
    """Name, bound and gap of the figure that was optimised, None where nothing bounds it."""
    # no bound is known for two cameras, a mix, the flatness or the expected error
    if isinstance(metrics, PairMetrics) or problem.objective not in ("min-mtf", "noise"):
        return "", None, None
    if straight and search.proof is not None and search.stopped == "proven":
        limit = search.proof["upper"]  # tighter than the bound: it counted every code
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
