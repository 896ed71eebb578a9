"""HTML report as one self-contained file: pictures embedded, no network requests.

The one script in it, whose hash the page's security policy names, lays two pictures of a gallery
over each other with a movable boundary. Without it the gallery itself still shows them.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from cep.files.formatting import number
from motdiff.files.inputs import printable
from motdiff.files.outputs import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NUMBER = re.compile(r"–$|[<>]?\s*[+−-]?[\d.]")


@dataclass(frozen=True)
class Picture:
    """A picture in a report.

    Attributes
    ----------
    png : bytes
    caption : str
        Content, and how to read it.
    alt : str
        Content, for readers who cannot see it.
    name : str
        Name of a separate file, without suffix; none when empty.
    title : str
        Two or three words above it in a gallery.
    """

    png: bytes
    caption: str
    alt: str
    name: str = ""
    title: str = ""

    @property
    def data_uri(self) -> str:
        """The picture as a data URI."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")


@dataclass(frozen=True)
class Table:
    """A table in a report.

    Attributes
    ----------
    columns : tuple of str
        Headings with units; the first column names the row.
    rows : tuple of tuple
        Cells: text, or numbers (printed to four digits); None is a dash.
    highlight : int, optional
        Index of the row that this report is about.
    note : str
        Meaning of the columns.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]
    highlight: int | None = None
    note: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"rows: need {len(self.columns)} cells, found {len(row)} in {row[:1]}"
                )

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Whether each column holds numbers, which are aligned to the right; the first one never
        does.
        """
        columns = [[_cell(row[i]) for row in self.rows] for i in range(1, len(self.columns))]
        return (False, *(all(_NUMBER.match(cell) for cell in column) for column in columns))


@dataclass(frozen=True)
class Section:
    """A section of a report: text, links, warnings, a gallery, pictures, tables, commands, in this
    order.

    Attributes
    ----------
    title : str
    paragraphs, warnings : tuple of str
    gallery : tuple of Picture
        Photos of one scene, side by side; each needs a title.
    compared : (int, int), optional
        Which of the gallery are laid over each other, full size, with a movable boundary between
        them.
    tables : tuple of Table
    pictures : tuple of Picture
        Figures, below each other.
    commands : tuple of str
        Lines for a shell.
    links : tuple of (text, address)
        Followed only when they are clicked.
    """

    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    warnings: tuple[str, ...] = ()
    gallery: tuple[Picture, ...] = ()
    compared: tuple[int, int] | None = None
    commands: tuple[str, ...] = ()
    links: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Report:
    """A report.

    Attributes
    ----------
    title : str
    summary : str
        The result in one or two sentences.
    setting : str
        For which case it holds: the line above it.
    facts : tuple of (name, value)
        Key figures.
    remarks : tuple of str
        What the key figures do not say.
    sections : tuple of Section
    colophon : str
        Versions, seed, command: how to make it again.
    """

    title: str
    summary: str
    facts: tuple[tuple[str, str], ...] = ()
    sections: tuple[Section, ...] = ()
    colophon: str = ""
    setting: str = ""
    remarks: tuple[str, ...] = ()


def picture(figure: Figure, caption: str, alt: str, *, name: str = "") -> Picture:
    """Render a matplotlib figure for a report."""
    from cep.plots import png_bytes

    return Picture(png_bytes(figure), caption, alt, name)


def html(report: Report) -> str:
    """Render a report as one HTML page; every text in it is escaped."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup  # the script is the package's own

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: printable(value) if type(value) is str else value,
    )
    environment.filters["cell"] = _cell
    source, script = (_template(name) for name in ("report.html.j2", "compare.js"))
    if not any(section.compared for section in report.sections):
        script = ""
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return environment.from_string(source).render(
        report=report, script=Markup(script), allowed=allowed
    )


def write_report(path: Path | str, report: Report) -> None:
    """Write a report, whole or not at all.

    Parameters
    ----------
    path : path of the HTML file
    report : Report
    """
    write_text(path, html(report))


def _template(name: str) -> str:
    return (resources.files("cep.report") / "templates" / name).read_text(encoding="utf-8")


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and value != value):
        return "–"
    if isinstance(value, float):
        return number(value).replace("-", "−")
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(_cell(item) for item in value)
    return str(value)
