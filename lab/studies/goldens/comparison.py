"""Comparison of two records, by lines and by near numbers."""

from __future__ import annotations

import difflib
import json
import math
import re
from pathlib import Path

from lab.studies.goldens.cases import case_names
from lab.studies.goldens.placeholders import as_text

RELATIVE = 1e-6
"""Numbers that differ by less, relatively, count as equal."""

NUMBER = re.compile(r"(?<!\d)[-+]?\d*\.\d+(?:[eE][-+]?\d+)?|(?<![\w.])[-+]?\d+[eE][-+]?\d+(?!\w)")
"""Numbers with a point or an exponent. Whole ones are text: codes, hashes and counts are equal or
differ."""


def near_numbers(before: str, after: str) -> int | None:
    """Count the numbers that differ, where texts differ in nothing but nearly equal numbers.

    Returns
    -------
    int or None
        None where the texts differ in anything else.
    """
    if before == after:
        return 0
    if NUMBER.split(before) != NUMBER.split(after):
        return None
    pairs = list(zip(NUMBER.findall(before), NUMBER.findall(after), strict=True))
    differing = [(float(first), float(second)) for first, second in pairs if first != second]
    if all(math.isclose(first, second, rel_tol=RELATIVE) for first, second in differing):
        return len(differing)
    return None


class Comparison:
    """Differences of two records.

    Attributes
    ----------
    near : int
        Numbers that count as equal and are not the same.
    """

    def __init__(self, before: Path, after: Path) -> None:
        self._before = before
        self._after = after
        self.near = 0

    def case(self, name: str) -> list[str]:
        """Return the lines that say what differs in a case."""
        folders = (self._before / name, self._after / name)
        for folder, record_folder in zip(folders, (self._before, self._after), strict=True):
            if not (folder / "files.json").is_file():
                return [f"is not in {record_folder}"]
        lines = []
        for stream in ("exit", "stdout", "stderr"):
            lines += self._text(
                stream, *((folder / stream).read_text(encoding="utf-8") for folder in folders)
            )
        written_before, written_after = (
            json.loads((folder / "files.json").read_text()) for folder in folders
        )
        for file in sorted(written_before.keys() | written_after.keys()):
            digest_before, digest_after = written_before.get(file), written_after.get(file)
            if digest_before is None or digest_after is None:
                lines.append(f"{file}: {'only after' if digest_before is None else 'only before'}")
            elif digest_before != digest_after:
                lines += self._file(file, *(folder / "files" / file for folder in folders))
        return lines

    def _file(self, name: str, before: Path, after: Path) -> list[str]:
        texts = [
            as_text(path.read_bytes()) if path.is_file() else None for path in (before, after)
        ]
        if texts[0] is None or texts[1] is None:
            sizes = [
                f"{path.stat().st_size} bytes" if path.is_file() else "large"
                for path in (before, after)
            ]
            return [f"{name}: differs ({sizes[0]}, {sizes[1]})"]
        return self._text(name, texts[0], texts[1])

    def _text(self, name: str, before: str, after: str) -> list[str]:
        count = near_numbers(before, after)
        if count is not None:
            self.near += count
            return []
        pieces = (before.splitlines(), after.splitlines())
        return list(
            difflib.unified_diff(*pieces, f"before/{name}", f"after/{name}", lineterm="", n=1)
        )


def compare(before: Path, after: Path, *, most_lines: int) -> bool:
    """Print what differs between two records, case by case.

    Parameters
    ----------
    before, after : Path
        Folders of records.
    most_lines : int
        Lines to print of a case.

    Returns
    -------
    bool
        Whether nothing differs.
    """
    comparison = Comparison(before, after)
    names = case_names((before, after))
    differing = 0
    for name in names:
        lines = comparison.case(name)
        if not lines:
            continue
        differing += 1
        print(f"== {name}")
        for line in lines[:most_lines]:
            print(f"   {line[:400]}")
        if len(lines) > most_lines:
            print(f"   ... {len(lines) - most_lines} lines more")
    print(
        f"{len(names)} cases, {differing} differ; "
        f"{comparison.near} numbers differ by less than {RELATIVE:g}, relatively"
    )
    return not differing
