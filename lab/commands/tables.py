"""What the commands that measure tables share: their options, the run, and the printed tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import finish, progress, table
from cep.commands.jobs import end

if TYPE_CHECKING:
    from rich.console import Console

    from cep.files.tables import Bold
    from lab.bench.job import Job, Part
    from lab.bench.tables import Column, Entry, Table, TextTable

Data = Annotated[
    Path | None,
    typer.Option(
        "--data",
        metavar="FOLDER",
        help="Folder of photos; scikit-image's own when omitted, fit to try it only.",
    ),
]
Quick = Annotated[bool, typer.Option("--quick", help="The protocol's small size.")]
Gyro = Annotated[
    Path | None,
    typer.Option(
        "--gyro",
        metavar="FILE",
        help="Recording of a gyroscope, for the hand shake of the protocols ours and card-gyro.",
    ),
]


def run_job(plan: Callable[[], Job], *, as_json: bool) -> None:
    """Plan a table, which may take a while itself, run it, print it, and end the command.

    Raises
    ------
    typer.Exit
        1 where a cell failed, 130 after Ctrl-C.
    """
    with progress("measuring") as tick:
        tick(0.0, "planning")
        job = plan()
        part = job.run(tick)
    _finish_table(job.about, part, as_json=as_json)


def _finish_table(about: Mapping[str, object], part: Part, *, as_json: bool) -> None:
    result = {
        **about,
        "files": list(part.files.values()),
        "tables": part.tables,
        "failures": part.failures,
        "missing": part.missing,
        "warnings": part.warnings,
    }

    def page(console: Console) -> None:
        show_tables(console, part.shown)
        folder = next(iter(part.files.values())).parent
        console.print(f"{folder}: {', '.join(part.files)}")

    finish(result, as_json=as_json, show=page)
    end(missing=part.missing, failed=len(part.failures))


def show_tables(console: Console, tables: Sequence[Table | TextTable]) -> None:
    """Print tables for people: means, or medians, whose intervals are in the files."""
    from lab.bench.tables import TextTable

    for one in tables:
        if isinstance(one, TextTable):
            console.print(table(one.title, one.head, one.lines))
            console.print(one.note)
            continue
        lines = [
            (label, *map(_shown, one.columns, entries), *one.sizes(label))
            for label, entries in one.rows.items()
        ]
        console.print(table(one.title, one.head, lines, kept=1))


def _shown(column: Column, entry: Entry) -> str | Bold | None:
    from cep.files.tables import Bold

    if entry.summary.n == 0:
        return None
    text = f"{column.shown(entry):.{column.digits}f}"
    return Bold(text) if entry.bold else text
