"""Report of a blind or speed table: Markdown, CSV and JSON tables, every cell, and a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cep.files.foreign_text import markdown_text
from cep.files.tables import csv_lines
from lab.bench.blind.cells import CEILINGS
from lab.bench.blind.methods import OURS
from lab.bench.blind.picture import blind_figure, shown
from lab.bench.blind.plan import Plan
from lab.bench.harness import Report, in_code_span, report_of_means, warning_lines
from lab.bench.table_io import Provenance, means_in_words, number_text
from lab.bench.tables import Column, Table, differences, tabulate, unranked
from lab.evaluation.measure import RESTORATION
from lab.jobs.cells import Figure
from lab.jobs.engine import Outcome

CELLS = "-cells.csv"
"""Ending of the name of the file of single figures."""
_RESTORED = (
    f"PSNR and SSIM are those of the photo's luminance restored, up to shift, by {RESTORATION}.",
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
_UNSHOWN = ("confidence", "path_px")


def blind_report(
    name: str,
    title: str,
    tables: Sequence[Table],
    *,
    plan: Plan,
    outcome: Outcome,
    provenance: Provenance,
    pictured: Sequence[str] = (),
    unmeasured: Mapping[str, str] | None = None,
) -> Report:
    """Lay out a table of estimators, with a figure where methods are pictured.

    Parameters
    ----------
    name : str
        Of its files.
    title : str
    tables : sequence of Table
    plan : Plan
    outcome : Outcome
    provenance : Provenance
        With all warnings, the plan's included.
    pictured : sequence of methods
    unmeasured : mapping from method to reason
        Listed in the report, with the methods of which every cell failed.
    """
    below = "".join(
        f"\n{markdown_text(method)} is not measured: {markdown_text(reason)}.\n"
        for method, reason in {**(unmeasured or {}), **_failed(outcome)}.items()
    )
    figure = None
    if pictured and (rows := shown(outcome.results, methods=pictured)):
        figure = blind_figure(rows, pictured)
        below += f"\n![photos, kernels and what each method restores]({name}.png)\n"
    return report_of_means(
        title,
        tables,
        provenance=provenance,
        outcome=outcome,
        introduction=_introduction(name, plan, tables, provenance),
        below=below,
        cells=(CELLS, cells_csv(outcome.figures, outcome.failures)),
        figure=figure,
    )


def _introduction(
    name: str, plan: Plan, tables: Sequence[Table], provenance: Provenance
) -> list[str]:
    machines = "; ".join(_machine_text(machine) for machine in provenance.machines)
    restored = any(column.figure == "psnr_db" for table in tables for column in table.columns)
    return [
        f"# The {name} table",
        "",
        (
            f"Made by {in_code_span(provenance.command)},"
            f" protocol {in_code_span(plan.protocol.name)}, seed {plan.protocol.seed}, on"
        ),
        f"{machines or 'no machine'}.",
        f"{_counts(plan)}.",
        means_in_words(tables),
        *(_RESTORED if restored else ()),
        *warning_lines(provenance.warnings),
    ]


def _counts(plan: Plan) -> str:
    """Count photos and motions; a folder may hold fewer than the protocol asks for."""
    names = [cell.name for cell in plan.cells]
    photos = len({photo for _, photo, _, _ in names})
    motions = len({motion for _, _, motion, _ in names})
    pairs = len({name[1:3] for name in names})
    if not any("motion" in cell.arguments for cell in plan.cells):
        return f"{_number(pairs, 'photo')} with real blur, of {_number(photos, 'scene')}"
    if pairs == photos * motions:
        return f"{_number(photos, 'photo')}, each with {_number(motions, 'motion')}"
    return f"{_number(photos, 'photo')}, {_number(motions, 'motion')}, {pairs} pairs of them"


def _number(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _failed(outcome: Outcome) -> dict[str, str]:
    """Return a reason for each method without a single figure."""
    measured = {name[0] for name, figures in outcome.figures.items() if figures}
    return {
        name[0]: reason for name, reason in outcome.failures.items() if name[0] not in measured
    }


def _machine_text(machine: Mapping[str, Any]) -> str:
    versions = machine["versions"]
    packages = ", ".join(
        f"{package} {versions[package]}" for package in ("numpy", "torch") if versions.get(package)
    )
    return (
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, {packages}"
    )


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
    quality = (*_QUALITY, _COST[0])
    for light in lights:
        at_light = {name: cell for name, cell in figures.items() if name[3] == light}
        measured = {name: cell for name, cell in at_light.items() if name[0] not in CEILINGS}
        limits = {name: cell for name, cell in at_light.items() if name[0] in CEILINGS}
        draws = {name: cell for name, cell in measured.items() if cell.get("covered") is not None}
        head = f"{title}, {light}"
        tables.append(_table(head, measured, quality, seed))
        if limits:
            limit_head = f"{head}: kernels that know the truth"
            tables.append(_table(limit_head, limits, unranked(_QUALITY), seed))
        if draws:
            tables.append(_table(f"{head}: several draws of each photo", draws, _DRAWS, seed))
        methods = {name[0] for name in measured}
        ours = next((name for name in OURS if name in methods), None)
        if ours is not None and len(methods) > 1:
            paired = f"{head}: {ours} less each, paired"
            tables.append(_table(paired, differences(measured, ours), unranked(quality), seed))
    return tables


def speed_tables(figures: Figures, *, title: str, seed: int) -> list[Table]:
    """Summarise the cost of an estimate per method."""
    return [
        _table(title, figures, (*_COST, Column("mnc_subpixel", "sub-pixel MNC", None, 3)), seed)
    ]


def cells_csv(figures: Figures, failures: Mapping[tuple[str, ...], str]) -> str:
    """Write every cell as a line of CSV; empty where not measured."""
    names = [column.figure for column in (*_QUALITY, *_COST, *_DRAWS)] + list(_UNSHOWN)
    rows = [("method", "photo", "motion", "light", *names, "failure")]
    for name, cell_figures in figures.items():
        values = (cell_figures.get(key) for key in names)
        texts = (number_text(value) for value in values if not isinstance(value, str))
        rows.append((*name, *texts, failures.get(name, "")))
    return csv_lines(rows)


def _table(title: str, figures: Figures, columns: Sequence[Column], seed: int) -> Table:
    # leave out a column that no cell has, such as PSNR without a sharp photo
    used_columns = [
        column
        for column in columns
        if any(cell.get(column.figure) is not None for cell in figures.values())
    ]
    # every photo has the same motions: cluster by both
    return tabulate(title, figures, used_columns, rng=np.random.default_rng(seed), cluster=(1, 2))
