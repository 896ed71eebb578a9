"""What the benchmarks share: options, a table as a job, and how it ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.cli.console import finish, progress, table
from cep.cli.folders import end

if TYPE_CHECKING:
    from rich.console import Console

    from cep.bench.engine import Outcome
    from cep.bench.index import Part
    from cep.bench.tables import Column, Entry, Table
    from cep.cli.console import Tick

__all__ = [
    "MANY",
    "Cache",
    "Dask",
    "Data",
    "Engine",
    "Gyro",
    "Job",
    "Quick",
    "Workers",
    "figures_of",
    "finish_bench",
    "run_job",
    "show_tables",
    "spelled",
    "told",
]

MANY = "Folders and benchmarks"
"""Panel of the help pages for work that is cut into cells."""

Data = Annotated[
    Path | None,
    typer.Option(
        "--data", metavar="FOLDER", help="Folder of photos; scikit-image's own when omitted, fit to try it only."
    ),
]
Quick = Annotated[bool, typer.Option("--quick", help="The protocol's small size.")]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers", metavar="N", min=1, help="Processes, one thread each; as many as cores when omitted.",
        rich_help_panel=MANY,
    ),
]  # fmt: skip
Gyro = Annotated[
    Path | None,
    typer.Option("--gyro", metavar="FILE", help="Recording of a gyroscope, for the hand shake of --protocol ours."),
]
Dask = Annotated[
    str | None,
    typer.Option(
        "--dask", metavar="ADDRESS", rich_help_panel=MANY,
        help="Scheduler of a Dask cluster to run on, as tcp://host:8786; photos must lie at the same paths there.",
    ),
]  # fmt: skip
Cache = Annotated[
    Path | None,
    typer.Option(
        "--cache", metavar="FOLDER", rich_help_panel=MANY,
        help="Folder of finished cells, found again; cells in the output when omitted.",
    ),
]  # fmt: skip


@dataclass(frozen=True)
class Engine:
    """Where cells are kept and what runs them, as :func:`cep.bench.engine.run_cells` takes it."""

    cache: Path
    workers: int
    dask: str | None

    @classmethod
    def of(cls, output: Path, *, cache: Path | None, workers: int | None, dask: str | None) -> Engine:
        """Fill in what was not said: cells in the output, as many workers as there are cores."""
        from cep.bench.machine import machine

        return cls(cache or output / "cells", workers or machine()["cores"] or 1, dask)


@dataclass(frozen=True)
class Job:
    """A table that is planned, so that what was wrong is known, and not yet measured.

    Attributes
    ----------
    about : mapping
        What was asked for, for the JSON.
    run : function
        Measures, writes the files and returns them as a part, with what prints its tables.
    """

    about: Mapping[str, object]
    run: Callable[[Tick], tuple[Part, Callable[[Console], None]]]


def run_job(job: Job, *, as_json: bool) -> None:
    """Do what a command with a single table does."""
    with progress("measuring") as tick:
        part, show = job.run(tick)
    finish_bench(job.about, part, show, as_json=as_json)


def finish_bench(about: Mapping[str, object], part: Part, show: Callable[[Console], None], *, as_json: bool) -> None:
    """Print what every benchmark that writes a folder ends with.

    Parameters
    ----------
    about : mapping
        What was asked for: folder, protocol, and what was compared.
    part : Part
    show : function that prints the tables
    as_json : bool

    Raises
    ------
    typer.Exit
        1 where a cell failed, 130 after Ctrl-C.
    """
    result = {
        **about,
        "files": list(part.files.values()),
        "tables": part.tables,
        "failures": part.failures,
        "missing": part.missing,
        "warnings": part.warnings,
    }

    def page(console: Console) -> None:
        show(console)
        folder = next(iter(part.files.values())).parent
        console.print(f"{folder}: {', '.join(part.files)}")

    finish(result, as_json=as_json, show=page)
    end(missing=part.missing, failed=len(part.failures))


def spelled(name: str, given: Mapping[str, object], *, quick: bool) -> str:
    """Spell ``cep bench NAME`` with the options given, an empty one for arguments, without anybody's folders."""
    words = [f"{option} {value}".strip() for option, value in given.items() if value]
    return " ".join(filter(None, ["cep bench", name, *words, "--quick" if quick else ""]))


def figures_of(tables: Sequence[Table]) -> dict[str, Any]:
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


def show_tables(console: Console, tables: Sequence[Table]) -> None:
    """Print the tables' means, or medians, for people, who find the intervals in the files."""
    for one in tables:
        lines = [(label, *map(_shown, one.columns, entries), one.cells[label]) for label, entries in one.rows.items()]
        console.print(table(one.title, one.head, lines, kept=1))


def _shown(column: Column, entry: Entry) -> str | None:
    if entry.summary.n == 0:
        return None
    text = f"{column.shown(entry):.{column.digits}f}"
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
