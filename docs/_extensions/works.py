"""Published works: BibTeX entries, and citations in one line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

_WORKS_FILE = Path(__file__).parents[2] / "cep" / "files" / "works.bib"
# it is our own, one field a line: no parser of all of BibTeX is needed
_ENTRY = re.compile(r"^@(\w+)\{([\w-]+),\n(.*?)\n\}$", re.MULTILINE | re.DOTALL)
_FIELD = re.compile(r"^  (\w+) = \{(.*?)\},?$", re.MULTILINE | re.DOTALL)
_ACCENTS = {
    r"{\"o}": "ö",
    r"{\"u}": "ü",
    r"{\'a}": "á",
    r"{\'e}": "é",
    r"{\'o}": "ó",
    r"{\ae}": "æ",
    r"\&": "&",
    "--": "–",
}


@dataclass(frozen=True)
class Work:
    """An entry of a bibliography."""

    key: str  # its name in a document, as raskar2006
    kind: str  # as BibTeX names it: article, inproceedings, book, ...
    fields: Mapping[str, str]  # LaTeX, as in the file
    bibtex: str  # the entry

    def text(self, field: str) -> str:
        """Return a field as plain text, empty where the entry has none."""
        text = " ".join(self.fields.get(field, "").split())
        for tex, letter in _ACCENTS.items():
            text = text.replace(tex, letter)
        return text.replace("{", "").replace("}", "")

    @property
    def authors(self) -> tuple[str, ...]:
        """Surnames, or the institution."""
        if self.fields["author"].startswith("{"):  # BibTeX's mark of a name that is no person's
            return (self.text("author"),)
        return tuple(name.split(",")[0] for name in self.text("author").split(" and "))

    @property
    def venue(self) -> str:
        """Where it appeared, with volume and year."""
        comma = ", "
        place = self.text("journal") or self.text("booktitle")
        if conference := re.search(r"\((\w+)\)$", self.text("booktitle")):  # as (CVPR)
            place = self.text("journal") or conference[1]
            comma = " "
        if not place:
            place = self.text("publisher") or self.text("note")
            if eprint := self.text("eprint"):
                place = f"{self.text('archiveprefix')} {eprint}"
        if self.text("journal") and self.text("volume"):
            place += f" {self.text('volume')}"
        if self.kind == "book":
            comma = " "
        return comma.join(filter(None, (place, self.text("year"))))

    @property
    def line(self) -> str:
        """A citation as documents have it, in Markdown.

        Examples
        --------
        >>> work("kirkpatrick1983").line
        'Kirkpatrick, Gelatt, Vecchi: *Optimization by simulated annealing.* Science 220, 1983.'
        """
        title = re.sub(r"(?<![.?!])$", ".", self.text("title"))
        return f"{', '.join(self.authors)}: *{title}* {self.venue}."


@cache
def works() -> Mapping[str, Work]:
    """Return all works by their keys, in the order of the file."""
    text = _WORKS_FILE.read_text(encoding="utf-8")
    entries = (
        Work(
            key,
            kind,
            MappingProxyType(dict(_FIELD.findall(body + "\n"))),
            f"@{kind}{{{key},\n{body}\n}}",
        )
        for kind, key, body in _ENTRY.findall(text)
    )
    return MappingProxyType({entry.key: entry for entry in entries})


def work(key: str) -> Work:
    """Return the work of a key."""
    return works()[key]
