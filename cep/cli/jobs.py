"""What commands share that do one thing for everything in a folder: the run, its table, and how it ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cep.cli.console import FAILURE, INTERRUPTED, finish, progress, table

if TYPE_CHECKING:
    from rich.console import Console

    from cep.bench.index_page import Part
    from cep.bench.tables import Column, Entry, Table
    from cep.cli.console import Tick
    from cep.jobs.cells import Cell, Result
    from cep.jobs.engine import Outcome

__all__ = [
    "MANY",
    "NOT_REACHED",
    "Cache",
    "Dask",
    "Data",
    "Engine",
    "Gyro",
    "Job",
    "Quick",
    "Workers",
    "discard",
    "end",
    "figures_of",
    "finish_bench",
    "finish_folder",
    "only_of_folders",
    "run_folder",
    "run_job",
    "show_tables",
    "spelled",
    "summary",
    "summary_csv",
]


NOT_REACHED = "left out"


def only_of_folders(where: str, workers: int | None, dask: str | None, cache: Path | None) -> None:
    """Refuse the engine's options where there is one thing to do."""
    for name, value in (("--workers", workers), ("--dask", dask), ("--cache", cache)):
        if value is not None:
            raise ValueError(f"{name}: is for a folder ({where}), here is a single one")


def run_folder(
    cells: Sequence[Cell],
    tick: Tick,
    *,
    noun: str,
    cache: Path,
    workers: int | None,
    dask: str | None,
    write: Callable[[Result], None],
) -> Outcome:
    """Run cells, tell how many of what they stand for are done, and write each result as soon as it is there.

    Parameters
    ----------
    cells : sequence of Cell
    tick : Tick
    noun : str
        What they stand for, in the plural.
    cache, workers, dask
        As of :func:`cep.jobs.engine.run_cells`; as many workers as cores when omitted.
    write : function
        Writes a result that is no failure. After Ctrl-C it is called again with what it may not have come to.
    """
    from cep.jobs.engine import run_cells
    from cep.jobs.machine import machine

    written: set[tuple[str, ...]] = set()

    def once(result: Result) -> None:
        if not result.finished.failure and result.cell.name not in written:
            write(result)
            written.add(result.cell.name)

    outcome = run_cells(
        cells,
        cache=cache,
        workers=workers or machine()["cores"] or 1,
        dask=dask,
        progress=lambda fraction, note: tick(fraction, note.replace("cells", noun)),
        finished=once,
    )
    for result in outcome.results:
        once(result)
    return outcome


def summary_csv(columns: Sequence[str], rows: Sequence[Mapping[str, object]]) -> str:
    """Lay out a folder's table as CSV, a line per row; what a row lacks is empty."""
    import csv
    import io

    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, restval="", extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def finish_folder(
    result: Mapping[str, object],
    columns: Mapping[str, str],
    rows: Sequence[Mapping[str, object]],
    *,
    title: str,
    noun: str,
    missing: int,
    warnings: Sequence[str],
    as_json: bool,
) -> None:
    """Print the table of a folder and end the command.

    Parameters
    ----------
    result : mapping
        For JSON, with ``summary``, the table's file; failures, ``missing`` and the warnings are added.
    columns : mapping from a row's key to the head that people read
        The first is the name; a figure that no row has is left out.
    rows : sequence of mappings
        With ``failure``, a reason, where something went wrong.
    title, noun : str
        Of the table, and what its rows are, in the plural.
    missing : int
        Not reached after Ctrl-C.
    warnings : sequence of str
    as_json : bool

    Raises
    ------
    typer.Exit
        1 where a row failed, 130 after Ctrl-C.
    """
    name, *figures = columns
    failures = {
        str(row[name]): str(row["failure"]) for row in rows if row.get("failure") not in (None, "", NOT_REACHED)
    }
    told = [*warnings, *(f"{failed}: {reason}" for failed, reason in failures.items())]
    if missing:
        told.append(f"stopped early: {missing} {noun} are left out; the same command with --force goes on")

    def show(console: Console) -> None:
        from rich.markup import escape

        shown = [key for key in figures if any(row.get(key) is not None for row in rows)]
        lines = [(escape(str(row[name])), *(row.get(key) for key in shown), _state(row)) for row in rows]
        console.print(table(title, (columns[name], *(columns[key] for key in shown), "warnings"), lines, kept=1))
        console.print(escape(str(result["summary"])))

    finish({**result, "failures": failures, "missing": missing, "warnings": told}, as_json=as_json, show=show)
    end(missing=missing, failed=len(failures))


def end(*, missing: int, failed: int) -> None:
    """End a command of many parts, whose outputs are written, with the exit code that tells how it went.

    Raises
    ------
    typer.Exit
        130 where Ctrl-C left parts out, else 1 where parts failed.
    """
    if missing:
        raise typer.Exit(INTERRUPTED)
    if failed:
        raise typer.Exit(FAILURE)


def discard(folder: Path, names: Sequence[str]) -> None:
    """Remove an earlier run's files of something that fails now, and the folder where nothing else is in it.

    Left there they would pass for results of this run.
    """
    if not folder.is_dir():
        return
    for name in names:
        (folder / name).unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()


def _state(row: Mapping[str, object]) -> str:
    """Say in a word how a row came out; the reasons and the warnings themselves are told on stderr."""
    failure, warnings = row.get("failure"), row.get("warnings")
    if failure:
        return NOT_REACHED if failure == NOT_REACHED else "failed"
    return str(len(warnings)) if isinstance(warnings, Sequence) and warnings else ""


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
    typer.Option(
        "--gyro",
        metavar="FILE",
        help="Recording of a gyroscope, for the hand shake of the protocols ours and card-gyro.",
    ),
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
    """Where cells are kept and what runs them, as :func:`cep.jobs.engine.run_cells` takes it."""

    cache: Path
    workers: int
    dask: str | None

    @classmethod
    def of(cls, output: Path, *, cache: Path | None, workers: int | None, dask: str | None) -> Engine:
        """Fill in what was not said: cells in the output, as many workers as there are cores."""
        from cep.jobs.machine import machine

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


def run_job(plan: Callable[[], Job], *, as_json: bool) -> None:
    """Do what a command with a single table does: plan it, which may take a while itself, and run it."""
    with progress("measuring") as tick:
        tick(0.0, "planning")
        job = plan()
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


def summary(outcome: Outcome) -> list[str]:
    """Warnings about a run: what was not trusted, what failed, what was not reached."""
    warnings = list(outcome.warnings)
    if outcome.failures:
        name, reason = next(iter(outcome.failures.items()))
        count, total = len(outcome.failures), len(outcome.results)
        warnings.append(f"{count} of {total} cells failed, the first: {'/'.join(name)}: {reason}")
    if outcome.missing:
        warnings.append(f"stopped early: {outcome.missing} cells are left out; the same command with --force goes on")
    return warnings
