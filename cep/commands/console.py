"""How commands talk: one JSON object or a page for people on stdout; progress and one-line errors
on stderr.
"""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.text import Text

    from cep.files.tables import Sheet
    from motdiff.files.outputs import Outputs

FAILURE = 1
BAD_INPUT = 2
INTERRUPTED = 130
_ROOMY = (
    100  # columns of a terminal: with fewer the bar is short, and the time elapsed is not shown
)
_WIDE = 16  # characters: longer cells are texts, which wrap, as names do, but to no fewer


class Tick(Protocol):
    """Reports progress."""

    def __call__(self, fraction: float, note: str = "", /) -> None:
        """Say that ``fraction`` (0..1) of the work is done."""


def finish(
    result: Mapping[str, object],
    *,
    as_json: bool,
    show: Callable[[Console], None],
    outputs: Outputs | None = None,
    save: Callable[[Mapping[Path, Path]], object] = lambda _staged: None,
    tables: Path | None = None,
    summary: str = "",
) -> None:
    """Write a command's outputs, all or none, and print its result: as strict JSON, or through
    ``show`` for people.

    Parameters
    ----------
    result : mapping
        ``warnings``, where present, go to stderr for people.
    as_json : bool
    show : function that prints on the console it is given
    outputs : Outputs, optional
        Files to write.
    save : function, optional
        Writes them under temporary names: it is given the mapping of each file to its own.
    tables : Path, optional
        That of ``outputs`` for the tables that ``show`` prints, whole: .tex, .csv or .md.
    summary : str
        The result in one line, which the error says where the outputs cannot be written.
    """
    if outputs is not None:
        with outputs.written(summary=summary) as staged:
            if tables is not None:
                from cep.files.tables import write_sheets

                write_sheets(_sheets(show), staged[tables])
            save(staged)
    if as_json:
        from motdiff.files.json_files import json_text

        encoding = sys.stdout.encoding or "utf-8"
        sys.stdout.write(
            json_text(
                result, ascii_only=not encoding.lower().replace("_", "-").startswith("utf-8")
            )
        )
        return
    console = page()
    show(console)
    if tables is not None:
        console.print(f"{tables}: the tables")
    warnings = result.get("warnings", ())
    for warning in warnings if isinstance(warnings, Sequence) else ():
        warn(str(warning))


def page() -> Console:
    """Make the console of a page for people: texts are no markup, and a terminal's commands in
    them can be seen.
    """
    from rich.console import Console
    from rich.text import Text

    from motdiff.files.inputs import printable

    class Page(Console):
        def print(self, *objects: Any, **options: Any) -> None:
            lines = (Text(printable(item)) if isinstance(item, str) else item for item in objects)
            super().print(*lines, **options)

    return Page(highlight=False, soft_wrap=True, markup=False, emoji=False)


def _sheets(show: Callable[[Console], None]) -> list[Sheet]:
    """Collect the tables that a page for people has."""
    from io import StringIO

    from rich.console import Console

    from cep.files.tables import Sheet

    sheets: list[Sheet] = []

    class Collector(Console):
        def print(self, *objects: Any, **_: Any) -> None:
            sheets.extend(
                Sheet(item.title, item.columns, item.rows)
                for item in objects
                if isinstance(item, Table)
            )

    show(Collector(file=StringIO()))
    return sheets


def warn(message: str) -> None:
    """Print one warning line on stderr."""
    _line(f"cep: warning: {message}")


def complain(message: str) -> None:
    """Print one error line on stderr."""
    _line(f"cep: {message}")


def explain(error: BaseException) -> int:
    """Print one line for ``error`` and return the exit code: 2 for what the user can mend, 1 for a
    failure.

    ``CEP_DEBUG=1`` in the environment prints the traceback too.
    """
    if os.environ.get("CEP_DEBUG") == "1":
        traceback.print_exception(error)
    format_message = getattr(error, "format_message", None)  # typer's usage errors
    if format_message is not None:
        complain(f"{format_message()} (see {_command_path(error)} --help)")
        return BAD_INPUT
    # a shutter that may be open, for one
    notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
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
        complain(f"not enough memory ({error}): use a smaller photo or crop it{notes}")
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
    from rich.progress import (
        BarColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.table import Column

    from cep.files.foreign_text import terminal_line

    console = Console(stderr=True)
    elapsed = (TextColumn("elapsed"), TimeElapsedColumn()) if console.width >= _ROOMY else ()
    note_column = Column(no_wrap=True, overflow="ellipsis", ratio=1)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(min(max(console.width - _ROOMY, 10), 40)),
        TextColumn("{task.percentage:>3.0f} %"),
        *elapsed,
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False, table_column=note_column),
    )
    with Progress(*columns, console=console, transient=True, expand=True) as bar:
        row = bar.add_task(terminal_line(task), total=None, note="")

        def tick(fraction: float, note: str = "", /) -> None:
            bar.update(
                row, total=1.0, completed=min(max(fraction, 0.0), 1.0), note=terminal_line(note)
            )

        yield tick


def part(tick: Tick, start_share: float, end_share: float) -> Tick:
    """Return the tick of a part of the work, which begins and ends at these fractions of the
    whole.
    """

    def tell(fraction: float, note: str = "", /) -> None:
        tick((1 - fraction) * start_share + fraction * end_share, note)

    return tell


@dataclass(frozen=True)
class Table:
    """A table that fits the console: heads and texts wrap first, then columns are left out, and
    named below it.

    Attributes
    ----------
    title : str
    columns : sequence of str
        Heads; the first column has the rows' names, which are always there and whole.
    rows : sequence of sequences
        As of :class:`cep.files.tables.Sheet`; None is shown as a dash.
    last_columns : int
        Columns at the end that are left out last.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    last_columns: int = 0

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Any]:
        """Render what fits."""
        from rich.box import SIMPLE_HEAD
        from rich.table import Table as RichTable
        from rich.text import Text

        from motdiff.files.inputs import printable

        texts = [[_shown_text(value) for value in row] for row in self.rows]
        columns, widths = self._fitted(texts, options.max_width)
        grid = RichTable(
            title=Text(printable(self.title)),
            title_justify="left",
            title_style="bold",
            box=SIMPLE_HEAD,
            pad_edge=False,
        )
        for index, width in zip(columns, widths, strict=True):
            justify: Any = "left" if index == 0 or _longest(texts, index) > _WIDE else "right"
            grid.add_column(
                Text(printable(self.columns[index])), justify=justify, width=width, overflow="fold"
            )
        for row in texts:
            grid.add_row(*(row[index] for index in columns))
        yield grid
        left_out = [
            printable(self.columns[index])
            for index in range(len(self.columns))
            if index not in columns
        ]
        if left_out:
            note = (
                f"left out, as {options.max_width} columns are too narrow: {'; '.join(left_out)}"
                " (all are in --json)"
            )
            yield Text(note)

    def _fitted(
        self, texts: Sequence[Sequence[Text]], available: int
    ) -> tuple[list[int], list[int]]:
        """Choose the columns shown and their widths."""
        cells = [_longest(texts, index) for index in range(len(self.columns))]
        natural = [max(cell, len(head)) for cell, head in zip(cells, self.columns, strict=True)]
        # a text may wrap to _WIDE characters; a figure broken over two lines would misread
        narrowest = [
            (
                min(width, _WIDE)
                if index == 0 or cell > _WIDE
                else max(cell, *map(len, head.split() or [""]))
            )
            for index, (width, cell, head) in enumerate(
                zip(natural, cells, self.columns, strict=True)
            )
        ]
        columns = list(range(len(self.columns)))
        while (
            len(columns) > 1
            and sum(narrowest[index] for index in columns) + _rules(len(columns)) > available
        ):
            columns.pop(-1 - self.last_columns if len(columns) > 1 + self.last_columns else -1)
        widths = [narrowest[index] for index in columns]
        spare = available - _rules(len(columns)) - sum(widths)
        for place, index in enumerate(columns):  # names first
            more = min(max(spare, 0), natural[index] - widths[place])
            widths[place] += more
            spare -= more
        return columns, widths


def table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], *, last_columns: int = 0
) -> Table:
    """Make a table: the first column is text, the others figures or texts; None is printed as a
    dash.
    """
    return Table(title, columns, rows, last_columns)


def photo_named(line: str, images: Sequence[Path]) -> str:
    """Return an error of several photos with the file's name for ``photo 2``; other errors as they
    are.

    Examples
    --------
    >>> photo_named("photo 2: is too small", [Path("one.png"), Path("two.png")])
    'two.png: is too small'
    """
    prefix = re.match(r"photo(?: (\d+))?: ", line)
    if prefix is None:
        return line
    return f"{images[int(prefix[1] or 1) - 1]}: {line[prefix.end() :]}"


def _shown_text(value: object) -> Text:
    """Write a cell as Rich's text."""
    from rich.text import Text

    from cep.files.tables import cell_parts
    from motdiff.files.inputs import printable

    return Text.assemble(
        *((printable(text), "bold" if bold else "") for text, bold in cell_parts(value))
    )


def _longest(texts: Sequence[Sequence[Text]], index: int) -> int:
    """Width of a column's widest cell."""
    return max((row[index].cell_len for row in texts), default=0)


def _rules(columns: int) -> int:
    """Characters around and between so many columns."""
    return 3 * columns - 1


def _ignore(_fraction: float, _note: str = "", /) -> None:
    """Report to nobody."""


def _line(text: str) -> None:
    from cep.files.foreign_text import terminal_line

    print(terminal_line(text), file=sys.stderr)  # noqa: T201 - the one place that writes to people's stderr


def _command_path(error: BaseException) -> str:
    context = getattr(error, "ctx", None)
    return str(context.command_path) if context is not None else "cep"
