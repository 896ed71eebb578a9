"""Benchmark tables as files: Markdown, LaTeX, CSV and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.files.tables import Sheet, csv_lines, latex, markdown
from cep.jobs.cache import ENGINE
from cep.plots.canvas import undated
from lab.bench.tables import Table
from motdiff.files.json_files import json_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


TABLES_SCHEMA = "cep.bench/1"
FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
"""What :func:`write_figure` writes."""
_TABLE_ENDINGS = (".md", ".tex", ".csv", ".json")
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
            f"{name} {found}" for name, found in machine["versions"].items() if found
        )
        memory = f", {machine['memory_gib']:g} GiB" if machine["memory_gib"] else ""
        lines.append(
            f"- {machine['processor']}, {machine['cores']} cores{memory}, {machine['system']},"
            f" Python {machine['python']}: {versions}"
        )
    return "\n".join(lines)


def tables_csv(tables: Sequence[Table]) -> str:
    """Lay out tables as CSV, a line per row and figure; empty where not measured."""
    heads = (
        "table",
        "row",
        "figure",
        "cells",
        "n",
        "mean",
        "low",
        "high",
        "median",
        "sd",
        "q05",
        "q95",
        "bold",
    )
    rows: list[tuple[object, ...]] = [heads]
    for table in tables:
        for label, entries in table.rows.items():
            for entry, column in zip(entries, table.columns, strict=True):
                one = entry.summary
                ends = entry.interval
                numbers = (
                    one.mean,
                    *((ends.low, ends.high) if ends else (None, None)),
                    one.median,
                    one.sd,
                    one.q05,
                    one.q95,
                )
                texts = (
                    "" if number is None or math.isnan(number) else f"{number:.6g}"
                    for number in numbers
                )
                start = (table.title, label, column.figure, table.cells[label], one.n)
                rows.append((*start, *texts, "yes" if entry.bold else "no"))
    return csv_lines(rows)


def tables_json(
    tables: Sequence[Table],
    *,
    command: str,
    seed: int,
    machines: Sequence[Mapping[str, Any]],
    warnings: Sequence[str],
) -> str:
    """Lay out tables as JSON (schema ``cep.bench/1``) with command, seed, machines and warnings.

    Parameters
    ----------
    tables : sequence of Table
    command : str
        Command that reproduces them.
    seed : int
    machines : sequence of mapping
        As of :attr:`cep.jobs.engine.Outcome.machines`, with the versions used there.
    warnings : sequence of str
    """
    listed = [
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
    return made_json(
        {"tables": listed}, command=command, seed=seed, machines=machines, warnings=warnings
    )


def made_json(
    content: Mapping[str, Any],
    *,
    command: str,
    seed: int,
    machines: Sequence[Mapping[str, Any]],
    warnings: Sequence[str],
) -> str:
    """Lay out a table's content as JSON; the other parameters as those of :func:`tables_json`."""
    made = {
        "command": command,
        "seed": seed,
        "engine": ENGINE,
        "machines": machines,
        "warnings": warnings,
    }
    return json_text({"schema": TABLES_SCHEMA, **made, **content})


def report_files(name: str, cells: str) -> tuple[str, ...]:
    """Name the files of a report and its figure; ``cells`` ends the name of the file of single
    figures.
    """
    return (
        *(f"{name}{ending}" for ending in (*_TABLE_ENDINGS, cells)),
        *(f"{name}{suffix}" for suffix in FIGURE_SUFFIXES),
    )


def write_report_files(
    folder: Path,
    name: str,
    tables: Sequence[Table],
    *,
    text: str,
    cells: tuple[str, str],
    command: str,
    seed: int,
    machines: Sequence[Mapping[str, Any]],
    warnings: Sequence[str],
) -> tuple[str, ...]:
    """Write the texts of a report into a folder of its own, beside the figure that may be there.

    Parameters
    ----------
    folder : Path
    name : str
    tables : sequence of Table
    text : str
        Of the Markdown file.
    cells : (str, str)
        Ending of a further file's name, and its text.
    command, seed, machines, warnings
        As of :func:`tables_json`.

    Returns
    -------
    names of all files in the folder
    """
    about = tables_json(tables, command=command, seed=seed, machines=machines, warnings=warnings)
    texts = dict(
        zip(_TABLE_ENDINGS, (text, tables_latex(tables), tables_csv(tables), about), strict=True)
    )
    for ending, content in (texts | dict([cells])).items():
        (folder / f"{name}{ending}").write_text(content, encoding="utf-8", newline="")
    return tuple(sorted(item.name for item in folder.iterdir()))


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
