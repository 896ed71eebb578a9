"""What commands share that do one thing for everything in a folder: the run, its table, and how it ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cep.cli.console import FAILURE, INTERRUPTED, finish, progress, table

if TYPE_CHECKING:
    from rich.console import Console

    from cep.bench.cells import Cell
    from cep.bench.engine import Outcome

__all__ = ["NOT_REACHED", "discard", "end", "finish_folder", "only_of_folders", "run_folder", "summary_csv"]

NOT_REACHED = "left out"


def only_of_folders(where: str, workers: int | None, dask: str | None, cache: Path | None) -> None:
    """Refuse the engine's options where there is one thing to do."""
    for name, value in (("--workers", workers), ("--dask", dask), ("--cache", cache)):
        if value is not None:
            raise ValueError(f"{name}: is for a folder ({where}), here is a single one")


def run_folder(
    cells: Sequence[Cell],
    *,
    task: str,
    noun: str,
    cache: Path,
    workers: int | None,
    dask: str | None,
) -> Outcome:
    """Run cells behind a progress bar that counts what they stand for.

    Parameters
    ----------
    cells : sequence of Cell
    task, noun : str
        What is done, and to what, in the plural.
    cache, workers, dask
        As of :func:`cep.bench.engine.run_cells`; as many workers as cores when omitted.
    """
    from cep.bench.engine import run_cells
    from cep.bench.machine import machine

    with progress(task) as tick:
        return run_cells(
            cells,
            cache=cache,
            workers=workers or machine()["cores"] or 1,
            dask=dask,
            progress=lambda fraction, note: tick(fraction, note.replace("cells", noun)),
        )


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
