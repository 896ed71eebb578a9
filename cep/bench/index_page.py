"""Index page of several tables in one folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cep.bench.table_io import machines_markdown, tables_markdown
from cep.bench.tables import Table
from cep.io.outputs import write_text

__all__ = ["INDEX", "Part", "first_table", "write_index"]

INDEX = "README.md"
"""The page; one of this name is shown where folders are browsed."""


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
    files: Mapping[str, Path]
    failures: Mapping[str, str]
    missing: int
    warnings: Sequence[str]
    machines: Sequence[Mapping[str, Any]]


def first_table(tables: Sequence[Table]) -> str:
    """Lay out the first of some tables as a part's summary."""
    return tables_markdown(tables[:1]) or "Nothing was measured.\n"


def write_index(folder: Path, parts: Sequence[Part], *, command: str, unmade: Sequence[str] = ()) -> Path:
    """Write :data:`INDEX`: commands, machines, and for each part its first figures, its picture and links to its files.

    Parameters
    ----------
    folder : Path
        Above the parts' folders.
    parts : sequence of Part
    command : str
        Command that reproduces all of them.
    unmade : sequence of str
        Parts not reached, after Ctrl-C.

    Returns
    -------
    Path of the file

    Raises
    ------
    OSError
        If it cannot be written.
    """
    machines: list[Mapping[str, Any]] = []
    for part in parts:
        machines += [machine for machine in part.machines if machine not in machines]
    head = [
        "# The paper's tables",
        "",
        f"Made by `{command}` on",
        "",
        machines_markdown(machines) or "- no machine",
        "",
        *(f"**{name} is not measured: stopped early; the same command with --force goes on.**\n" for name in unmade),
    ]
    path = folder / INDEX
    write_text(path, "\n".join(head) + "".join(f"\n{_section(folder, part)}" for part in parts))
    return path


def _section(folder: Path, part: Part) -> str:
    places = {Path(name).suffix: file.relative_to(folder).as_posix() for name, file in part.files.items()}
    others = ", ".join(f"[{name}]({file.relative_to(folder).as_posix()})" for name, file in part.files.items())
    notes = [*part.warnings, *(f"failed: {label}: {reason}" for label, reason in part.failures.items())]
    blocks = [
        f"## {part.title}",
        f"`{part.command}`",
        *(["\n".join(f"- {note}" for note in notes)] if notes else []),
        part.summary.rstrip("\n"),
        *([f"![{part.title}]({places['.png']})"] if ".png" in places else []),
        f"All of it: {others}.",
    ]
    return "\n\n".join(blocks) + "\n"
