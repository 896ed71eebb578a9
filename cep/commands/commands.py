"""Commands of ``cep``: help that ends with examples, errors that name options as typed."""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from cep.commands.options import COMMON

_EXAMPLE = "Example: "
# options and arguments that set a parameter of another name: of those given, the first is meant
_SET_BY = {
    "bits": ("bits", "code", "codes"),
    "black_dn": ("black",),
    "chip": ("chip_ns",),
    "chip_ns": ("chip_ns", "exposure"),
    "chips": ("chips", "code", "codes"),
    "duty": ("open",),
    "exposure_s": ("exposure",),
    "length_px": ("linear",),
    "method": ("method", "methods"),
    "name": ("names",),
    "open_range": ("open",),
    "path_error_px": ("path_error",),
    "photons_full_scale": ("photons",),
    "read_noise_e": ("read_noise",),
    "response": ("device",),
    "scenarios": ("speed", "trajectory", "linear"),
    "trajectory": ("trajectory", "linear"),
}

# an error begins with the parameters that are wrong: "open_range, min_open and device: conflict"
_NAMED = re.compile(r"(?:^|(?<=, )|(?<= and )|(?<= or ))\w+(?=[ ,]|$)")
_FILE = re.compile(r"/|\.\w+$")  # or with a file, whose fields are not options
# behind the colon only what cannot be an English word: method='pmp', and names with underscores
_WITHIN = re.compile(
    r"""(?<![\w.'"/-])(?=[a-z0-9]*[_=])[a-z]\w*(?:=(?:'[^']*'|[^\s,]\S*)|(?![\w.'"/=-]))"""
)


def with_photo_file(error: str, images: Sequence[Path]) -> str:
    """Name the file of ``photo 2`` in an error of several photos; others stay as they are."""
    prefix = re.match(r"photo(?: (\d+))?: ", error)
    if prefix is None:
        return error
    return f"{images[int(prefix[1] or 1) - 1]}: {error[prefix.end() :]}"


def in_options(message: str, context: Any) -> str:
    """Translate the Python parameters that an error names into the command's options.

    The library has no knowledge of the command line, so its errors name its own parameters.

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
        name, _, value = match[0].partition("=")
        if (option := _spelling(name, context)) is None:
            return match[0]
        return " ".join(filter(None, (option, value.strip("'"))))

    names, colon, fault = message.partition(": ")
    options = names if _FILE.search(names) else _NAMED.sub(spelt, names)
    if not colon or options == names:
        return message
    return f"{options}: {_WITHIN.sub(spelt, fault)}"


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


def _spelling(name: str, context: Any) -> str | None:
    """Spell the option or argument that sets a parameter; None where none does."""
    params: dict[str, Any] = {}
    for param in context.command.params:
        longest = max(param.opts, key=len)
        # a field may have another name than its option: open_chips is --open
        params |= {param.name: param, longest.lstrip("-").replace("-", "_"): param}

    def is_default(param: Any) -> bool:
        source = context.get_parameter_source(param.name)
        return source is None or source.name != "COMMANDLINE"

    setters = [params[key] for key in _SET_BY.get(name, (name,)) if key in params]
    if not setters:
        return None
    setter = min(setters, key=is_default)  # the first of those given
    if setter.param_type_name == "argument":
        return str(setter.metavar or setter.name.upper()).strip("[].")
    return str(max(setter.opts, key=len))


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
