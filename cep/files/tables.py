"""Tables as files: LaTeX with booktabs, CSV and Markdown, by the file's suffix."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cep.files.foreign_text import csv_text, latex_text, markdown_text
from cep.files.formatting import number
from motdiff.files.outputs import write_text

_WIDE = 16  # characters: columns of longer texts stand to the left, those of figures to the right


@dataclass(frozen=True)
class Bold:
    """A cell: a bold text, then a plain one."""

    text: str
    plain: str = ""

    def __str__(self) -> str:
        return self.text + self.plain


@dataclass(frozen=True)
class Sheet:
    """A table: its title, the heads of its columns, and its rows.

    Attributes
    ----------
    rows : sequence of sequences
        Texts, :class:`Bold` ones, numbers, and None where there is nothing.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]


def cell_text(value: object) -> str:
    """Write a cell for people: numbers rounded, a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return number(value) if abs(value) < 1000 else f"{value:.1f}"
    return str(value)


def cell_parts(value: object) -> list[tuple[str, bool]]:
    """Split a cell into texts, and whether each is bold."""
    if isinstance(value, Bold):
        return [(text, bold) for text, bold in ((value.text, True), (value.plain, False)) if text]
    return [(cell_text(value), False)]


def check_table_name(path: Path | str) -> None:
    """Check, before any work is done, that :func:`write_sheets` writes such files."""
    if Path(path).suffix.lower() not in (".tex", ".csv", ".md"):
        raise ValueError(f"{path}: tables are written as .tex, .csv or .md")


def write_sheets(sheets: Sequence[Sheet], path: Path | str) -> None:
    """Write tables as .tex, .csv or .md, whole or not at all."""
    check_table_name(path)
    layout = {".tex": latex, ".csv": _csv, ".md": markdown}[Path(path).suffix.lower()]
    write_text(path, layout(sheets))


def latex(sheets: Sequence[Sheet]) -> str:
    r"""Lay out tables as LaTeX, each a ``table`` with rules of booktabs.

    Examples
    --------
    >>> print(latex([Sheet("R&D", ("code", "MTF"), [("a_1", 0.25), ("b", None)])]), end="")
    % \usepackage{booktabs}
    \begin{table}
      \centering
      \caption{R\&D}
      \begin{tabular}{lr}
        \toprule
        code & MTF \\
        \midrule
        a\_1 & 0.25 \\
        b & -- \\
        \bottomrule
      \end{tabular}
    \end{table}
    """
    # as a comment: the table goes into a document, whose preamble needs the package
    return "\n".join(["% \\usepackage{booktabs}", *map(_latex_table, sheets)]) + "\n"


def _latex_table(sheet: Sheet) -> str:
    rows = [
        [_cell(value, latex_text, r"\textbf{%s}") for value in row]
        for row in (sheet.columns, *sheet.rows)
    ]
    body = [" & ".join(row) + r" \\" for row in rows]
    sides = "".join("l" if _is_text(sheet, index) else "r" for index in range(len(sheet.columns)))
    caption = []
    if sheet.title:
        caption = [rf"  \caption{{{latex_text(sheet.title)}}}"]
    ruled = (r"\toprule", body[0], r"\midrule", *body[1:], r"\bottomrule")
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering",
            *caption,
            rf"  \begin{{tabular}}{{{sides}}}",
            *(f"    {line}" for line in ruled),
            r"  \end{tabular}",
            r"\end{table}",
        ]
    )


def _csv(sheets: Sequence[Sheet]) -> str:
    """Lay out tables as CSV, numbers in full; several are titled, with empty lines between."""
    titles: list[list[list[str]]] = [[] for _ in sheets]  # of one table the file is, a plain CSV
    if len(sheets) > 1:
        titles = [[[sheet.title]] for sheet in sheets]
    return "\n".join(
        csv_lines([*title, sheet.columns, *sheet.rows])
        for title, sheet in zip(titles, sheets, strict=True)
    )


def csv_lines(rows: Iterable[Iterable[object]]) -> str:
    """Lay out rows as CSV: texts by :func:`cep.files.foreign_text.csv_text`, nothing for None."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(
        [csv_text(str(value)) if isinstance(value, str | Bold) else value for value in row]
        for row in rows
    )
    return stream.getvalue()


def markdown(sheets: Sequence[Sheet]) -> str:
    """Lay out tables as Markdown, each below its title."""
    blocks = []
    for sheet in sheets:
        if sheet.title:
            blocks.append(f"**{markdown_text(sheet.title)}**\n")
        blocks.append(markdown_table(sheet.columns, sheet.rows) + "\n")
    return "\n".join(blocks)


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Lay out cells as a Markdown table: the first column to the left, figures to the right."""
    lines = [[_cell(value, markdown_text, "**%s**") for value in row] for row in (head, *rows)]
    rule = ("---", *("---:",) * (len(head) - 1))
    return "\n".join("| " + " | ".join(line) + " |" for line in (lines[0], rule, *lines[1:]))


def _cell(value: object, escaped: Callable[[str], str], bold: str) -> str:
    """Write a cell in a language: its texts escaped, bold ones put into ``bold``."""
    texts = ((escaped(text), is_bold) for text, is_bold in cell_parts(value))
    return "".join(bold % text if is_bold else text for text, is_bold in texts)


def _is_text(sheet: Sheet, index: int) -> bool:
    """Whether a column holds names or texts."""
    return index == 0 or any(len(cell_text(row[index])) > _WIDE for row in sheet.rows)
