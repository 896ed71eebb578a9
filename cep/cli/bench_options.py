"""Options that the benchmarks share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.cli.console import finish, table

if TYPE_CHECKING:
    from rich.console import Console

    from cep.bench.engine import Outcome
    from cep.bench.tables import Entry, Table

__all__ = ["Cache", "Dask", "Data", "Quick", "Workers", "finish_bench", "spelled", "told"]

Data = Annotated[
    Path | None, typer.Option("--data", help="Folder of photos; scikit-image's own when omitted, fit to try it only.")
]
Quick = Annotated[bool, typer.Option("--quick", help="The protocol's small size.")]
Workers = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes, one thread each; as many as cores when omitted.")
]
Dask = Annotated[str | None, typer.Option("--dask", help="Scheduler of a Dask cluster to run on, as tcp://host:8786.")]
Cache = Annotated[
    Path | None,
    typer.Option("--cache", help="Folder of finished cells, found again; cells in the output when omitted."),
]


def finish_bench(
    about: Mapping[str, object],
    tables: Sequence[Table],
    files: Mapping[str, Path],
    *,
    failures: Mapping[str, str],
    missing: int,
    warnings: Sequence[str],
    as_json: bool,
) -> None:
    """Print what every benchmark that writes a folder ends with.

    Parameters
    ----------
    about : mapping
        What was asked for: folder, protocol, and what was compared.
    tables : sequence of Table
    files : mapping from a file's name to its path
    failures : mapping from a cell's label to its reason
    missing : int
        Cells not reached.
    warnings : sequence of str
    as_json : bool
    """
    result = {
        **about,
        "files": list(files.values()),
        "tables": _figures_of(tables),
        "failures": failures,
        "missing": missing,
        "warnings": warnings,
    }
    finish(result, as_json=as_json, show=lambda console: _show_tables(console, tables, files))


def spelled(name: str, given: Mapping[str, object], *, quick: bool) -> str:
    """Spell ``cep bench NAME`` with the options given, for a report: without anybody's folders."""
    words = [f"{option} {value}" for option, value in given.items() if value]
    return " ".join(["cep bench", name, *words, *(["--quick"] if quick else [])])


def _figures_of(tables: Sequence[Table]) -> dict[str, Any]:
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


def _show_tables(console: Console, tables: Sequence[Table], files: Mapping[str, Path]) -> None:
    """Print the tables' means for people, who find the intervals in the files, and where these are."""
    for one in tables:
        lines = [
            (label, *map(_mean, entries, (column.digits for column in one.columns)), one.cells[label])
            for label, entries in one.rows.items()
        ]
        console.print(table(one.title, one.head, lines))
    if files:
        folder = next(iter(files.values())).parent
        console.print(f"{folder}: {', '.join(files)}")


def _mean(entry: Entry, digits: int) -> str | None:
    if entry.summary.n == 0:
        return None
    text = f"{entry.summary.mean:.{digits}f}"
    return f"[bold]{text}[/bold]" if entry.bold else text


def told(outcome: Outcome) -> list[str]:
    """Warnings about a run: what was not trusted, what failed, what was not reached."""
    warnings = list(outcome.warnings)
    if outcome.failures:
        name, reason = next(iter(outcome.failures.items()))
        count, total = len(outcome.failures), len(outcome.results)
        warnings.append(f"{count} of {total} cells failed, the first: {'/'.join(name)}: {reason}")
    if outcome.missing:
        warnings.append(f"stopped early: {outcome.missing} cells are left out; the same command with --force goes on")
    return warnings
