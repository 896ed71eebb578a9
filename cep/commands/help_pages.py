"""Commands and groups for typer: help pages that end with examples, errors that name options."""

from __future__ import annotations

import re
import shutil
import textwrap
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from cep.commands.errors import in_options
from cep.commands.options import COMMON

_EXAMPLE = "Example: "


class _Page:
    """What commands and groups share: the layout of their help, and the names in their errors."""

    examples: tuple[str, ...]

    def __init__(self, *args: Any, help: str | None = None, **options: Any) -> None:
        about, self.examples = _pages(help or "")
        super().__init__(*args, help=about, **options)  # type: ignore[call-arg]

    def get_params(self, ctx: Any) -> list[Any]:
        """List the parameters for the help page, those that all commands share last."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False) and param.metavar is None:
                param.metavar = ""  # typer calls it <bool>
            if "--help" in param.opts and any(_panel(option) == COMMON for option in params):
                param.rich_help_panel = COMMON
        return sorted(params, key=lambda param: _panel(param) == COMMON)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the page, and the examples without a panel, which would pad the lines to copy."""
        super().format_help(ctx, formatter)  # type: ignore[misc]
        if self.examples:
            width = shutil.get_terminal_size().columns
            lines = [line for example in self.examples for line in _folded(example, width)]
            plural = "s" if len(self.examples) > 1 else ""
            typer.echo("\n".join(["", f" Example{plural}:", *lines, ""]))

    def invoke(self, ctx: Any) -> Any:
        """Run the command; a ValueError leaves it with the options' names."""
        try:
            return super().invoke(ctx)  # type: ignore[misc]
        except ValueError as error:
            if ctx.invoked_subcommand is not None:  # of a group: the command has translated it
                raise
            translated = ValueError(in_options(str(error), ctx))
            for note in getattr(error, "__notes__", ()):
                translated.add_note(note)
            raise translated from error


class Command(_Page, TyperCommand):
    """A command: the paragraphs of its docstring that begin with "Example:" end its help page."""


class Group(_Page, TyperGroup):
    """A group of commands, which may do something by itself too."""


def _panel(param: Any) -> str | None:
    panel: str | None = getattr(param, "rich_help_panel", None)  # arguments of click have none
    return panel


def _pages(text: str) -> tuple[str, tuple[str, ...]]:
    """Split a docstring into what stands before the options, unwrapped, and the examples."""
    # a paragraph's lines are joined, as rich breaks them anew; the items of a list stay apart
    paragraphs = [
        re.sub(r"\n(?!- )\s*", " ", paragraph.strip()) for paragraph in text.split("\n\n")
    ]
    about = [
        paragraph for paragraph in paragraphs if paragraph and not paragraph.startswith(_EXAMPLE)
    ]
    examples = [paragraph for paragraph in paragraphs if paragraph.startswith(_EXAMPLE)]
    return "\n\n".join(about), tuple(paragraph.removeprefix(_EXAMPLE) for paragraph in examples)


def _folded(command: str, width: int) -> list[str]:
    """Fold a command line before its options, with backslashes, to so many columns."""
    options = command.replace(" ", "\0").replace("\0-", " -")  # an option keeps its value
    lines = textwrap.wrap(
        options,
        width - 2,
        initial_indent=" ",
        subsequent_indent="     ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace("\0", " ") for line in " \\\n".join(lines).splitlines()]
