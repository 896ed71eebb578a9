"""The harness of every benchmark table: plan it, measure it, write its report."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.files.foreign_text import markdown_text
from lab.bench.table_io import (
    FIGURE_SUFFIXES,
    Provenance,
    tables_csv,
    tables_json,
    tables_latex,
    tables_markdown,
    write_figure,
)
from lab.bench.tables import Table, TextTable
from lab.jobs.engine import Engine, Outcome
from motdiff.files.inputs import printable
from motdiff.files.outputs import claim_folder, new_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[float, str], None]
"""Called with the fraction done and a note."""

TABLE_ENDINGS = (".md", ".tex", ".csv", ".json")


@dataclass(frozen=True)
class Request:
    """Options of every table.

    Attributes
    ----------
    output : Path
        Folder to write into.
    engine : Engine
    data : Path, optional
        Folder of photos; those that scikit-image carries when None.
    quick : bool
        The protocol's small size.
    force : bool
        Whether existing files may be replaced.
    """

    output: Path
    engine: Engine
    data: Path | None = None
    quick: bool = False
    force: bool = False

    def claim(self, files: Sequence[str]) -> None:
        """Refuse files that are in the way, before any photo is read.

        Raises
        ------
        ValueError
            If one exists and may not be replaced.
        """
        claim_folder(self.output, files, force=self.force)

    def command(self, table: str, options: Mapping[str, object]) -> str:
        """Spell the command that makes a table again, without anybody's folders.

        Parameters
        ----------
        table : str
        options : mapping from an option, empty for arguments, to its value
            Empty values are left out.
        """
        values = {"--data": self.data and self.data.resolve().name, **options}
        words = [f"{option} {value}".strip() for option, value in values.items() if value]
        quick = ["--quick"] if self.quick else []
        return " ".join(filter(None, ["python -m lab bench", table, *words, *quick]))


@dataclass(frozen=True)
class Report:
    """A measured table.

    Attributes
    ----------
    title : str
    provenance : Provenance
    outcome : Outcome
    tables : mapping from a table's title to its figures, ready for JSON
    shown : sequence of Table or TextTable
        The same for people.
    summary : str
        Its first figures, Markdown.
    texts : mapping from the ending of a file's name to its content
    figure : Figure, optional
    files : mapping from a file's name to its path
        Once written.
    """

    title: str
    provenance: Provenance
    outcome: Outcome
    tables: Mapping[str, Any]
    shown: Sequence[Table | TextTable]
    summary: str
    texts: Mapping[str, str]
    figure: Figure | None = None
    files: Mapping[str, Path] = field(default_factory=dict)


def file_names(name: str, cells: str) -> tuple[str, ...]:
    """Name the files of a table of means, with its figure; ``cells`` ends the name of the file of
    single figures.
    """
    return tuple(sorted(name + ending for ending in (*TABLE_ENDINGS, cells, *FIGURE_SUFFIXES)))


@dataclass(frozen=True)
class Job:
    """A table whose options and inputs are checked, and which is not yet measured.

    Attributes
    ----------
    request : Request
    files : tuple of str
        Of :func:`file_names`; those of an earlier run that are not written now are removed.
    about : mapping
        Options, for the JSON.
    measure : function
    """

    request: Request
    files: tuple[str, ...]
    about: Mapping[str, object]
    measure: Callable[[Progress], Report]

    def run(self, progress: Progress) -> Report:
        """Measure the table and write its report: all files or none.

        Raises
        ------
        ValueError
            If a file exists and may not be replaced.
        OSError
            If one cannot be written, as on a full disk.
        """
        report = self.measure(progress)
        folder = self.request.output
        name = next(Path(file).stem for file in self.files if file.endswith(".md"))
        with new_folder(folder, self.files, force=self.request.force) as unfinished:
            for ending, text in report.texts.items():
                (unfinished / f"{name}{ending}").write_text(text, encoding="utf-8", newline="")
            if report.figure is not None:
                write_figure(report.figure, unfinished, name)
            names = [item for item in self.files if (unfinished / item).exists()]
        return replace(report, files={item: folder / item for item in names})


def report_of_means(
    title: str,
    tables: Sequence[Table],
    *,
    provenance: Provenance,
    outcome: Outcome,
    introduction: Sequence[str],
    below: str = "",
    cells: tuple[str, str],
    figure: Figure | None = None,
) -> Report:
    """Lay out tables of means as a report.

    Parameters
    ----------
    title : str
    tables : sequence of Table
        The first is the summary.
    provenance : Provenance
    outcome : Outcome
    introduction : sequence of str
        Lines of Markdown above the tables.
    below : str
        Markdown below them.
    cells : (str, str)
        Ending of the name of the file of single figures, and its text.
    figure : Figure, optional
    """
    markdown = "\n".join([*introduction, "", ""]) + tables_markdown(tables) + below
    texts = (markdown, tables_latex(tables), tables_csv(tables), tables_json(tables, provenance))
    return Report(
        title,
        provenance,
        outcome,
        {table.title: _figures(table) for table in tables},
        tables,
        tables_markdown(tables[:1]) or "Nothing was measured.\n",
        dict(zip(TABLE_ENDINGS, texts, strict=True)) | dict([cells]),
        figure,
    )


def _figures(table: Table) -> dict[str, Any]:
    """Figures of a table for JSON, by row and figure."""
    return {
        label: {
            column.figure: {
                "n": entry.summary.n,
                "mean": entry.summary.mean,
                "median": entry.summary.median,
                "interval": entry.interval and (entry.interval.low, entry.interval.high),
                "bold": entry.bold,
            }
            for column, entry in zip(table.columns, entries, strict=True)
        }
        for label, entries in table.rows.items()
    }


def outcome_warnings(outcome: Outcome) -> list[str]:
    """List the warnings about a run: unusable cells on disk, failed and missing cells."""
    warnings = list(outcome.warnings)
    if outcome.failures:
        label, reason = next(iter(outcome.reasons.items()))
        count = len(outcome.failures)
        total = len(outcome.results)
        warnings.append(f"{count} of {total} cells failed, the first: {label}: {reason}")
    if outcome.missing:
        warnings.append(
            f"stopped early: {outcome.missing} cells are left out; the same command with --force"
            " goes on"
        )
    return warnings


def warning_lines(warnings: Sequence[str]) -> list[str]:
    """Lines of Markdown, one item per warning."""
    return [f"\n- {markdown_text(warning)}" for warning in warnings]


def in_code_span(text: str) -> str:
    """Write a text in Markdown as code, between more backticks than it has.

    Examples
    --------
    >>> in_code_span("cep mtf"), in_code_span("a`b")
    ('`cep mtf`', '`` a`b ``')
    """
    visible = printable(text)
    longest = max(map(len, re.findall("`+", visible)), default=0)
    if longest == 0:
        return f"`{visible}`"
    fence = "`" * (longest + 1)
    return f"{fence} {visible} {fence}"
