"""Summaries of rows: mean, spread and worst case per method, and calibration of the confidence."""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from motdiff.evaluation.measure import FIGURES, Row

__all__ = [
    "GOOD_MNC",
    "Bin",
    "Spread",
    "Summary",
    "calibration",
    "calibration_text",
    "csv_line",
    "summaries_csv",
    "summary_text",
    "summed_up",
]

GOOD_MNC = 0.7
"""An estimate is good from this sub-pixel MNC on: what ``confidence`` is the probability of."""

_EDGES = (0.0, 0.5, 0.8, 0.95, 1.0)
_COLUMNS = ("n", "failed", "MNC int", "sub-pixel", "sd", "min", "path MNC", "path px")
_MORE_COLUMNS = ("PSNR dB", "sd", "min", "SSIM", "conf", "CPU s")


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation (of the population) and least value of a figure; NaN when it was never measured."""

    mean: float
    sd: float
    min: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Spread:
        """Summarise the values that are not NaN."""
        known = np.array([value for value in values if not math.isnan(value)])
        if known.size == 0:
            return cls(math.nan, math.nan, math.nan)
        return cls(float(known.mean()), float(known.std()), float(known.min()))


@dataclass(frozen=True)
class Summary:
    """One line of a table.

    Attributes
    ----------
    set, method : str
    n : int
        Photos tried, with those that failed.
    failed : int
        Photos without an estimate; the figures leave them out.
    figures : mapping from the names in ``FIGURES`` to Spread
    """

    set: str
    method: str
    n: int
    failed: int
    figures: Mapping[str, Spread]


@dataclass(frozen=True)
class Bin:
    """Estimates with confidence in ``low..high``.

    Attributes
    ----------
    method : str
    low, high : float
    n : int
    said : float
        Mean confidence.
    good : float
        Share with a sub-pixel MNC of at least 0.7.
    """

    method: str
    low: float
    high: float
    n: int
    said: float
    good: float


def summed_up(rows: Iterable[Row]) -> list[Summary]:
    """Summarise per set and method, both in the order of their first row."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.set, row.method), []).append(row)
    in_order = sorted(groups, key=lambda key: list(dict.fromkeys(name for name, _ in groups)).index(key[0]))
    return [
        Summary(
            set_name,
            method,
            n=len(group),
            failed=sum(bool(row.failure) for row in group),
            figures={figure: Spread.of(_of_successes(group, figure)) for figure in FIGURES},
        )
        for set_name, method in in_order
        for group in (groups[set_name, method],)
    ]


def calibration(rows: Iterable[Row], *, edges: Sequence[float] = _EDGES) -> list[Bin]:
    """Compare confidence with the share of good estimates, in bins of confidence; empty bins are left out.

    Parameters
    ----------
    rows : iterable of Row
        Those without confidence (floors, failures) do not count.
    edges : sequence of float, increasing
        The last bin holds its upper edge.

    Raises
    ------
    ValueError
        If the edges do not increase.
    """
    if len(edges) < 2 or any(high <= low for low, high in itertools.pairwise(edges)):
        raise ValueError(f"edges: must be at least two increasing numbers, got {tuple(edges)}")
    methods: dict[str, list[Row]] = {}
    for row in rows:
        if not math.isnan(row.confidence):
            methods.setdefault(row.method, []).append(row)
    bins = []
    for method, group in methods.items():
        for low, high in itertools.pairwise(edges):
            inside = [r for r in group if low <= r.confidence < high or (high == edges[-1] == r.confidence)]
            if inside:
                said = float(np.mean([row.confidence for row in inside]))
                good = float(np.mean([row.mnc_subpixel >= GOOD_MNC for row in inside]))
                bins.append(Bin(method, low, high, len(inside), said, good))
    return bins


def summary_text(summaries: Sequence[Summary]) -> str:
    """Lay out one aligned table per set; the CSV has the spread of every figure, not of sub-pixel MNC and PSNR only."""
    blocks = []
    for set_name in dict.fromkeys(summary.set for summary in summaries):
        lines = [[set_name, *_COLUMNS, *_MORE_COLUMNS]]
        for summary in (summary for summary in summaries if summary.set == set_name):
            spread = summary.figures
            cells = [summary.method, str(summary.n), str(summary.failed)]
            cells += [_figure(spread["mnc"].mean), *_three(spread["mnc_subpixel"]), _figure(spread["path_mnc"].mean)]
            cells += [_figure(spread["path_px"].mean, 2), *_three(spread["psnr_db"], 2), _figure(spread["ssim"].mean)]
            lines.append([*cells, _figure(spread["confidence"].mean, 2), _figure(spread["cpu_s"].mean, 1)])
        blocks.append(_aligned(lines))
    return "\n\n".join(blocks)


def calibration_text(bins: Sequence[Bin]) -> str:
    """Lay out the bins as an aligned table."""
    lines = [["confidence", "from", "to", "n", "said", f"good (sub-pixel MNC >= {GOOD_MNC:g})"]]
    lines += [
        [b.method, _figure(b.low, 2), _figure(b.high, 2), str(b.n), _figure(b.said, 2), _figure(b.good, 2)]
        for b in bins
    ]
    return _aligned(lines)


def summaries_csv(summaries: Sequence[Summary]) -> str:
    """Write every figure's mean, sd and min as CSV with a header; empty where not measured."""
    text = csv_line(
        ["set", "method", "n", "failed"] + [f"{f}_{part}" for f in FIGURES for part in ("mean", "sd", "min")]
    )
    for summary in summaries:
        values: list[object] = [summary.set, summary.method, summary.n, summary.failed]
        for figure in FIGURES:
            spread = summary.figures[figure]
            values += [spread.mean, spread.sd, spread.min]
        text += csv_line(values)
    return text


def csv_line(values: Iterable[object]) -> str:
    """Write one line of CSV, NaN as an empty cell, numbers to six digits."""
    stream = io.StringIO()
    cells = (("" if math.isnan(value) else f"{value:.6g}") if isinstance(value, float) else value for value in values)
    csv.writer(stream, lineterminator="\n").writerow(cells)
    return stream.getvalue()


def _of_successes(rows: Sequence[Row], figure: str) -> list[float]:
    return [getattr(row, figure) for row in rows if not row.failure]


def _three(spread: Spread, digits: int = 3) -> list[str]:
    return [_figure(value, digits) for value in (spread.mean, spread.sd, spread.min)]


def _figure(value: float, digits: int = 3) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _aligned(lines: Sequence[Sequence[str]]) -> str:
    """First column to the left, the others to the right, two blanks between."""
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if i else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    )
