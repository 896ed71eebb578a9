"""Tables as files: LaTeX with booktabs, CSV and Markdown, by the file's suffix."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cep.io.formatting import number
from cep.io.outputs import write_text

__all__ = [
    "TABLE_SUFFIXES", "Sheet", "cell_text", "check_table_name", "latex", "markdown", "markdown_table",
    "write_sheets",
]  # fmt: skip

TABLE_SUFFIXES = (".tex", ".csv", ".md")
_BOLD = re.compile(r"\[bold\](.*?)\[/bold\]", re.DOTALL)
_WIDE = 16  # characters: columns of longer texts stand to the left, those of figures to the right
_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
        "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "|": r"\textbar{}", "<": r"\textless{}",
        ">": r"\textgreater{}", '"': "''", "–": "--", "±": r"$\pm$", "×": r"$\times$", "²": r"$^2$",
        "µ": r"\textmu{}", "≤": r"$\le$", "≥": r"$\ge$", "→": r"$\to$", "…": r"\ldots{}",
    }
)  # fmt: skip
"""Characters that LaTeX reads as commands, or that its fonts lack or take for others."""


@dataclass(frozen=True)
class Sheet:
    """A table.

    Attributes
    ----------
    title : str
    columns : sequence of str
        Heads.
    rows : sequence of sequences
        Rich markup, numbers, and None where there is nothing. ``[bold]`` stays, other markup does not.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]


def cell_text(value: object) -> str:
    """Write a cell for people: markup as it is, numbers rounded, a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return number(value) if abs(value) < 1000 else f"{value:.1f}"
    return str(value)


def check_table_name(path: Path | str) -> None:
    """Check, before any work is done, that :func:`write_sheets` writes such files.

    Raises
    ------
    ValueError
        If the name has another suffix.
    """
    if Path(path).suffix.lower() not in TABLE_SUFFIXES:
        raise ValueError(f"{path}: tables are written as {', '.join(TABLE_SUFFIXES[:-1])} or {TABLE_SUFFIXES[-1]}")


def write_sheets(sheets: Sequence[Sheet], path: Path | str) -> None:
    """Write tables as .tex, .csv or .md, whole or not at all.

    Raises
    ------
    ValueError
        If the name has another suffix.
    """
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
    return "\n".join(["% \\usepackage{booktabs}", *map(_latex_table, sheets)]) + "\n"


def _latex_table(sheet: Sheet) -> str:
    rows = [[_latex_cell(cell_text(value)) for value in row] for row in sheet.rows]
    body = [" & ".join(row) + r" \\" for row in ([text.translate(_LATEX) for text in sheet.columns], *rows)]
    sides = "".join("l" if _is_text(sheet, index) else "r" for index in range(len(sheet.columns)))
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering",
            *([rf"  \caption{{{sheet.title.translate(_LATEX)}}}"] if sheet.title else []),
            rf"  \begin{{tabular}}{{{sides}}}",
            *(f"    {line}" for line in (r"\toprule", body[0], r"\midrule", *body[1:], r"\bottomrule")),
            r"  \end{tabular}",
            r"\end{table}",
        ]
    )


def _latex_cell(markup: str) -> str:
    return "".join(
        rf"\textbf{{{text.translate(_LATEX)}}}" if bold else text.translate(_LATEX) for text, bold in _parts(markup)
    )


def _csv(sheets: Sequence[Sheet]) -> str:
    """Lay out tables as CSV, numbers in full; several stand below their titles with an empty line between."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    for index, sheet in enumerate(sheets):
        if index:
            stream.write("\n")
        if len(sheets) > 1:
            writer.writerow([sheet.title])
        writer.writerow(sheet.columns)
        writer.writerows([_full(value) for value in row] for row in sheet.rows)
    return stream.getvalue()


def _full(value: object) -> Any:
    return _plain(value) if isinstance(value, str) else "" if value is None else value


def markdown(sheets: Sequence[Sheet]) -> str:
    """Lay out tables as Markdown, each below its title."""
    blocks = []
    for sheet in sheets:
        rows = [[_markdown_cell(cell_text(value)) for value in row] for row in sheet.rows]
        blocks.append((f"**{sheet.title}**\n\n" if sheet.title else "") + markdown_table(sheet.columns, rows) + "\n")
    return "\n".join(blocks)


def _markdown_cell(markup: str) -> str:
    return "".join(f"**{text}**" if bold else text for text, bold in _parts(markup))


def markdown_table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Lay out lines of texts as a Markdown table: the first column to the left, the others, figures, to the right."""
    rule = ("---", *("---:",) * (len(head) - 1))
    return "\n".join(
        "| " + " | ".join(text.replace("|", "\\|") for text in line) + " |" for line in (head, rule, *lines)
    )


def _is_text(sheet: Sheet, index: int) -> bool:
    """Whether a column holds names or texts."""
    return index == 0 or any(len(_plain(cell_text(row[index]))) > _WIDE for row in sheet.rows)


def _parts(markup: str) -> list[tuple[str, bool]]:
    """Split a cell into texts without markup, and whether each is bold."""
    return [(_plain(text), index % 2 == 1) for index, text in enumerate(_BOLD.split(markup)) if text]


def _plain(markup: str) -> str:
    """Return text without markup."""
    from rich.text import Text

    return Text.from_markup(markup).plain
