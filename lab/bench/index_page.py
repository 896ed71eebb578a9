"""Index page of several tables in one folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cep.files.foreign_text import in_code_span, markdown_text
from lab.bench.job import Part
from lab.bench.table_io import machines_markdown
from motdiff.files.outputs import write_text

INDEX = "README.md"
"""The page; one of this name is shown where folders are browsed."""


def write_index(
    folder: Path, parts: Sequence[Part], *, command: str, unmade: Sequence[str] = ()
) -> Path:
    """Write :data:`INDEX`: commands, machines, and for each part its first figures, its picture
    and links to its files.

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
        f"Made by {in_code_span(command)} on",
        "",
        machines_markdown(machines) or "- no machine",
        "",
        *(
            f"**{name} is not measured: stopped early; the same command with --force goes on.**\n"
            for name in unmade
        ),
    ]
    path = folder / INDEX
    write_text(path, "\n".join(head) + "".join(f"\n{_section(folder, part)}" for part in parts))
    return path


def _section(folder: Path, part: Part) -> str:
    places = {
        Path(name).suffix: file.relative_to(folder).as_posix() for name, file in part.files.items()
    }
    others = ", ".join(
        f"[{name}]({file.relative_to(folder).as_posix()})" for name, file in part.files.items()
    )
    notes = [
        *part.warnings,
        *(f"failed: {label}: {reason}" for label, reason in part.failures.items()),
    ]
    blocks = [
        f"## {part.title}",
        in_code_span(part.command),
        *(["\n".join(f"- {markdown_text(note)}" for note in notes)] if notes else []),
        part.summary.rstrip("\n"),
        *([f"![{part.title}]({places['.png']})"] if ".png" in places else []),
        f"All of it: {others}.",
    ]
    return "\n\n".join(blocks) + "\n"
