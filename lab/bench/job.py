"""A table of ``python -m lab bench`` before it is measured, and after: what was asked for, and
what was written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cep.jobs.engine import Outcome
from lab.bench.table_io import tables_markdown
from lab.bench.tables import Table, TextTable


@dataclass(frozen=True)
class Job:
    """A table that is planned, so that its options and inputs are checked, and not yet measured.

    Attributes
    ----------
    about : mapping
        What was asked for, for the JSON.
    run : function
        Measures, writes the files and returns them as a part. It is given what to call with the
        fraction done and a note.
    """

    about: Mapping[str, object]
    run: Callable[[Callable[[float, str], None]], Part]


@dataclass(frozen=True)
class Part:
    """A table on disk.

    Attributes
    ----------
    title : str
    command : str
        Command that reproduces it.
    summary : str
        Its first figures, Markdown.
    tables : mapping from a table's title to its figures, ready for JSON
    shown : sequence of Table or TextTable
        The same for people.
    files : mapping from a file's name to its path
        The figure is the one that ends in ``.png``.
    failures : mapping from a cell's label to its reason
    missing : int
        Cells not reached, after Ctrl-C.
    warnings : sequence of str
    machines : sequence of mapping
        As of :attr:`cep.jobs.engine.Outcome.machines`.
    """

    title: str
    command: str
    summary: str
    tables: Mapping[str, Any]
    shown: Sequence[Table | TextTable]
    files: Mapping[str, Path]
    failures: Mapping[str, str]
    missing: int
    warnings: Sequence[str]
    machines: Sequence[Mapping[str, Any]]


def part_of_tables(
    title: str,
    command: str,
    tables: Sequence[Table],
    files: Mapping[str, Path],
    *,
    failures: Mapping[str, str],
    missing: int,
    warnings: Sequence[str],
    machines: Sequence[Mapping[str, Any]],
) -> Part:
    """Make the part of tables with means, the first of which is its summary; see :class:`Part`."""
    summary = tables_markdown(tables[:1]) or "Nothing was measured.\n"
    return Part(
        title,
        command,
        summary,
        _figures(tables),
        tables,
        files,
        failures,
        missing,
        warnings,
        machines,
    )


def _figures(tables: Sequence[Table]) -> dict[str, Any]:
    """Tables as every benchmark's JSON has them: title, row, figure."""
    return {
        one.title: {
            label: {
                column.figure: {
                    "n": entry.summary.n,
                    "mean": entry.summary.mean,
                    "median": entry.summary.median,
                    "interval": entry.interval and (entry.interval.low, entry.interval.high),
                    "bold": entry.bold,
                }
                for column, entry in zip(one.columns, entries, strict=True)
            }
            for label, entries in one.rows.items()
        }
        for one in tables
    }


def outcome_warnings(outcome: Outcome) -> list[str]:
    """List the warnings about a run: what was not trusted, what failed, what was not reached."""
    warnings = list(outcome.warnings)
    if outcome.failures:
        name, reason = next(iter(outcome.failures.items()))
        count = len(outcome.failures)
        total = len(outcome.results)
        warnings.append(f"{count} of {total} cells failed, the first: {'/'.join(name)}: {reason}")
    if outcome.missing:
        warnings.append(
            f"stopped early: {outcome.missing} cells are left out; the same command with --force"
            " goes on"
        )
    return warnings


def spelled(name: str, given: Mapping[str, object], *, quick: bool) -> str:
    """Spell ``python -m lab bench NAME`` with the options given, an empty one for arguments,
    without anybody's folders.
    """
    words = [f"{option} {value}".strip() for option, value in given.items() if value]
    return " ".join(
        filter(None, ["python -m lab bench", name, *words, "--quick" if quick else ""])
    )
