"""Cells of a long computation: a pure function, its arguments, and a fingerprint of both."""

from __future__ import annotations

import hashlib
import inspect
import re
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lab.jobs.machine import machine

Figure = float | int | str | None
"""What a benchmark measures; None where it could not."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One independent piece of a long computation.

    Attributes
    ----------
    name : tuple of str
        Labels such as method, photo, motion, by which tables group. They are no part of the
        fingerprint.
    work : function
        A pure function at the top of an importable module; returns a flat mapping of figures.
        Cells run side by side, so it should use one thread.
    arguments : mapping from str
        Arguments of ``work``: None, bool, int, float, str, bytes, arrays, enums, and lists,
        tuples, mappings and dataclasses of them; a Path is a file, given as an argument of its
        own, and counts by its content.
    version : str
        Of the method. Another one makes the cell run again.

    Raises
    ------
    ValueError
        If a label or the version is not a text, or the function cannot be found by name again.
    """

    name: tuple[str, ...]
    work: Callable[..., Mapping[str, Figure]]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    version: str = "1"

    def __post_init__(self) -> None:
        if not self.name or not all(isinstance(label, str) and label for label in self.name):
            raise ValueError(
                f"name: must be a tuple of texts that are not empty, got {self.name!r}"
            )
        if not isinstance(self.version, str) or not self.version:
            raise ValueError(f"version: must be a text that is not empty, got {self.version!r}")
        if (
            not inspect.isfunction(self.work)
            or self.work.__module__ == "__main__"
            or getattr(sys.modules.get(self.work.__module__), self.work.__qualname__, None)
            is not self.work
        ):
            raise ValueError(
                f"work: must be a function at the top of an importable module, got {self.work!r}"
                f" for {self.label}"
            )
        # workers may have another current folder
        located = {
            key: item.absolute() if isinstance(item, Path) else item
            for key, item in self.arguments.items()
        }
        object.__setattr__(self, "arguments", located)

    @property
    def label(self) -> str:
        """The name in one line."""
        return "/".join(self.name)


@dataclass(frozen=True)
class Finished:
    """Figures of a cell, or the reason of its failure.

    Attributes
    ----------
    figures : mapping
        Empty where the work failed.
    failure : str
        Reason in one line; empty where there are figures.
    seconds : float
        Wall time.
    machine : mapping
        Where it ran, as of :func:`lab.jobs.machine.machine`.
    """

    figures: Mapping[str, Figure]
    failure: str
    seconds: float
    machine: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Result:
    """A cell and its figures.

    Attributes
    ----------
    cell : Cell
    finished : Finished
    cached : bool
        Whether it was found on disk.
    """

    cell: Cell
    finished: Finished
    cached: bool


@dataclass(frozen=True)
class _Pinned:
    """A file and the hash of its content when the run began."""

    path: Path
    digest: str

    def checked(self) -> Path:
        status = self.path.stat()
        if _digest_of(self.path, (status.st_mtime_ns, status.st_size)) != self.digest:
            raise ValueError(
                f"{self.path}: another file than the one that the benchmark began with"
            )
        return self.path


def pinned(cells: Iterable[Cell]) -> list[dict[str, Any]]:
    """Arguments of cells with the hash of each file's content: later, or on another machine, the
    file may differ.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    digests: dict[Path, str] = {}
    return [
        {
            key: _Pinned(item, _digest(item, digests)) if isinstance(item, Path) else item
            for key, item in cell.arguments.items()
        }
        for cell in cells
    ]


def worked(work: Callable[..., Mapping[str, Figure]], arguments: Mapping[str, Any]) -> Finished:
    """Run a cell's function in this process; an exception becomes the reason of a failure.

    Parameters
    ----------
    work : function
    arguments : mapping
        A cell's, or of :func:`pinned`.

    Returns
    -------
    Finished
    """
    began_s = time.perf_counter()
    try:
        file_arguments = {
            key: item.checked() if isinstance(item, _Pinned) else item
            for key, item in arguments.items()
        }
        figures = _flat(work(**file_arguments))
        failure = ""
    except Exception as error:
        is_plain = isinstance(error, ValueError | RuntimeError) and bool(str(error))
        text = str(error) if is_plain else f"{type(error).__name__}: {error}".removesuffix(": ")
        figures = {}
        failure = " ".join(text.split())
    return Finished(figures, failure, time.perf_counter() - began_s, machine())


def _flat(returned: object) -> dict[str, Figure]:
    if not isinstance(returned, Mapping):
        raise ValueError(
            f"the work must return a mapping of figures, got {type(returned).__name__}"
        )
    flat: dict[str, Figure] = {}
    for key, value in returned.items():
        figure = value.item() if isinstance(value, np.generic) else value
        if not isinstance(key, str) or not (
            figure is None or isinstance(figure, float | int | str)
        ):
            raise ValueError(
                f"figure {key!r}: must be a number, a text or None, got {type(value).__name__}"
            )
        flat[key] = float(figure) if isinstance(figure, float) else figure
    return flat


# -- fingerprints ---------------------------------------------------------------------------------


def fingerprints(cells: Iterable[Cell]) -> list[str]:
    """Return fingerprints of each cell's function, version and arguments: 64 hexadecimal digits.

    Raises
    ------
    ValueError
        If the content of an argument cannot be hashed; the line names the cell and the argument.
    OSError
        If a file among the arguments cannot be read.
    """
    digests: dict[Path, str] = {}
    return [_fingerprint(cell, digests) for cell in cells]


def _digest(path: Path, digests: dict[Path, str]) -> str:
    if path not in digests:  # a photo shared by all cells is read once
        digests[path] = _read_digest(path)
    return digests[path]


@lru_cache(maxsize=4096)  # a worker is asked once per cell
def _digest_of(path: Path, _state: tuple[int, int]) -> str:
    return _read_digest(path)


def _read_digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _fingerprint(cell: Cell, digests: dict[Path, str]) -> str:
    parts: dict[str, Any] = {}
    for key, value in cell.arguments.items():
        if isinstance(value, Path):
            parts[key] = ("file", _digest(value, digests))
        else:
            parts[key] = ("value", value)
    digest = hashlib.sha256()
    for text in (cell.work.__module__, cell.work.__qualname__, cell.version):
        digest.update(_encoded(text, ""))
    try:
        digest.update(_encoded(parts, ""))
    except ValueError as error:
        raise ValueError(f"{cell.label}: {error}") from None
    return digest.hexdigest()


def _encoded(value: object, where: str) -> bytes:
    """Encode injectively: different values or types never give the same bytes."""
    if isinstance(value, np.generic):
        return _encoded(np.asarray(value), where)
    if value is None or (isinstance(value, bool | int) and not isinstance(value, Enum)):
        return _tagged(type(value).__name__, str(value).encode())
    if isinstance(value, Enum):
        return _tagged("enum", _encoded(_class_name(value), where), value.name.encode())
    if isinstance(value, float):
        return _tagged("float", value.hex().encode())
    if isinstance(value, str):
        return _tagged("str", value.encode())
    if isinstance(value, bytes):
        return _tagged("bytes", value)
    # the bytes of a masked array or an array of objects are not all its content
    if type(value) in (np.ndarray, np.memmap) and value.dtype.kind in "biufcSU":  # type: ignore[attr-defined]
        array = np.asarray(value)
        return _tagged(
            "array", array.dtype.str.encode(), str(array.shape).encode(), array.tobytes()
        )
    if isinstance(value, list | tuple):
        kind = "list" if isinstance(value, list) else "tuple"
        return _tagged(
            kind, *(_encoded(item, f"{where}[{index}]") for index, item in enumerate(value))
        )
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        pairs = (
            (_encoded(key, where), _encoded(value[key], f"{where}.{key}")) for key in sorted(value)
        )
        return _tagged("mapping", *(member for pair in pairs for member in pair))
    if is_dataclass(value) and not isinstance(value, type):
        inside = {member.name: getattr(value, member.name) for member in fields(value)}
        return _tagged("dataclass", _class_name(value).encode(), _encoded(inside, where))
    hint = (
        "give a file as an argument of its own"
        if isinstance(value, Path)
        else "give plain data or arrays"
    )
    place = re.sub(r"^\.(\w+)\[1\]", r"\1", where)
    raise ValueError(f"argument {place}: a {type(value).__name__} has no content to hash, {hint}")


def _tagged(kind: str, *parts: bytes) -> bytes:
    lengths = ",".join(str(len(item)) for item in parts)
    return b"".join((f"{kind}:{lengths};".encode(), *parts))


def _class_name(value: object) -> str:
    return f"{type(value).__module__}:{type(value).__qualname__}"
