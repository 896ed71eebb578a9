"""Output of commands: JSON or a page on stdout; progress and warnings on stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.text import Text

    from motdiff.files.outputs import Outputs

_program = "cep"  # of lines on stderr, see lines_of()

FAILURE = 1
BAD_INPUT = 2  # as click and most Unix tools have it
INTERRUPTED = 130  # 128 + SIGINT, the shells' convention
_ROOMY = 100  # columns of a terminal that hold the bar, the elapsed time and a note
_WIDE = 16  # characters: longer cells are names or texts, which may wrap, but to no fewer


class Tick(Protocol):
    """Reports progress."""

    def __call__(self, fraction: float, note: str = "", /) -> None:
        """Say that ``fraction`` (0..1) of the work is done."""


@dataclass(frozen=True)
class Table:
    """A table that fits the console: texts wrap first, then columns are left out and named below.

    Attributes
    ----------
    title, columns, rows
        As of :class:`cep.files.tables.Sheet`, which a command may not import at its start.
    last_columns : int
        Columns at the end that are left out last. The first column has the rows' names, which are
        always there and whole.
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

        texts = [[_rich_cell(value) for value in row] for row in self.rows]
        cells = [
            max((row[i].cell_len for row in texts), default=0) for i, _ in enumerate(self.columns)
        ]
        widths = self._fitted(cells, options.max_width)
        grid = RichTable(
            title=Text(printable(self.title)),
            title_justify="left",
            title_style="bold",
            box=SIMPLE_HEAD,
            pad_edge=False,
        )
        for index, width in widths.items():
            is_text = index == 0 or cells[index] > _WIDE
            grid.add_column(
                Text(printable(self.columns[index])),
                justify="left" if is_text else "right",
                width=width,
                overflow="fold",  # the default would cut a long name with an ellipsis
            )
        for row in texts:
            grid.add_row(*(row[index] for index in widths))
        yield grid
        left_out = [
            printable(self.columns[i]) for i, _ in enumerate(self.columns) if i not in widths
        ]
        if left_out:
            yield Text(
                f"left out, as {options.max_width} columns are too narrow: {'; '.join(left_out)}"
                " (all are in --json)"
            )

    def _fitted(self, cells: Sequence[int], available: int) -> dict[int, int]:
        """Choose the columns shown and their widths, given the widest cell of each."""
        natural = [max(cell, len(head)) for cell, head in zip(cells, self.columns, strict=True)]
        narrowest = {}
        for index, (cell, head) in enumerate(zip(cells, self.columns, strict=True)):
            if index == 0 or cell > _WIDE:
                narrowest[index] = min(natural[index], _WIDE)
            else:  # a figure broken over two lines would misread, so only its head may wrap
                narrowest[index] = max(cell, *map(len, head.split() or [""]))
        columns = list(narrowest)
        while len(columns) > 1 and _grid_width(narrowest[i] for i in columns) > available:
            # before the last columns, or of these alone the last one, but never the names
            columns.pop(max(len(columns) - 1 - self.last_columns, 0) or -1)
        widths = {index: narrowest[index] for index in columns}
        spare = max(available - _grid_width(widths.values()), 0)
        for index in widths:  # from the left: names first
            more = min(spare, natural[index] - widths[index])
            widths[index] += more
            spare -= more
        return widths


Page = Iterable[str | Table]
"""What a command prints for people: lines and tables."""


def finish(
    result: Mapping[str, object],
    page: Page = (),
    *,
    as_json: bool,
    outputs: Outputs | None = None,
    save: Callable[[Mapping[Path, Path]], object] = lambda _staged: None,
    tables: Path | None = None,
    summary: str = "",
) -> None:
    """Write a command's outputs, all or none, and print its result as JSON or as a page.

    Parameters
    ----------
    result : mapping
        ``warnings``, where present, go to stderr for people.
    page : iterable of str and Table
    as_json : bool
    outputs : Outputs, optional
        Files to write.
    save : function, optional
        Writes them under temporary names: it is given the mapping of each file to its own.
    tables : Path, optional
        That of ``outputs`` for the page's tables, with all columns: .tex, .csv or .md.
    summary : str
        The result in one line, which the error says where the outputs cannot be written.
    """
    items = list(page)
    if outputs is not None:
        with outputs.written(summary=summary) as staged:
            if tables is not None:
                from cep.files.tables import Sheet, write_sheets

                sheets = [
                    Sheet(item.title, item.columns, item.rows)
                    for item in items
                    if isinstance(item, Table)
                ]
                write_sheets(sheets, staged[tables])
            save(staged)
    if as_json:
        from motdiff.files.json_files import json_text

        # a Windows console may be cp1252, in which json_text's other letters cannot be written
        encoding = (sys.stdout.encoding or "utf-8").lower().replace("_", "-")
        sys.stdout.write(json_text(result, ascii_only=not encoding.startswith("utf-8")))
        return
    if tables is not None:
        items.append(f"{tables}: the tables")
    print_page(items)
    warnings = result.get("warnings", ())
    assert isinstance(warnings, Sequence)
    for warning in warnings:
        warn(str(warning))


def print_page(items: Page) -> None:
    """Print lines and tables for people: texts are no markup, and control characters are shown."""
    from rich.console import Console
    from rich.text import Text

    from motdiff.files.inputs import printable

    console = Console(highlight=False, soft_wrap=True, markup=False, emoji=False)
    for item in items:
        console.print(Text(printable(item)) if isinstance(item, str) else item)


@contextmanager
def lines_of(program: str) -> Iterator[None]:
    """Let warnings and errors begin with the name of a program: ``cep`` or ``lab``."""
    global _program
    outer = _program
    _program = program
    try:
        yield
    finally:
        _program = outer


def printed_command(*words: object, **options: object) -> str:
    """Write a command that can be pasted; options that are None are left out.

    Examples
    --------
    >>> printed_command("cep", "deblur", "a b.png", code=["open", "c.json"], gamma=None, o="x.png")
    "cep deblur 'a b.png' --code open --code c.json -o x.png"
    """
    from shlex import join

    line = list(map(str, words))
    for name, value in options.items():
        flag = f"--{name}" if len(name) > 1 else f"-{name}"
        for item in value if isinstance(value, list) else [value]:
            if item is not None:
                line += [flag, str(item)]
    return join(line)


def warn(message: str) -> None:
    """Print one warning line on stderr."""
    announce(f"warning: {message}")


def announce(message: str) -> None:
    """Print one line on stderr: an error, or what is known already while the work goes on."""
    from cep.files.foreign_text import terminal_line

    line = terminal_line(f"{_program}: {message}")
    print(line, file=sys.stderr)  # noqa: T201 - the one place that writes to people's stderr


def end(*, missing: int, failed: int) -> None:
    """End a command of many parts, whose outputs are written, with the exit code of the run.

    Raises
    ------
    typer.Exit
        130 where Ctrl-C left parts out, else 1 where parts failed.
    """
    import typer

    # an interrupted run says so, whatever has failed before
    if missing:
        raise typer.Exit(INTERRUPTED)
    if failed:
        raise typer.Exit(FAILURE)


@contextmanager
def progress(task: str) -> Iterator[Tick]:
    """Show a bar with the time left on stderr, when stderr is a terminal.

    Parameters
    ----------
    task : str, what is being done
    """
    if not sys.stderr.isatty():
        yield lambda _fraction, _note="", /: None
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
    columns = [
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(min(max(console.width - _ROOMY, 10), 40)),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn(
            "{task.fields[note]}",
            markup=False,
            table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1),
        ),
    ]
    if console.width >= _ROOMY:
        columns[4:4] = [TextColumn("elapsed"), TimeElapsedColumn()]
    with Progress(*columns, console=console, transient=True, expand=True) as bar:
        row = bar.add_task(terminal_line(task), total=None, note="")

        def tick(fraction: float, note: str = "", /) -> None:
            share = min(max(fraction, 0.0), 1.0)
            bar.update(row, total=1.0, completed=share, note=terminal_line(note))

        yield tick


def part(tick: Tick, start_share: float, end_share: float) -> Tick:
    """Return the tick of a part of the work that begins and ends at these shares of the whole."""

    def tick_part(fraction: float, note: str = "", /) -> None:
        tick((1 - fraction) * start_share + fraction * end_share, note)

    return tick_part


def _rich_cell(value: object) -> Text:
    """Write a cell as Rich's text."""
    from rich.text import Text

    from cep.files.tables import cell_parts
    from motdiff.files.inputs import printable

    styles = ("", "bold")
    return Text.assemble(*((printable(text), styles[bold]) for text, bold in cell_parts(value)))


def _grid_width(widths: Iterable[int]) -> int:
    """Width of a table: Rich puts three characters between columns, and one at both ends."""
    return sum(width + 3 for width in widths) - 1
