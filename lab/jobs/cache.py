"""Finished cells on disk, one file each, found again by fingerprint."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

from lab.jobs.cells import Cell, Figure, Finished
from motdiff.files.json_files import json_text
from motdiff.files.outputs import write_text

CELL_SCHEMA = "cep.bench-cell/1"
ENGINE = 1
"""Version of the engine; results of another one are made again."""

_NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}


class Cache:
    """A folder of finished cells; a damaged file counts as missing and adds a warning.

    Parameters
    ----------
    folder : path, made where it is missing

    Raises
    ------
    ValueError
        If there is a file in the folder's place.
    OSError
        If the folder cannot be made.
    """

    def __init__(self, folder: Path | str) -> None:
        self._folder = Path(folder)
        if self._folder.exists() and not self._folder.is_dir():
            raise ValueError(f"{folder}: is a file, a folder for finished cells is needed")
        self._folder.mkdir(parents=True, exist_ok=True)
        self._distrusted: Counter[str] = Counter()

    @property
    def warnings(self) -> list[str]:
        """Reasons why files were not used, one line each."""
        return [
            f"{self._folder}: {count} finished {'cell' if count == 1 else 'cells'} {reason}: made"
            " again"
            for reason, count in self._distrusted.items()
        ]

    def find(self, key: str) -> Finished | None:
        """Return the finished cell with this fingerprint, None where there is none.

        Raises
        ------
        OSError
            If the file is there and cannot be read.
        """
        try:
            text = self._path(key).read_bytes()
        except FileNotFoundError:
            return None
        try:
            document = json.loads(text)
        except (ValueError, RecursionError):
            document = None
        if not isinstance(document, dict):
            reason = "damaged"
        elif (document.get("schema"), document.get("engine")) != (CELL_SCHEMA, ENGINE):
            reason = "of another version of the engine"
        elif document.pop("check", None) != _check(document) or document.get("key") != key:
            reason = "damaged"
        else:
            figures = {name: _figure(stored) for name, stored in document["figures"].items()}
            return Finished(figures, "", document["seconds"], document["machine"])
        self._distrusted[reason] += 1
        return None

    def keep(self, key: str, cell: Cell, finished: Finished) -> None:
        """Write a finished cell, whole or not at all.

        Raises
        ------
        OSError
            If it cannot be written, as on a full disk; the error carries the file's name.
        """
        document = {
            "schema": CELL_SCHEMA,
            "engine": ENGINE,
            "key": key,
            "name": list(cell.name),
            "work": f"{cell.work.__module__}:{cell.work.__qualname__}",
            "version": cell.version,
            "figures": {name: _stored(figure) for name, figure in finished.figures.items()},
            "seconds": finished.seconds,
            "machine": dict(finished.machine),
        }
        write_text(self._path(key), json_text({**document, "check": _check(document)}))

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.json"


def _check(document: dict[str, Any]) -> str:
    """Checksum of a document."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _stored(figure: Figure) -> Any:
    """Encode infinities and NaN, for which JSON has no number: a code with a zero has an infinite
    noise gain.
    """
    return (
        {"not finite": str(figure)}
        if isinstance(figure, float) and not math.isfinite(figure)
        else figure
    )


def _figure(stored: Any) -> Figure:
    return _NOT_FINITE[stored["not finite"]] if isinstance(stored, dict) else stored
