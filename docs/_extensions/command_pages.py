"""Pages written by the build: the command line from the commands, the works, and the README with
its links.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from citations import citable, cite
from sphinx.application import Sphinx
from works import works

from cep.commands.main import app as cep


def commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield every command and group with its full name, in the order of ``cep --help``."""
    yield name, command
    for child, found in getattr(command, "commands", {}).items():
        yield from commands(found, f"{name} {child}")


def page() -> str:
    """Lay out the command line as Markdown."""
    blocks = ["# Command line", "Generated from the program; `COMMAND --help` shows the same."]
    for name, command in commands(typer.main.get_command(cep), "cep"):
        blocks += [
            f"## `{name}`",
            _escaped(command.help or ""),
            "```text\n" + _usage(command, name) + "\n```",
        ]
        rows = [row for parameter in command.params if (row := _row(parameter))]
        if rows:
            blocks.append("\n".join(["| argument or option | meaning |", "|---|---|", *rows]))
        blocks += [f"```sh\n{example}\n```" for example in getattr(command, "examples", ())]
    return "\n\n".join(blocks) + "\n"


def _usage(command: Any, name: str) -> str:
    pieces = [_metavar(one) for one in command.params if one.param_type_name == "argument"]
    return " ".join(
        [name, "[OPTIONS]", *pieces, *(["COMMAND ..."] if hasattr(command, "commands") else [])]
    )


def _row(parameter: Any) -> str | None:
    if getattr(parameter, "hidden", False):
        return None
    if parameter.param_type_name == "argument":
        names, value = _metavar(parameter), ""
    else:
        names = ", ".join([*parameter.opts, *parameter.secondary_opts])
        value = "" if parameter.is_flag else f" {_metavar(parameter)}"
    cells = (f"`{names}{value}`", _escaped(parameter.help or ""))
    # a bar ends a cell, even within code
    row = " | ".join(cell.replace("|", "\\|") for cell in cells)
    return f"| {row} |".replace("\n", " ")


def _metavar(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())


def _escaped(text: str) -> str:
    """Keep Markdown from reading file names and brackets as markup; placeholders such as <x> stay
    text.
    """
    for mark in "\\*_[]<>$":
        text = text.replace(mark, f"\\{mark}")
    return text


def works_page() -> str:
    """Lay out the works behind each name, and their BibTeX, as Markdown."""
    blocks = [
        "# Works",
        "The works behind methods, published codes, restorations and figures, with their BibTeX. "
        "Please cite what you use, and the software (`CITATION.cff`). A name without a work is of "
        "this project.",
    ]
    for kind, named in citable().items():
        rows = [f"| `{name}` | {_behind(keys)} |" for name, keys in named.items()]
        blocks += [f"## {kind.capitalize()}", "\n".join(["| name | works |", "|---|---|", *rows])]
    return "\n\n".join([*blocks, "## BibTeX", f"```bibtex\n{cite().bibtex}```"]) + "\n"


def _behind(keys: tuple[str, ...]) -> str:
    return "<br>".join(works()[key].line for key in keys) or "–"


def _overview(readme: str) -> str:
    """Turn the links of the README, which lies one folder up, into those of a page in
    ``docs/``.
    """
    inside = readme.replace("](docs/", "](")
    return re.sub(
        r"\]\((?=(?:hw|cep|motdiff|notebooks|benchmarks|tests|CONTRIBUTING|CITATION)\b)",
        "](../",
        inside,
    )


def _write(app: Sphinx) -> None:
    folder = Path(app.srcdir)
    readme = (folder.parent / "README.md").read_text(encoding="utf-8")
    for name, text in (
        ("command-line", page()),
        ("overview", _overview(readme)),
        ("works", works_page()),
    ):
        path = folder / f"{name}.md"
        if (
            not path.exists() or path.read_text(encoding="utf-8") != text
        ):  # an unchanged page is not read again
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before documents are looked for."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True}
