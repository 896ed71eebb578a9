"""Options of the commands that measure tables, their run, and the printed tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import Page, end, finish, progress
from cep.commands.console import Table as SheetTable
from cep.commands.options import MANY, Force, Json, Workers, flag, option, output_option

if TYPE_CHECKING:
    from cep.files.tables import Bold
    from lab.bench.harness import Job, Report, Request
    from lab.bench.tables import Column, Entry, Table, TextTable


Dask = Annotated[
    str | None,
    typer.Option(
        "--dask",
        metavar="ADDRESS",
        rich_help_panel=MANY,
        help=(
            "Scheduler of a Dask cluster to run on, as tcp://host:8786; photos must lie at the"
            " same paths there."
        ),
    ),
]
Cache = Annotated[
    Path | None,
    typer.Option(
        "--cache",
        metavar="FOLDER",
        rich_help_panel=MANY,
        help="Folder of finished cells, found again; cells in the output when omitted.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """Options of every table."""

    cache: Cache = None
    output: Path = output_option("Folder to write into.", Path("bench"), metavar="FOLDER")
    force: Force = False
    as_json: Json = False

    def request(
        self,
        *,
        data: Path | None = None,
        quick: bool = False,
        workers: int | None = None,
        dask: str | None = None,
    ) -> Request:
        """Return the request that the options make."""
        from lab.bench.harness import Request
        from lab.jobs.engine import Engine

        engine = Engine.of(self.output, cache=self.cache, workers=workers, dask=dask)
        return Request(self.output, engine, data=data, quick=quick, force=self.force)


@dataclass(frozen=True, kw_only=True)
class PhotoOptions:
    """Photos of a table, and its size."""

    data: Path | None = option(
        "--data",
        "FOLDER",
        "Folder of photos; scikit-image's own when omitted, fit to try it only.",
    )
    quick: bool = flag("--quick", "The protocol's small size.")


@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """Processes or machines that measure a table."""

    workers: Workers = None
    dask: Dask = None


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
        report = job.run(tick)
    _finish_table(job.about, report, as_json=as_json)


def _finish_table(about: Mapping[str, object], report: Report, *, as_json: bool) -> None:
    missing = report.outcome.missing
    result = {
        **about,
        "files": list(report.files.values()),
        "tables": report.tables,
        "failures": report.outcome.reasons,
        "missing": missing,
        "warnings": report.provenance.warnings,
    }

    def page() -> Page:
        yield from table_page(report.shown)
        folder = next(iter(report.files.values())).parent
        yield f"{folder}: {', '.join(report.files)}"

    finish(result, page(), as_json=as_json)
    end(missing=missing, failed=len(report.outcome.reasons))


def table_page(tables: Sequence[Table | TextTable]) -> Page:
    """Lay tables out for people: means, or medians, whose intervals are in the files."""
    from lab.bench.tables import TextTable

    for sheet in tables:
        if isinstance(sheet, TextTable):
            yield SheetTable(sheet.title, sheet.head, sheet.lines)
            yield sheet.note
            continue
        lines = [
            (label, *map(_shown, sheet.columns, entries), *sheet.sizes(label))
            for label, entries in sheet.rows.items()
        ]
        yield SheetTable(sheet.title, sheet.head, lines, last_columns=1)


def _shown(column: Column, entry: Entry) -> str | Bold | None:
    from cep.files.tables import Bold

    if entry.summary.n == 0:
        return None
    text = f"{column.shown(entry):.{column.digits}f}"
    return Bold(text) if entry.bold else text
