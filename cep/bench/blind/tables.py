"""The blind table and the speed table, from the figures of their cells."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence

import numpy as np

from cep.bench.blind.methods import OURS
from cep.bench.blind.work import CEILINGS
from cep.bench.cells import Figure
from cep.bench.tables import Column, Table, differences, tabulate

__all__ = ["blind_tables", "cells_csv", "speed_tables"]

Figures = Mapping[tuple[str, ...], Mapping[str, Figure]]

_QUALITY = (
    Column("mnc", "MNC", "high", 3),
    Column("mnc_subpixel", "sub-pixel MNC", "high", 3),
    Column("path_mnc", "path MNC", "high", 3),
    Column("psnr_db", "PSNR dB", "high", 2),
    Column("ssim", "SSIM", "high", 3),
)
_COST = (
    Column("cpu_s", "CPU-s", "low", 2),
    Column("wall_s", "s", None, 2),
    Column("memory_mib", "MiB", None, 0),
)
_OWN = ("confidence", "path_px")


def blind_tables(figures: Figures, lights: Sequence[str], *, title: str, seed: int) -> list[Table]:
    """Sum up per method: for each light level the methods, the ceilings apart, and what ours has over each method.

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
            plain = tuple(Column(column.figure, column.head, None, column.digits) for column in _QUALITY)
            tables.append(_table(f"{title}, {light}: kernels that know the truth", limits, plain, seed))
        ours = next((name for name in OURS if any(cell[0] == name for cell in here)), None)
        if ours is not None and len({name[0] for name in measured}) > 1:
            plain = tuple(Column(c.figure, c.head, None, c.digits) for c in (*_QUALITY, _COST[0]))
            tables.append(
                _table(f"{title}, {light}: {ours} less each, paired", differences(measured, ours), plain, seed)
            )
    return tables


def speed_tables(figures: Figures, *, title: str, seed: int) -> list[Table]:
    """Sum up what an estimate costs per method."""
    return [_table(title, figures, (*_COST, Column("mnc_subpixel", "sub-pixel MNC", None, 3)), seed)]


def cells_csv(figures: Figures, failures: Mapping[tuple[str, ...], str]) -> str:
    """Write every cell as a line of CSV; empty where not measured."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = [column.figure for column in (*_QUALITY, *_COST)] + list(_OWN)
    writer.writerow(("method", "photo", "motion", "light", *names, "failure"))
    for name, own in figures.items():
        values = (own.get(key) for key in names)
        texts = ("" if value is None else f"{value:.6g}" for value in values if not isinstance(value, str))
        writer.writerow((*name, *texts, failures.get(name, "")))
    return stream.getvalue()


def _table(title: str, figures: Figures, columns: Sequence[Column], seed: int) -> Table:
    # a column that no cell has, such as PSNR without a sharp photo, says nothing
    used = [column for column in columns if any(own.get(column.figure) is not None for own in figures.values())]
    # every photo has the same motions, so neither alone is evidence
    return tabulate(title, figures, used, rng=np.random.default_rng(seed), row=0, cluster=(1, 2))
