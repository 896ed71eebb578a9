"""Benchmark tables: mean and interval per row and figure; the best row is bold if a paired test
confirms it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from cep.files.tables import Bold
from lab.bench.statistics import Interval, Summary, crossed_interval, mean_interval, summarized
from lab.jobs.cells import Figure

Name = tuple[str, ...]
Figures = Mapping[Name, Mapping[str, Figure]]
"""Figures by name of the cell, as of :attr:`lab.jobs.engine.Outcome.figures`."""


@dataclass(frozen=True)
class Column:
    """A figure to show.

    Attributes
    ----------
    figure : str
        Its key in the figures of a cell.
    head : str
        Column heading, with the unit.
    better : "high", "low" or None
        Which row may be bold; None: no row.
    digits : int
        Decimals.
    middle : {"mean", "median", "share"}
        Statistic shown. The median where some cells are infinite, the share of cells where they
        are 0 or 1; these have no interval and are never bold.
    """

    figure: str
    head: str
    better: Literal["high", "low"] | None = None
    digits: int = 2
    middle: Literal["mean", "median", "share"] = "mean"

    def shown(self, entry: Entry) -> float:
        """Return the figure of a row that is shown."""
        return entry.summary.median if self.middle == "median" else entry.summary.mean


def unranked(columns: Sequence[Column]) -> tuple[Column, ...]:
    """Return the same columns, in which no row may be bold."""
    return tuple(replace(column, better=None) for column in columns)


@dataclass(frozen=True)
class Entry:
    """A figure of a row.

    Attributes
    ----------
    summary : Summary
        Of the cells that have the figure.
    interval : Interval or None
        Of the mean; None where nothing finite was measured.
    lead : Interval or None
        The best row's: of its paired differences from the runner-up, above 0 where it is better.
    runner_up : str
    bold : bool
        Whether the lead's interval lies above 0 and no cell of the runner-up's is missing in this
        row.
    """

    summary: Summary
    interval: Interval | None
    lead: Interval | None = None
    runner_up: str = ""
    bold: bool = False

    @property
    def finite_interval(self) -> Interval | None:
        """The interval if it is finite; that of one or two photos or motions is infinite."""
        return (
            self.interval
            if self.interval is not None and math.isfinite(self.interval.high)
            else None
        )


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    title : str
    columns : tuple of Column
    rows : mapping from the row's label to an Entry per column
    cells : mapping from the row's label to the number of its cells
    counts : mapping from a heading to such a mapping
        Numbers of different labels among the cells, such as motions.
    """

    title: str
    columns: tuple[Column, ...]
    rows: Mapping[str, tuple[Entry, ...]]
    cells: Mapping[str, int]
    counts: Mapping[str, Mapping[str, int]] = field(default_factory=dict)

    @property
    def head(self) -> tuple[str, ...]:
        """Headings of the columns."""
        return ("", *(column.head for column in self.columns), "n", *self.counts)

    def sizes(self, label: str) -> tuple[int, ...]:
        """Return how many cells a row has, and of :attr:`counts`."""
        return (self.cells[label], *(numbers[label] for numbers in self.counts.values()))

    def lines(self) -> list[tuple[str | Bold, ...]]:
        """Lay out the rows: mean and its interval, and how many cells have the figure where some
        do not.
        """
        return [
            (
                label,
                *(
                    _in_words(entry, column, self.cells[label])
                    for entry, column in zip(entries, self.columns, strict=True)
                ),
                *map(str, self.sizes(label)),
            )
            for label, entries in self.rows.items()
        ]


@dataclass(frozen=True)
class TextTable:
    """A table of texts, without means.

    Attributes
    ----------
    title : str
    head : tuple of str
    lines : sequence of tuple of str
    note : str
        Line below it.
    """

    title: str
    head: tuple[str, ...]
    lines: Sequence[tuple[str, ...]]
    note: str


def tabulate(
    title: str,
    figures: Figures,
    columns: Sequence[Column],
    *,
    rng: np.random.Generator,
    cluster: int | tuple[int, int] = 1,
    counted: Mapping[str, int] | None = None,
) -> Table:
    """Sum up figures by the first label of the cells' names; cells whose other labels agree are
    pairs.

    Parameters
    ----------
    title : str
    figures : mapping from the names of cells
    columns : sequence of Column
    rng : numpy.random.Generator
        Of the bootstrap.
    cluster : int or (int, int)
        Label that dependent cells share, such as the photo. Two labels where every photo has the
        same motions.
    counted : mapping from a heading to a label, optional
        How many different ones a row's cells have is shown, such as motions.

    Raises
    ------
    ValueError
        If a name has too few labels, or a column has a value that is no number.
    """
    shared = (cluster,) if isinstance(cluster, int) else cluster
    for name in figures:
        if not all(0 < label < len(name) for label in shared):
            raise ValueError(f"figures: label {cluster} is wanted of every name, got {name}")
    labels = list(dict.fromkeys(name[0] for name in figures))
    cells_by_label: dict[str, list[Entry]] = {label: [] for label in labels}
    for column in columns:
        by_row = {label: _values(figures, column.figure, label) for label in labels}
        entries = {}
        for label, values in by_row.items():
            interval = None
            if values and column.middle == "mean" and all(map(math.isfinite, values.values())):
                interval = _interval(values, shared, rng)
            entries[label] = Entry(summarized(values.values()), interval)
        if column.better is not None and column.middle == "mean":
            entries |= _best(by_row, entries, column.better, shared, rng)
        for label in labels:
            cells_by_label[label].append(entries[label])
    rows = {label: tuple(entries_) for label, entries_ in cells_by_label.items()}
    cells = {label: [name for name in figures if name[0] == label] for label in labels}
    counts = {
        head: {label: len({name[place] for name in names}) for label, names in cells.items()}
        for head, place in (counted or {}).items()
    }
    return Table(
        title, tuple(columns), rows, {label: len(names) for label, names in cells.items()}, counts
    )


def differences(figures: Figures, reference: str) -> dict[Name, dict[str, Figure]]:
    """Differences of the reference row from every row, pair by pair; a figure that one of them
    lacks is None.

    Parameters
    ----------
    figures : mapping from the names of cells
    reference : str
        Label of the row that the others are subtracted from.

    Raises
    ------
    ValueError
        If there is no such row.
    """
    if reference not in (name[0] for name in figures):
        raise ValueError(f"reference: must be one of the rows, got {reference!r}")
    gains: dict[Name, dict[str, Figure]] = {}
    for name, row_figures in figures.items():
        if name[0] == reference:
            continue
        reference_figures = figures.get((reference, *name[1:]), {})
        gains[name] = {
            key: _difference(reference_figures.get(key), figure)
            for key, figure in row_figures.items()
        }
    return gains


def _values(figures: Figures, figure: str, label: str) -> dict[Name, float]:
    """Return a row's values by the name without the row's label; those not measured are left
    out.
    """
    values = {}
    for name, row_figures in figures.items():
        value = row_figures.get(figure) if name[0] == label else None
        if isinstance(value, str):
            raise ValueError(f"columns: {figure} is no number, got {value!r}")
        if value is not None and not math.isnan(value):
            values["", *name[1:]] = float(value)
    return values


def _difference(first: Figure, second: Figure) -> float | None:
    if first is None or second is None or isinstance(first, str) or isinstance(second, str):
        return None
    return float(first) - float(second)


def _best(
    by_row: Mapping[str, Mapping[Name, float]],
    entries: Mapping[str, Entry],
    better: Literal["high", "low"],
    clusters: Sequence[int],
    rng: np.random.Generator,
) -> dict[str, Entry]:
    """Return the best row's entry with its test against the runner-up, where there are both."""
    sign = 1 if better == "high" else -1
    ranked = sorted(
        (label for label in entries if by_row[label]),
        key=lambda label: -sign * entries[label].summary.mean,
    )
    if len(ranked) < 2:
        return {}
    best, second = ranked[:2]
    shared = [name for name in by_row[best] if name in by_row[second]]
    if not shared or not all(
        math.isfinite(by_row[label][name]) for label in (best, second) for name in shared
    ):
        return {}
    lead = _interval(
        {name: sign * (by_row[best][name] - by_row[second][name]) for name in shared},
        clusters,
        rng,
    )
    is_complete = len(shared) == len(by_row[second])
    entry = entries[best]
    return {
        best: Entry(entry.summary, entry.interval, lead, second, bold=is_complete and lead.low > 0)
    }


def _interval(
    values: Mapping[Name, float], clusters: Sequence[int], rng: np.random.Generator
) -> Interval:
    labels = [[name[cluster] for name in values] for cluster in clusters]
    numbers = list(values.values())
    if len(labels) == 2:
        return crossed_interval(numbers, *labels)
    return mean_interval(numbers, rng=rng, clusters=labels[0])


def _in_words(entry: Entry, column: Column, cells: int) -> str | Bold:
    if entry.summary.n == 0:
        return "–"
    digits = column.digits
    text = f"{column.shown(entry):.{digits}f}"
    suffix = ""
    if (interval := entry.finite_interval) is not None:
        suffix = f" ({interval.low:.{digits}f}..{interval.high:.{digits}f})"
    if entry.summary.n != cells:
        suffix += f", {entry.summary.n} of {cells}"
    return Bold(text, suffix) if entry.bold else text + suffix
