"""Report of a blind or speed table: Markdown, CSV and JSON tables, every cell, and a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cep.files.foreign_text import in_code_span, markdown_text
from cep.files.tables import csv_lines
from cep.jobs.cells import Figure
from cep.jobs.engine import Outcome
from lab.bench.blind.methods import OURS
from lab.bench.blind.picture import blind_figure, shown
from lab.bench.blind.run import Plan
from lab.bench.blind.work import CEILINGS
from lab.bench.table_io import (
    means_in_words,
    report_files,
    tables_markdown,
    write_figure,
    write_report_files,
)
from lab.bench.tables import Column, Table, differences, tabulate
from lab.evaluation.measure import RESTORATION
from motdiff.files.outputs import new_folder

_CELLS = "-cells.csv"
_RESTORED = (
    f"PSNR and SSIM are those of the photo's luminance restored, up to shift, by {RESTORATION}.",
)


def outputs(name: str) -> tuple[str, ...]:
    """Files of the table ``name``."""
    return report_files(name, _CELLS)


def write_report(
    folder: Path,
    name: str,
    tables: Sequence[Table],
    *,
    plan: Plan,
    outcome: Outcome,
    command: str,
    warnings: Sequence[str],
    pictured: Sequence[str] = (),
    unmeasured: Mapping[str, str] | None = None,
    force: bool = False,
) -> dict[str, Path]:
    """Write NAME.md .tex .csv .json, NAME-cells.csv, and NAME.png .pdf .svg where methods are
    pictured; all or none.

    Parameters
    ----------
    folder : Path, made where it is missing
    name : str
    tables : sequence of Table
    plan : Plan
    outcome : Outcome
    command : str
        Command that reproduces them.
    warnings : sequence of str
        All warnings, the plan's included.
    pictured : sequence of methods
    unmeasured : mapping from method to reason
        Listed in the report, with the methods of which every cell failed.
    force : bool
        Whether existing files may be replaced.

    Returns
    -------
    dict from a file's name to its path

    Raises
    ------
    ValueError
        If a file exists and ``force`` is not given.
    OSError
        If one cannot be written.
    """
    lines = shown(outcome.results, methods=pictured) if pictured else []
    with new_folder(folder, outputs(name), force=force) as made:
        text = _introduction(name, plan, outcome, tables, command, warnings) + tables_markdown(
            tables
        )
        absent = {**(unmeasured or {}), **_failed(outcome)}
        text += "".join(
            f"\n{markdown_text(method)} is not measured: {markdown_text(reason)}.\n"
            for method, reason in absent.items()
        )
        if lines:
            write_figure(blind_figure(lines, pictured), made, name)
            text += f"\n![photos, kernels and what each method restores]({name}.png)\n"
        names = write_report_files(
            made,
            name,
            tables,
            text=text,
            cells=(_CELLS, cells_csv(outcome.figures, outcome.failures)),
            command=command,
            seed=plan.protocol.seed,
            machines=outcome.machines,
            warnings=warnings,
        )
    return {item: folder / item for item in names}


def _introduction(
    name: str,
    plan: Plan,
    outcome: Outcome,
    tables: Sequence[Table],
    command: str,
    warnings: Sequence[str],
) -> str:
    machines = "; ".join(_in_words(machine) for machine in outcome.machines)
    restored = any(column.figure == "psnr_db" for table in tables for column in table.columns)
    head = [
        f"# The {name} table",
        "",
        (
            f"Made by {in_code_span(command)}, protocol {in_code_span(plan.protocol.name)}, seed"
            f" {plan.protocol.seed}, on"
        ),
        f"{machines or 'no machine'}.",
        f"{_counts(plan)}.",
        means_in_words(tables),
        *(_RESTORED if restored else ()),
        *(f"\n- {markdown_text(warning)}" for warning in warnings),
        "",
        "",
    ]
    return "\n".join(head)


def _counts(plan: Plan) -> str:
    """Count photos and motions; a folder may hold fewer than the protocol asks for."""
    photos, motions, taken = (
        len({cell.name[place] for cell in plan.cells}) for place in (1, 2, slice(1, 3))
    )
    if not any("motion" in cell.arguments for cell in plan.cells):
        return f"{_number(taken, 'photo')} with real blur, of {_number(photos, 'scene')}"
    if taken == photos * motions:
        return f"{_number(photos, 'photo')}, each with {_number(motions, 'motion')}"
    return f"{_number(photos, 'photo')}, {_number(motions, 'motion')}, {taken} pairs of them"


def _number(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _failed(outcome: Outcome) -> dict[str, str]:
    """Return a reason for each method without a single figure."""
    measured = {name[0] for name, own in outcome.figures.items() if own}
    return {
        name[0]: reason for name, reason in outcome.failures.items() if name[0] not in measured
    }


def _in_words(machine: Mapping[str, Any]) -> str:
    versions = machine["versions"]
    packages = ", ".join(
        f"{package} {versions[package]}" for package in ("numpy", "torch") if versions.get(package)
    )
    return (
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, {packages}"
    )


Figures = Mapping[tuple[str, ...], Mapping[str, Figure]]

_QUALITY = (
    Column("mnc", "MNC", "high", 3),
    Column("mnc_subpixel", "sub-pixel MNC", "high", 3),
    Column("path_mnc", "path MNC", "high", 3),
    Column("psnr_db", "PSNR dB", "high", 2),
    Column("ssim", "SSIM", "high", 3),
)
_DRAWS = (
    Column("best_draw", "best draw MNC", None, 3),
    Column("draws_alike", "MNC of two draws", None, 3),
    Column("covered", "truth among draws", None, 2, "share"),
)
_COST = (
    Column("cpu_s", "CPU-s", "low", 2),
    Column("wall_s", "s", None, 2),
    Column("memory_mib", "MiB", None, 0),
)
_OWN = ("confidence", "path_px")


def blind_tables(figures: Figures, lights: Sequence[str], *, title: str, seed: int) -> list[Table]:
    """Summarise per method: for each light level the methods, the ceilings, and the lead of ours
    over each method.

    Parameters
    ----------
    figures : mapping from (method, photo, motion, light) to figures
    lights : sequence of str
    title : str
    seed : int
        Of the bootstrap.
    """
    tables = []
    for light in lights:
        here = {name: own for name, own in figures.items() if name[3] == light}
        measured = {name: own for name, own in here.items() if name[0] not in CEILINGS}
        limits = {name: own for name, own in here.items() if name[0] in CEILINGS}
        tables.append(_table(f"{title}, {light}", measured, (*_QUALITY, _COST[0]), seed))
        if limits:
            plain = tuple(
                Column(column.figure, column.head, None, column.digits) for column in _QUALITY
            )
            tables.append(
                _table(f"{title}, {light}: kernels that know the truth", limits, plain, seed)
            )
        if drawn := {
            name: own for name, own in measured.items() if own.get("covered") is not None
        }:
            tables.append(
                _table(f"{title}, {light}: several draws of each photo", drawn, _DRAWS, seed)
            )
        ours = next((name for name in OURS if any(cell[0] == name for cell in here)), None)
        if ours is not None and len({name[0] for name in measured}) > 1:
            plain = tuple(Column(c.figure, c.head, None, c.digits) for c in (*_QUALITY, _COST[0]))
            tables.append(
                _table(
                    f"{title}, {light}: {ours} less each, paired",
                    differences(measured, ours),
                    plain,
                    seed,
                )
            )
    return tables


def speed_tables(figures: Figures, *, title: str, seed: int) -> list[Table]:
    """Summarise the cost of an estimate per method."""
    return [
        _table(title, figures, (*_COST, Column("mnc_subpixel", "sub-pixel MNC", None, 3)), seed)
    ]


def cells_csv(figures: Figures, failures: Mapping[tuple[str, ...], str]) -> str:
    """Write every cell as a line of CSV; empty where not measured."""
    names = [column.figure for column in (*_QUALITY, *_COST, *_DRAWS)] + list(_OWN)
    rows = [("method", "photo", "motion", "light", *names, "failure")]
    for name, own in figures.items():
        values = (own.get(key) for key in names)
        texts = (
            "" if value is None else f"{value:.6g}"
            for value in values
            if not isinstance(value, str)
        )
        rows.append((*name, *texts, failures.get(name, "")))
    return csv_lines(rows)


def _table(title: str, figures: Figures, columns: Sequence[Column], seed: int) -> Table:
    # leave out a column that no cell has, such as PSNR without a sharp photo
    used = [
        column
        for column in columns
        if any(own.get(column.figure) is not None for own in figures.values())
    ]
    # every photo has the same motions: cluster by both
    return tabulate(title, figures, used, rng=np.random.default_rng(seed), row=0, cluster=(1, 2))
