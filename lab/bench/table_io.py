"""Benchmark tables as files: Markdown, LaTeX, CSV and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.files.tables import Sheet, csv_lines, latex, markdown
from cep.plots.canvas import undated
from lab.bench.tables import Table
from lab.jobs.cache import ENGINE
from motdiff.files.json_files import json_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


TABLES_SCHEMA = "cep.bench/1"
FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
"""What :func:`write_figure` writes."""
_PRINT_DPI = 300


def tables_markdown(tables: Sequence[Table]) -> str:
    """Lay out tables as Markdown; a row is bold where a paired test finds it better than the next
    one.
    """
    return markdown(_sheets(tables))


def tables_latex(tables: Sequence[Table]) -> str:
    """Lay out tables as LaTeX, see :func:`cep.files.tables.latex`; bold as in Markdown."""
    return latex(_sheets(tables))


def _sheets(tables: Sequence[Table]) -> list[Sheet]:
    return [Sheet(table.title, table.head, table.lines()) for table in tables]


def means_in_words(tables: Sequence[Table]) -> str:
    """Legend of tables; intervals and bold rows are explained only where there are some."""
    if not any(
        entry.finite_interval
        for table in tables
        for entries in table.rows.values()
        for entry in entries
    ):
        return (
            "Means. There are too few photos or motions for intervals, and for a paired test that"
            " would make the best bold."
        )
    return (
        "Means, and in brackets their 95 % intervals for other photos and other motions alike; the"
        " best is bold only where a paired test tells it from the next one."
    )


def machines_markdown(machines: Sequence[Mapping[str, Any]]) -> str:
    """Markdown list of the machines that made the figures: hardware, system and package
    versions.
    """
    lines = []
    for machine in machines:
        versions = ", ".join(
            f"{name} {version}" for name, version in machine["versions"].items() if version
        )
        memory = f", {machine['memory_gib']:g} GiB" if machine["memory_gib"] else ""
        lines.append(
            f"- {machine['processor']}, {machine['cores']} cores{memory}, {machine['system']},"
            f" Python {machine['python']}: {versions}"
        )
    return "\n".join(lines)


def tables_csv(tables: Sequence[Table]) -> str:
    """Lay out tables as CSV, a line per row and figure; empty where not measured."""
    statistics = ("mean", "low", "high", "median", "sd", "q05", "q95")
    rows: list[tuple[object, ...]] = [
        ("table", "row", "figure", "cells", "n", *statistics, "bold")
    ]
    for table in tables:
        for label, entries in table.rows.items():
            for entry, column in zip(entries, table.columns, strict=True):
                numbers = (asdict(entry.interval) if entry.interval else {}) | asdict(
                    entry.summary
                )
                texts = (number_text(numbers.get(name)) for name in statistics)
                start = (table.title, label, column.figure, table.cells[label], entry.summary.n)
                rows.append((*start, *texts, "yes" if entry.bold else "no"))
    return csv_lines(rows)


def number_text(number: float | None) -> str:
    """Write a number of a CSV file; empty where it was not measured."""
    return "" if number is None or math.isnan(number) else f"{number:.6g}"


@dataclass(frozen=True)
class Provenance:
    """How figures were made.

    Attributes
    ----------
    command : str
        Command that makes them again.
    seed : int
    machines : sequence of mapping
        As of :attr:`lab.jobs.engine.Outcome.machines`, with the versions used there.
    warnings : sequence of str
    """

    command: str
    seed: int
    machines: Sequence[Mapping[str, Any]]
    warnings: Sequence[str]


def tables_json(tables: Sequence[Table], provenance: Provenance) -> str:
    """Lay out tables as JSON (schema ``cep.bench/1``)."""
    content = [
        {
            "title": table.title,
            "columns": [asdict(column) for column in table.columns],
            "rows": [
                {
                    "row": label,
                    "cells": table.cells[label],
                    "counts": {head: numbers[label] for head, numbers in table.counts.items()},
                    "entries": [asdict(entry) for entry in entries],
                }
                for label, entries in table.rows.items()
            ],
        }
        for table in tables
    ]
    return made_json({"tables": content}, provenance)


def made_json(content: Mapping[str, Any], provenance: Provenance) -> str:
    """Lay out a table's content as JSON (schema ``cep.bench/1``)."""
    about = {
        "command": provenance.command,
        "seed": provenance.seed,
        "engine": ENGINE,
        "machines": provenance.machines,
        "warnings": provenance.warnings,
    }
    return json_text({"schema": TABLES_SCHEMA, **about, **content})


def write_figure(figure: Figure, folder: Path, stem: str) -> None:
    """Write ``STEM.png``, ``.pdf`` and ``.svg`` into a folder; the same figure gives the same
    bytes.

    Raises
    ------
    OSError
        If a file cannot be written, as on a full disk.
    """
    for suffix in FIGURE_SUFFIXES:
        (folder / f"{stem}{suffix}").write_bytes(undated(figure, suffix[1:], dpi=_PRINT_DPI))
