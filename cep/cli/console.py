"""How commands talk: one JSON object or a page for people on stdout; progress and one-line errors on stderr."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["BAD_INPUT", "FAILURE", "INTERRUPTED", "Tick", "complain", "explain", "finish", "progress", "table", "warn"]

FAILURE, BAD_INPUT, INTERRUPTED = 1, 2, 130


class Tick(Protocol):
    """Reports progress."""

    def __call__(self, fraction: float, note: str = "", /) -> None:
        """Say that ``fraction`` (0..1) of the work is done."""


def finish(result: Mapping[str, object], *, as_json: bool, show: Callable[[Console], None]) -> None:
    """Print a command's result: as strict JSON, or through ``show`` for people.

    Parameters
    ----------
    result : mapping
        ``warnings``, where present, go to stderr for people.
    as_json : bool
    show : function that prints on the console it is given
    """
    if as_json:
        from cep.files import json_text

        sys.stdout.write(json_text(result))
        return
    from rich.console import Console

    show(Console(highlight=False, soft_wrap=True))
    warnings = result.get("warnings", ())
    for warning in warnings if isinstance(warnings, Sequence) else ():
        warn(str(warning))


def warn(message: str) -> None:
    """Print one warning line on stderr."""
    _line(f"cep: warning: {message}")


def complain(message: str) -> None:
    """Print one error line on stderr."""
    _line(f"cep: {message}")


def explain(error: BaseException) -> int:
    """Print one line for ``error`` and return the exit code: 2 for what the user can mend, 1 for a failure.

    ``CEP_DEBUG=1`` in the environment prints the traceback too.
    """
    if os.environ.get("CEP_DEBUG") == "1":
        traceback.print_exception(error)
    format_message = getattr(error, "format_message", None)  # typer's usage errors
    if format_message is not None:
        complain(f"{format_message()} (see {_command_path(error)} --help)")
        return BAD_INPUT
    notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))  # a shutter that may be open, for one
    if isinstance(error, OSError):
        import errno

        full_disk = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
        reason = error.strerror or str(error) or type(error).__name__
        complain((f"{error.filename}: {reason}" if error.filename else reason) + notes)
        return FAILURE if error.errno in full_disk else BAD_INPUT
    if isinstance(error, ValueError):
        complain((str(error) or "wrong input") + notes)
        return BAD_INPUT
    if isinstance(error, MemoryError):
        complain(f"not enough memory ({error}): use a smaller photo or crop it")
        return FAILURE
    kind = "" if isinstance(error, RuntimeError) else f"{type(error).__name__}: "
    complain(f"{kind}{error}{notes}")
    return FAILURE


@contextmanager
def progress(task: str) -> Iterator[Tick]:
    """Show a bar with the time left on stderr, when stderr is a terminal.

    Parameters
    ----------
    task : str, what is being done
    """
    if not sys.stderr.isatty():
        yield _ignore
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("elapsed"), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        row = bar.add_task(task, total=None, note="")

        def tick(fraction: float, note: str = "", /) -> None:
            bar.update(row, total=1.0, completed=min(max(fraction, 0.0), 1.0), note=note)

        yield tick


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> Any:
    """Make a rich table: the first column is text, the others figures; None is printed as a dash."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    made = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        made.add_column(column, justify="right" if index else "left", no_wrap=index > 0)
    for row in rows:
        made.add_row(*(_cell(value) for value in row))
    return made


def _cell(value: object) -> str:
    from cep.wording import number

    if value is None:
        return "–"
    if isinstance(value, float):
        return number(value) if abs(value) < 1000 else f"{value:.1f}"
    return str(value)


def _ignore(_fraction: float, _note: str = "", /) -> None:
    """Report to nobody."""


def _line(text: str) -> None:
    print(" ".join(text.split()), file=sys.stderr)  # noqa: T201 - the one place that writes to people's stderr


def _command_path(error: BaseException) -> str:
    context = getattr(error, "ctx", None)
    return str(context.command_path) if context is not None else "cep"
