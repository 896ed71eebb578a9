"""Commands that the documents show: where they stand, and what a shell would pass to the
program."""

import contextlib
import functools
import io
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import jupytext
import typer

from cep.commands.main import app
from lab.commands.main import app as lab_app
from motdiff.__main__ import parser

ROOT = Path(__file__).resolve().parents[2]
GENERATED = {"command-line.md", "overview.md", "works.md"}
"""Pages that the build of the site writes, from the commands and from the README."""

LEFT_OUT = {"_build", "node_modules"}
PROGRAMS = (("cep",), ("python", "-m", "motdiff"), ("python", "-m", "lab"))
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_SPAN = re.compile(r"(?<!`)`((?:cep|python -m motdiff|python -m lab)\s[^`]*)`(?!`)")
_REDIRECTION = re.compile(r"\s(?:\d?>&\d|\d?[<>]+ *\S+)")
_OPERATORS = frozenset({"&", "&&", "|", "||", ";"})
_AT_ONCE = frozenset({"--help", "--version", "--install-completion"})
"""Options that act while a command line is parsed."""

_LACKING = frozenset({"MissingParameter", "NoArgsIsHelpError"})


@dataclass(frozen=True)
class Shown:
    """A command of a document: in a block it is whole; in a sentence it may be a mere mention, as
    ``cep audit``."""

    page: str
    words: tuple[str, ...]
    whole: bool

    def __str__(self):
        return f"{self.page}: {shlex.join(self.words)}"


def pages():
    """Return the documents for users, in order, with the prose of the notebooks as text."""
    folders = [ROOT / name for name in ("docs", "notebooks", "hw", "motdiff")]
    paths = [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *(p for folder in folders for p in folder.rglob("*.md")),
    ]
    for path in sorted(paths):
        if path.name not in GENERATED and not LEFT_OUT & set(path.parts):
            yield str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "notebooks").glob("*.py")):
        cells = jupytext.read(path).cells
        yield (
            str(path.relative_to(ROOT)),
            "\n\n".join(cell.source for cell in cells if cell.cell_type == "markdown"),
        )


def lines_of(text, language):
    """Return the lines that a reader would type, of all blocks in one language: comments and
    outputs left out."""
    for kind, block in _FENCE.findall(text):
        if kind != language:
            continue
        for line in block.replace("\\\n", " ").splitlines():
            if language == "console" and not line.startswith("$ "):
                continue
            yield line.removeprefix("$ ")


def commands_in(line):
    """Return the calls of our programs in a line for the shell, each as its words without the
    program's name."""
    lexer = shlex.shlex(_REDIRECTION.sub("", line), posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    piece: list[str] = []
    for word in [*lexer, ";"]:
        if word not in _OPERATORS:
            piece.append(word)
            continue
        if any(tuple(piece[: len(program)]) == program for program in PROGRAMS):
            yield tuple(piece)
        piece = []


def shown():
    """Return every command that a document shows."""
    for page, text in pages():
        for language in ("sh", "console"):
            for line in lines_of(text, language):
                yield from (Shown(page, words, whole=True) for words in commands_in(line))
        for span in _SPAN.findall(_FENCE.sub("", text)):
            line = re.sub(
                r"[][]|\.\.\.", "", " ".join(span.split())
            )  # optional parts count, repetition does not
            yield from (Shown(page, words, whole=False) for words in commands_in(line))
    for app_name, root in (("cep", command_line()), ("python -m lab", lab_command_line())):
        for name, command in _with_examples(root, app_name):
            for example in getattr(command, "examples", ()):
                yield from (
                    Shown(f"{name} --help", words, whole=True) for words in commands_in(example)
                )


@functools.cache
def command_line():
    """Return the commands of ``cep``, built once."""
    return typer.main.get_command(app)


@functools.cache
def lab_command_line():
    """Return the commands of ``python -m lab``, built once."""
    return typer.main.get_command(lab_app)


def _with_examples(command, name):
    yield name, command
    for child, found in getattr(command, "commands", {}).items():
        yield from _with_examples(found, f"{name} {child}")


def fault(command):
    """Parse a command as the program does, down to the values of its options; return its
    complaint, or None.

    A mention may leave out what is required, end with an option that wants a value, and say N for
    a number.
    """
    words = [word for word in command.words if word not in _AT_ONCE]
    if not command.whole:
        words = ["8" if word == "N" else word for word in words]
    if words in (["cep"], ["python", "-m", "lab"]):
        return None
    told = io.StringIO()
    try:
        with contextlib.redirect_stderr(told), contextlib.redirect_stdout(told):
            if words[0] == "cep":
                _parse(command_line(), words[1:])
            elif words[2] == "lab":
                _parse(lab_command_line(), words[3:])
            else:
                parser().parse_args(words[3:])
    except (
        Exception
    ) as error:  # typer brings its own click or uses the one installed: told apart by name
        text = error.format_message() if hasattr(error, "format_message") else repr(error)
        lacking = type(error).__name__ in _LACKING or "requires an argument" in text
    except SystemExit:
        text = told.getvalue().strip()
        lacking = "arguments are required" in text or "expected one argument" in text
    else:
        return None
    return None if lacking and not command.whole else text


def _parse(command, words, parent=None):
    context = command.make_context(command.name, words, parent=parent)
    rest = [*context._protected_args, *context.args]
    if rest and hasattr(command, "commands"):
        _, inner, rest = command.resolve_command(context, rest)
        _parse(inner, rest, context)
