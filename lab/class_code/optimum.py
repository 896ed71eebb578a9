"""Code of a class of motions, and what it is worth beside others: table, verdict, file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cep.files.code_files import StoredCode, write_code
from cep.optics.code import ShutterCode
from cep.search.code_search import SearchOptions, described_search, ended_early
from cep.search.problem import SearchProblem
from cep.search.search_result import SearchResult

PUBLISHED_PREFIX = "published: "
_FEW = 20  # motions below which a class code has mostly learned them by heart


@dataclass(frozen=True)
class ClassRow:
    """A code and its mean over the motions of a class.

    Attributes
    ----------
    name : str
        "this code", or of a :class:`cep.search.search_result.Baseline`.
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
        if self.within_limits:
            return self.name
        return f"{self.name} (outside the limits)"

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
    how : SearchOptions
    outcome : SearchResult
    rows : tuple of ClassRow
        The code first, then what would be used instead of it.
    motions, held_out : int
        Motions of the search, and others that judge it.
    """

    problem: SearchProblem
    how: SearchOptions
    outcome: SearchResult
    rows: tuple[ClassRow, ...]
    motions: int
    held_out: int

    @property
    def code(self) -> ShutterCode:
        """The code."""
        return self.rows[0].code

    @property
    def unsearched(self) -> bool:
        """Whether the time or Ctrl-C ended the search before its first move."""
        return self.outcome.steps == 0 and self.outcome.stopped in ("time", "interrupted")

    @property
    def verdict(self) -> str:
        """What to do, and what it gains over the best snapshot and over the best published code:
        one or two sentences.

        Nothing is recommended that loses to a row of the table.
        """
        code = self.code
        rivals = self.rows[1:]
        if self.unsearched:
            ending_clause = f"{self.how.limit_s:g} s passed"
            if self.outcome.stopped == "interrupted":
                ending_clause = "Ctrl-C ended it"
            return (
                f"Nothing was searched: {ending_clause} before the first move. This code is only"
                " the best of those that it is compared with; give the search more time by --time,"
                " or moves by --steps."
            )
        where = f"in the mean over {self.motions} motions"
        if self.held_out:  # the searched ones flatter the code
            where = f"in the mean over {self.held_out} motions that the search has not seen"
        gains = [
            f"{_amount(best)} better than {_in_words(best.code, best.name)}"
            for kind in ("best snapshot", PUBLISHED_PREFIX)
            for best in sorted(
                (row for row in rivals if row.name.startswith(kind)), key=lambda row: row.behind_db
            )[:1]
            if best.behind_db > 0
        ]
        gain_text = ""
        if gains:
            gain_text = f": {' and '.join(gains)}"
        better = min(rivals, key=lambda row: row.behind_db, default=None)
        # only a code outside the limits can be: of those within, the best is this code
        if better is not None and better.behind_db < 0:
            return (
                f"Use {_in_words(better.code, better.name)} instead if the limits can be loosened:"
                f" it is {_amount(better)} better than this code, {where}. Within the limits use"
                f" this code{gain_text}."
            )
        clause = ""
        if gains:
            clause = f"{gain_text}, {where}"
        if code.pulses == 1:
            return (
                f"A short exposure is best, {_in_words(code, 'one opening')}{clause}. No code that"
                " was found beats it."
            )
        return f"Use this code{clause}."

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, one sentence each."""
        warnings = ended_early(self.how, self.outcome.stopped, self.how.moves(self.problem))
        if self.motions < _FEW:
            warnings.append(
                f"{self.motions} motions are few for a class, the code may suit no others; {_FEW}"
                " or more are better"
            )
        return tuple(warnings)

    def to_dict(self) -> dict[str, Any]:
        """Fields for JSON, as ``python -m lab design-class --json`` prints them."""
        code = self.code
        result = self.outcome
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
            "other_motions": self.held_out,
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
                self.problem, self.how, steps=self.outcome.steps, stopped=self.outcome.stopped
            ),
            "proof": self.outcome.proof,
            "motions": self.motions,
            "mean_db": self.rows[0].mean_db,
            "others_db": self.rows[0].others_db,
        }
        write_code(path, StoredCode(self.code, problem=about))


def _amount(row: ClassRow) -> str:
    return f"{abs(row.behind_db):.2f} dB (standard error {row.behind_error_db:.2f})"


def _in_words(code: ShutterCode, name: str) -> str:
    if name.startswith(PUBLISHED_PREFIX):
        return f"the published code {name.removeprefix(PUBLISHED_PREFIX)}"
    if name == "random code, median":
        return "a random code"
    light = f"open for {code.open_chips} of {code.chips} chips"
    if name.startswith("one"):
        return f"{name} ({light})"
    return f"the {name} ({light})"
