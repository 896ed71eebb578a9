"""One result for each thing in a folder: the run, the results' folders, and the table of all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cep.files.tables import csv_lines
from cep.jobs.cells import Cell, Figure, Result
from cep.jobs.engine import Engine
from motdiff.files.outputs import new_files, write_text

NOT_REACHED = "left out"
"""The ``failure`` of what was not reached, after Ctrl-C."""


class NotWrittenError(Exception):
    """A result cannot be written; the reason stands in the table."""


@dataclass(frozen=True)
class FolderResults:
    """Results for the things in a folder.

    Attributes
    ----------
    folder : Path
        With a folder for each result.
    summary : Path
        The table, CSV.
    found : mapping from a name to its figures, with ``warnings``
        Without those that failed or were not reached.
    rows : sequence of mapping
        The table's: the name, the figures, ``warnings`` and ``failure``, a reason or empty.
    missing : int
        Not reached, after Ctrl-C.
    warnings : sequence of str
    """

    folder: Path
    summary: Path
    found: Mapping[str, Mapping[str, Any]]
    rows: Sequence[Mapping[str, Any]]
    missing: int
    warnings: Sequence[str]


def run_folder(
    folder: Path,
    places: Mapping[str, Path],
    cells: Sequence[Cell],
    *,
    noun: str,
    files: Sequence[str],
    summary: str,
    columns: Sequence[str],
    failures: Mapping[str, str],
    write: Callable[[str, Mapping[str, Figure]], Mapping[str, Any]],
    engine: Engine,
    force: bool,
    progress: Callable[[float, str], None],
) -> FolderResults:
    """Run cells, write each result as soon as it is there, and the table of all.

    Parameters
    ----------
    folder : Path
        Of the table, made where it is missing.
    places : mapping from a name to the folder of its result
        In the table's order.
    cells : sequence of Cell
        Each named by one of the names.
    noun : str
        What the names are, in the plural.
    files : sequence of str
        What a result's folder holds. With ``force`` those of an earlier run are removed where the
        result fails now: left there they would pass for results of this run.
    summary : str
        Name of the table's file.
    columns : sequence of str
        Of the table; the first is the name's.
    failures : mapping from a name to the reason why it has no cell
    write : function
        Writes the result of a name from its figures, and returns what the table has of it, with
        ``warnings``; raises :class:`NotWrittenError` where it cannot. After Ctrl-C it is called
        with what it has not finished.
    engine : Engine
    force : bool
    progress : function
        Called with the fraction done and a note.
    """
    found: dict[str, Mapping[str, Any]] = {}
    failed = dict(failures)

    def write_once(result: Result) -> None:
        (name,) = result.cell.name
        if result.finished.failure or name in found or name in failed:
            return
        try:
            found[name] = write(name, result.finished.figures)
        except NotWrittenError as error:
            failed[name] = str(error)

    outcome = engine.run(
        cells,
        progress=lambda fraction, note: progress(fraction, note.replace("cells", noun)),
        finished=write_once,
    )
    for result in outcome.results:
        write_once(result)
    failed |= {name: reason for (name,), reason in outcome.failures.items()}
    if force:
        for name in failed:
            _discard(places[name], files)
    ordered = {name: found[name] for name in places if name in found}
    rows = [
        {
            columns[0]: name,
            **(own := ordered.get(name, {})),
            **_in_words(own.get("figures", {})),
            "failure": failed.get(name, "" if name in ordered else NOT_REACHED),
        }
        for name in places
    ]
    folder.mkdir(parents=True, exist_ok=True)  # nothing is in it where everything failed
    with new_files([folder / summary], force=force) as made:
        write_text(made[folder / summary], _csv(columns, rows))
    warnings = [
        *outcome.warnings,
        *(f"{name}: {line}" for name, one in ordered.items() for line in one["warnings"]),
    ]
    return FolderResults(folder, folder / summary, ordered, rows, outcome.missing, warnings)


def is_spelled(name: str) -> bool:
    """Whether a file's name is a text; other bytes, which Python keeps as lone surrogates, no
    table can hold.
    """
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def _in_words(figures: Mapping[str, Any]) -> dict[str, float | str | None]:
    """Lay out figures of the user's own, as JSON has them, for a line of the table: forward /
    backward.
    """
    return {
        name: " / ".join("–" if one is None else f"{one:.6g}" for one in value)
        if isinstance(value, list)
        else value
        for name, value in figures.items()
    }


def _csv(columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> str:
    """Lay out the table, a line per row; what a row lacks is empty."""
    lines = [{**row, "warnings": "; ".join(row.get("warnings", ()))} for row in rows]
    return csv_lines([columns, *([line.get(name) for name in columns] for line in lines)])


def _discard(folder: Path, names: Sequence[str]) -> None:
    """Remove files, and the folder where nothing else is in it."""
    if not folder.is_dir():
        return
    for name in names:
        (folder / name).unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()
