"""Commands and groups of ``cep``: help that ends with examples, and errors that name the option as
it is typed.
"""

from __future__ import annotations

import re
import shutil
import textwrap
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from cep.commands.options import COMMON

_EXAMPLE = "Example: "
_UNITS = ("_s", "_ms", "_ns", "_px", "_db", "_e", "_ppm", "_hz", "_dn")
_SET_BY = {
    "axes": ("gyro_axes",),
    "bits": ("bits", "code", "codes"),
    "chip_ns": ("chip_ns", "exposure"),
    "chips": ("chips", "code", "codes"),
    "length_px": ("linear",),
    "method": ("method", "methods"),
    "name": ("names",),
    "open_range": ("open", "duty"),
    "photons_full_scale": ("photons",),
    "response": ("device",),
    "scenarios": ("speed", "trajectory", "linear"),
    "trajectory": ("trajectory", "linear"),
}
"""Options and arguments that set a parameter of another name: of those given, the first is
meant."""

_NAME = r"[a-z][a-z0-9]*(?:_[a-z0-9]+)*"
_NAMED = re.compile(rf"(?:^|(?<=, )|(?<= and )|(?<= or ))({_NAME})(?=[ ,]|$)")
_FILE = re.compile(r"/|\.\w+$")
_ASSIGNED = re.compile(rf"\b({_NAME})=(?:'([^']*)'|(\S+))")
_WITHIN = re.compile(r"""(?<![\w.'"/-])([a-z][a-z0-9]*(?:_[a-z0-9]+)+)(?![\w.'"/-])""")


def in_options(message: str, context: Any) -> str:
    """Translate the Python parameters that an error names into the command's options and
    arguments.

    Parameters
    ----------
    message : str
        As the library has it: "name: what is wrong", or "name value and other value conflict:
        why". Behind the colon ``other=value`` and names with an underscore are translated too.
        Names that no option sets stay as they are, and so do the fields of a file, which stand
        behind its name.
    context : click context
        Of the command: with its parameters, and whether each was given.

    Returns
    -------
    str
        As "--chips: what is wrong with --method exact".
    """

    def spelt(match: re.Match[str]) -> str:
        return _spelling(match[1], context) or match[1]

    def given(match: re.Match[str]) -> str:
        option = _spelling(match[1], context)
        return f"{option} {match[2] or match[3]}" if option else match[0]

    names, colon, fault = message.partition(": ")
    options = names if _FILE.search(names) else _NAMED.sub(spelt, names)
    if not colon or options == names:
        return message
    return f"{options}: {_WITHIN.sub(spelt, _ASSIGNED.sub(given, fault))}"


class _Page:
    """What commands and groups share: how their help is laid out."""

    examples: tuple[str, ...]

    def get_params(self, ctx: Any) -> list[Any]:
        """List the parameters for the help page: a switch has no value, and what all commands
        share comes last.
        """
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False) and param.metavar is None:
                param.metavar = ""  # typer calls it <bool>
            if "--help" in param.opts and any(_panel(option) == COMMON for option in params):
                param.rich_help_panel = COMMON
        return sorted(params, key=lambda param: _panel(param) == COMMON)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the page, and the examples below it as they can be copied: a panel would pad their
        lines.
        """
        super().format_help(ctx, formatter)  # type: ignore[misc]
        if self.examples:
            width = shutil.get_terminal_size().columns
            lines = [line for example in self.examples for line in _folded(example, width)]
            typer.echo(
                "\n".join(["", f" Example{'s' if len(self.examples) > 1 else ''}:", *lines, ""])
            )


class Command(_Page, TyperCommand):
    """A command: the paragraphs of its docstring that begin with "Example:" end its help page."""

    def __init__(self, name: str | None, *, help: str | None = None, **options: Any) -> None:
        about, self.examples = _pages(help or "")
        super().__init__(name, help=about, **options)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; a ValueError leaves it with the options' names."""
        try:
            return super().invoke(ctx)
        except ValueError as error:
            raise _translated(error, ctx) from error


class Group(_Page, TyperGroup):
    """A group of commands, which may do something by itself too."""

    def __init__(self, *, help: str | None = None, **options: Any) -> None:
        about, self.examples = _pages(help or "")
        super().__init__(help=about, **options)

    def invoke(self, ctx: Any) -> Any:
        """Run the group's own work or the command that was named, which has translated its errors
        already.
        """
        try:
            return super().invoke(ctx)
        except ValueError as error:
            if ctx.invoked_subcommand is not None:
                raise
            raise _translated(error, ctx) from error


def _panel(param: Any) -> str | None:
    panel: str | None = getattr(param, "rich_help_panel", None)
    return panel


def _translated(error: ValueError, context: Any) -> ValueError:
    translated = ValueError(in_options(str(error), context))
    for note in getattr(error, "__notes__", ()):
        translated.add_note(note)
    return translated


def _spelling(name: str, context: Any) -> str | None:
    """Spell the option or argument that sets a parameter; None where none does."""
    setters = [_bare(option) for option in _SET_BY.get(name, (name,))]
    spellings: list[tuple[bool, int, str]] = []
    for param in context.command.params:
        longest = max(param.opts, key=len)
        for spelling in (_bare(param.name), _bare(longest.lstrip("-").replace("-", "_"))):
            if spelling in setters:
                argument = param.param_type_name == "argument"
                text = (param.metavar or param.name.upper()).strip("[].") if argument else longest
                source = context.get_parameter_source(param.name)
                spellings.append(
                    (source is None or source.name != "COMMANDLINE", setters.index(spelling), text)
                )
    return min(spellings)[2] if spellings else None


def _bare(name: str) -> str:
    """Leave the unit out of a parameter's name."""
    unit = next((unit for unit in _UNITS if name.endswith(unit)), "")
    return name.removesuffix(unit)


def _pages(text: str) -> tuple[str, tuple[str, ...]]:
    """Split a docstring into what stands before the options, unwrapped, and the examples."""
    paragraphs = [_unwrapped(paragraph) for paragraph in text.split("\n\n") if paragraph.strip()]
    examples = tuple(
        paragraph.removeprefix(_EXAMPLE)
        for paragraph in paragraphs
        if paragraph.startswith(_EXAMPLE)
    )
    return "\n\n".join(
        paragraph for paragraph in paragraphs if not paragraph.startswith(_EXAMPLE)
    ), examples


def _folded(command: str, width: int) -> list[str]:
    """Fold a command line before its options, with backslashes, to so many columns."""
    options = command.replace(" ", "\0").replace("\0-", " -")
    lines = textwrap.wrap(
        options,
        width - 2,
        initial_indent=" ",
        subsequent_indent="     ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace("\0", " ") for line in " \\\n".join(lines).splitlines()]


def _unwrapped(paragraph: str) -> str:
    """Join a paragraph's lines, which rich breaks anew; the items of a list stay apart."""
    return re.sub(r"\n(?!- )\s*", " ", paragraph.strip())
