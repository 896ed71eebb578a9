"""What differs from run to run, as paths, times and rates, replaced by placeholders."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

RULES: list[tuple[str, re.Pattern[str], str]] = [
    (r".*", re.compile(r'("(?:seconds|cpu_s)"): [\d.eE+-]+'), r'\1: "<seconds>"'),
    (
        r"stdout|stderr",
        re.compile(r"(?<=[;,] )[\d.,eE+-]+ s(?=[,.;]|$)", re.MULTILINE),
        "<seconds> s",
    ),
    (r"stdout", re.compile(r'"(cpu_s|wall_s|memory_mib)": \{[^{}]*\}'), r'"\1": "<cost>"'),
    (r"stdout", re.compile(r'("uptime_s": )[\d.]+'), r"\1<seconds>"),
    (r"stdout|.*\.md", re.compile(r"[\d.,]+ CPU-s"), "<cost> CPU-s"),
    (r"stdout", re.compile(r"^ +[\d.]+ s  idle", re.MULTILINE), "<seconds> s  idle"),
    (r"stdout", re.compile(r"\d+ looks"), "<several> looks"),
    (r"stdout", re.compile(r"clock is .*"), "clock is <measured>"),
    (r"stderr", re.compile(r"cep: warning: a crystal is within .*\n"), ""),
    (r"stdout", re.compile(r" +$", re.MULTILINE), ""),
    (r"stdout", re.compile(r"─{3,}"), "───"),
]
"""Pattern of names of files (``stdout``, ``stderr``: the streams), what is replaced, by what."""

COSTS = frozenset({"s", "seconds", "CPU-s", "MiB", "cpu_s", "wall_s", "memory_mib", "uptime s"})
"""Heads of the columns of tables, and names of their rows, whose values are replaced."""

EMBEDDED = re.compile(r"(?<=base64,)[A-Za-z0-9+/=\s]{200,}")
"""Pictures in a page; their SHA-256 takes their place."""

PASSED_OVER = re.compile(r"(?:.*/)?cells/[0-9a-f]{64}\.json")
"""Finished cells of folders and tables: their names and versions follow the sources, and their
figures are in the tables."""


def normalised(text: str, name: str, places: Mapping[str, str]) -> str:
    """Replace what differs from run to run.

    Parameters
    ----------
    text : str
        Of a stream or a file.
    name : str
        Path of the file, or ``stdout`` or ``stderr``.
    places : mapping
        Placeholders by the absolute path that they stand for.

    Returns
    -------
    str
        The text with placeholders.
    """
    for place in sorted(places, key=len, reverse=True):
        text = text.replace(place, places[place])
    if name == "stdout":
        text = drawn_tables_without_costs(text)
    for names, pattern, placeholder in RULES:
        if re.fullmatch(names, name):
            text = pattern.sub(placeholder, text)
    if name.endswith(".html"):
        return EMBEDDED.sub(lambda match: hashlib.sha256(match[0].encode()).hexdigest(), text)
    if name.endswith(".csv"):
        return csv_without_costs(text)
    if name.endswith(".json"):
        return bench_without_costs(text)
    if name.endswith(".tex"):
        return tex_without_costs(text)
    return marked_tables_without_costs(text)


def csv_without_costs(text: str) -> str:
    """Replace the columns of costs of a table in CSV, and the rows whose figure is a cost."""
    rows = list(csv.reader(io.StringIO(text)))
    if not rows or not (COSTS | {"figure"}) & set(rows[0]):
        return text
    figure = rows[0].index("figure") if "figure" in rows[0] else None
    fresh = [rows[0]]
    for row in rows[1:]:
        if figure is not None and len(row) > figure and row[figure] in COSTS:
            fresh.append([*row[: figure + 1], "<cost>"])
        else:
            fresh.append(without_costs(rows[0], row))
    written = io.StringIO()
    csv.writer(written, lineterminator="\n").writerows(fresh)
    return written.getvalue()


def bench_without_costs(text: str) -> str:
    """Replace the costs and the machines in the JSON file of a benchmark."""
    try:
        document = json.loads(text)
    except ValueError:
        return text
    if not isinstance(document, dict) or not str(document.get("schema", "")).startswith(
        "cep.bench/"
    ):
        return text
    document["machines"] = "<machines>"
    for table in document.get("tables", ()):
        costs = [
            number for number, column in enumerate(table["columns"]) if column["figure"] in COSTS
        ]
        for row in table["rows"]:
            for number in costs:
                row["entries"][number] = "<cost>"
    return json.dumps(document, indent=1) + "\n"


def marked_tables_without_costs(text: str) -> str:
    """Replace the entries of the columns of costs of tables in Markdown."""
    lines = []
    heads: list[str] = []
    for line in text.split("\n"):
        cells = (
            [cell.strip() for cell in line.strip().strip("|").split("|")]
            if line.startswith("|")
            else []
        )
        if not cells:
            heads = []
        elif not heads:
            heads = cells
        elif COSTS & set(heads) and not line.startswith("| ---"):
            line = f"| {' | '.join(without_costs(heads, cells))} |"
        lines.append(line)
    return "\n".join(lines)


def tex_without_costs(text: str) -> str:
    """Replace the entries of the columns of costs of tables in LaTeX."""
    lines = []
    heads: list[str] = []
    for line in text.split("\n"):
        cells = [cell.strip() for cell in line.strip().removesuffix(r"\\").split("&")]
        if r"\toprule" in line:
            heads = []
        elif len(cells) > 1 and not heads:
            heads = cells
        elif len(cells) > 1 and COSTS & set(heads):
            line = " & ".join(without_costs(heads, cells))
        lines.append(line)
    return "\n".join(lines)


def drawn_tables_without_costs(text: str) -> str:
    """Replace the columns of costs of tables drawn for people: a line of heads above a rule."""
    lines = text.split("\n")
    for number, line in enumerate(lines):
        if number == 0 or not re.fullmatch(r" ?─+ ?", line):
            continue
        last = next(
            (below for below in range(number, len(lines)) if not lines[below].strip()), len(lines)
        )
        rows = [lines[number - 1], *lines[number + 1 : last]]
        cells = in_columns(rows)
        if COSTS & {*cells[0], *(row[0] for row in cells)}:
            fresh = [cells[0], *(without_costs(cells[0], row) for row in cells[1:])]
            lines[max(0, number - 2) : last + 1] = ["", *(" | ".join(row) for row in fresh), ""]
            return "\n".join(
                [*lines[:number], drawn_tables_without_costs("\n".join(lines[number:]))]
            )
    return text


def in_columns(rows: Sequence[str]) -> list[list[str]]:
    """Cut lines into cells where all of them have three spaces or more."""
    width = max(len(row) for row in rows)
    blank = "".join(
        "x" if any(row[i : i + 1].strip() for row in rows) else " " for i in range(width)
    )
    spans = [match.span() for match in re.finditer(r"x(?: {0,2}x)*", blank)]
    return [[row[first:last].strip() for first, last in spans] for row in rows]


def without_costs(heads: Sequence[str], cells: Sequence[str]) -> list[str]:
    """Return the cells of a row with a placeholder in each column of costs."""
    if cells[0] in COSTS:
        return [cells[0], *("<cost>" for _ in cells[1:])]
    return [
        "<cost>" if number < len(heads) and heads[number] in COSTS and cell else cell
        for number, cell in enumerate(cells)
    ]


def as_text(data: bytes) -> str | None:
    """Decode a file that is text; None for any other."""
    if b"\0" in data:
        return None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return None


def normalised_file(path: Path, name: str, places: Mapping[str, str]) -> bytes:
    """Return the content of a file, with placeholders where it is text.

    An archive is listed, with the checksums of its files: it states the time of its making.
    """
    if path.suffix == ".zip" and zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            entries = [f"{entry.filename} {entry.CRC:08x}\n" for entry in archive.infolist()]
        return "".join(entries).encode()
    data = path.read_bytes()
    text = as_text(data)
    return data if text is None else normalised(text, name, places).encode()
