"""The end of a command of many parts, as of the photos of a folder: its table and exit code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from cep.commands.console import FAILURE, INTERRUPTED, Table, finish

if TYPE_CHECKING:
    from cep.calibration.calibrate_folder import FolderResults

MANY = "Folders and benchmarks"  # panel of the help pages for work that is cut into cells

Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        min=1,
        rich_help_panel=MANY,
        help="Processes of one thread; as many as cores when omitted.",
    ),
]


def finish_folder(
    result: Mapping[str, object],
    columns: Mapping[str, str],
    results: FolderResults,
    *,
    title: str,
    noun: str,
    as_json: bool,
) -> None:
    """Print the table of a folder and end the command.

    Parameters
    ----------
    result : mapping
        For JSON, with ``summary``, the table's file; failures, ``missing`` and the warnings are
        added.
    columns : mapping from a row's key to the head that people read
        The first is the name; a figure that no row has is left out.
    results : FolderResults
    title, noun : str
        Of the table, and what its rows are, in the plural.
    as_json : bool

    Raises
    ------
    typer.Exit
        1 where a row failed, 130 after Ctrl-C.
    """
    from cep.calibration.calibrate_folder import NOT_REACHED

    name, *figures = columns
    rows = results.rows
    missing = results.missing
    failures = {
        str(row[name]): str(row["failure"])
        for row in rows
        if row.get("failure") not in (None, "", NOT_REACHED)
    }
    warnings = [*results.warnings, *(f"{failed}: {reason}" for failed, reason in failures.items())]
    if missing:
        warnings.append(
            f"stopped early: {missing} {noun} are left out; the same command with --force goes on"
        )
    filled = [key for key in figures if any(row.get(key) is not None for row in rows)]
    heads = (columns[name], *(columns[key] for key in filled), "warnings")
    lines = [(str(row[name]), *(row.get(key) for key in filled), _state(row)) for row in rows]
    finish(
        {**result, "failures": failures, "missing": missing, "warnings": warnings},
        as_json=as_json,
        page=[Table(title, heads, lines, last_columns=1), str(result["summary"])],
    )
    end(missing=missing, failed=len(failures))


def end(*, missing: int, failed: int) -> None:
    """End a command of many parts, whose outputs are written, with the exit code of the run.

    Raises
    ------
    typer.Exit
        130 where Ctrl-C left parts out, else 1 where parts failed.
    """
    # an interrupted run says so, whatever has failed before
    if missing:
        raise typer.Exit(INTERRUPTED)
    if failed:
        raise typer.Exit(FAILURE)


def _state(row: Mapping[str, object]) -> str:
    """Return the state of a row in a word; reasons and warnings are printed on stderr."""
    from cep.calibration.calibrate_folder import NOT_REACHED

    failure = row.get("failure")
    warnings = row.get("warnings")
    if failure == NOT_REACHED:
        return NOT_REACHED
    if failure:
        return "failed"
    if isinstance(warnings, Sequence) and warnings:
        return str(len(warnings))
    return ""
