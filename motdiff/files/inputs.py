"""Input files: regular files of a limited size, as text, JSON or TOML; one-line errors."""

from __future__ import annotations

import json
import math
import stat
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

JSON_BYTES = 16 * 2**20
"""Largest JSON file that is read: a path of 100,000 samples with an alternative. Parsed it may
take 30 times more."""
TOML_BYTES = 2**20
"""Largest TOML file that is read: a settings file has a few kilobytes."""
TEXT_BYTES = 32 * 2**20
"""Largest table that is read."""

_LONGEST = 300  # characters of a message
_DEEPEST = 64  # of lists and objects within each other: later work would run out of stack
_Document = TypeVar("_Document")
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def regular_file(path: Path | str) -> Path:
    """Check that an input is a regular file, as every reader of a user's file does first.

    Reading a pipe may block for ever, reading a device may never end.

    Raises
    ------
    ValueError
        If it is a folder, a pipe (``/dev/stdin`` and the shell's ``<(...)`` are pipes), a socket
        or a device.
    OSError
        If there is no such file, or its folder cannot be entered.
    """
    source = Path(path)
    mode = source.stat().st_mode
    if not stat.S_ISREG(mode):
        kind = next((name for test, name in _KINDS if test(mode)), "not a regular file")
        raise ValueError(f"{source}: is {kind}, a regular file is needed")
    return source


def read_text(path: Path | str) -> str:
    """Read a text file, UTF-8 with or without the mark that Windows editors write first.

    Raises
    ------
    ValueError
        If it is no regular file, larger than :data:`TEXT_BYTES`, or not UTF-8.
    OSError
        If it cannot be read.
    """
    data = _content(path, most_bytes=TEXT_BYTES)
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
        if "\0" in text:
            raise ValueError("it has zeros, as UTF-16 has")
    except ValueError as error:  # of which decoding errors are a kind
        raise ValueError(
            f"{path}: not a text file in UTF-8, save it as UTF-8 ({one_line(error)})"
        ) from None
    return text


def read_json(path: Path | str) -> Any:
    """Read a JSON file.

    Raises
    ------
    ValueError
        If it is no regular file, larger than :data:`JSON_BYTES`, or not JSON, holds a number of
        thousands of digits, or is nested too deeply.
    OSError
        If it cannot be read.
    """
    return _parsed(path, json.loads, "JSON", most_bytes=JSON_BYTES)


def read_toml(path: Path | str) -> dict[str, Any]:
    """Read a TOML file of at most :data:`TOML_BYTES`; raises as :func:`read_json`."""
    return _parsed(path, tomllib.loads, "TOML", most_bytes=TOML_BYTES)


def typed_fields(values: Mapping[str, object], kind: type, *, where: str = "") -> dict[str, Any]:
    """Values of a TOML table as those of a dataclass's fields; a whole number may be a float's.

    Parameters
    ----------
    values : mapping
    kind : type
        A dataclass whose fields are bool, int, float, str, Literal of str, or tuples of these.
    where : str
        In front of an entry's name, in errors.

    Raises
    ------
    ValueError
        If an entry is not known, or of another type; the line begins with its name.
    """
    names = [declared.name for declared in fields(kind)]
    types = get_type_hints(kind)
    for name in values:
        if name not in names:
            raise ValueError(f"{where}{name}: is not known; known are {', '.join(names)}")
    return {name: _typed(f"{where}{name}", item, types[name]) for name, item in values.items()}


def _typed(name: str, value: object, kind: Any) -> object:
    inner = get_args(kind)
    if get_origin(kind) is tuple:
        if isinstance(value, list) and inner[-1] is Ellipsis:
            inner = inner[:1] * len(value)
        if not isinstance(value, list) or len(value) != len(inner):
            count = "" if inner[-1] is Ellipsis else f"{len(inner)} "
            raise ValueError(f"{name}: must be a list of {count}numbers, got {value!r}")
        return tuple(_typed(name, *pair) for pair in zip(value, inner, strict=True))
    if get_origin(kind) is Literal:
        kind = str  # which texts there are is said where they are checked
    if kind is float and type(value) is int:
        return float(value)
    # exactly this type: to Python a bool is an int
    if type(value) is not kind:
        raise ValueError(f"{name}: must be of type {kind.__name__}, got {value!r}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{name}: must be a finite number, got {value!r}")
    return value


def _parsed(
    path: Path | str, parse: Callable[[str], _Document], kind: str, *, most_bytes: int
) -> _Document:
    data = _content(path, most_bytes=most_bytes)
    try:
        return _shallow(parse(data.decode("utf-8-sig")))
    except RecursionError:
        reason = "it is nested too deeply"
    except (json.JSONDecodeError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        reason = one_line(error)
    except ValueError:  # all else that Python refuses here
        reason = "a number in it has thousands of digits"
    raise ValueError(f"{path}: not a {kind} file ({reason})")


def _content(path: Path | str, *, most_bytes: int) -> bytes:
    """Read a regular file that is not too large for its kind."""
    with regular_file(path).open("rb") as stream:
        data = stream.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise ValueError(
            f"{path}: is too large, a file of this kind has at most {most_bytes >> 20} MiB"
        )
    return data


def _shallow(document: _Document) -> _Document:
    """Return a document; RecursionError if its lists and objects are nested too deeply."""
    level: list[Any] = [document]
    for _ in range(_DEEPEST):
        inner = (
            item.values() if isinstance(item, dict) else item
            for item in level
            if isinstance(item, dict | list)
        )
        level = [item for items in inner for item in items if isinstance(item, dict | list)]
        if not level:
            return document
    raise RecursionError


def one_line(text: object) -> str:
    r"""Shorten a text or an exception's message to one printable line.

    A damaged file may put a megabyte, or a terminal's commands, into it.

    Examples
    --------
    >>> one_line("line one\nline two \x1b[2J")
    'line one line two \\x1b[2J'
    """
    line = printable(" ".join(str(text)[: 4 * _LONGEST].split()))
    if len(line) > _LONGEST:
        return f"{line[: _LONGEST - 3]}..."
    return line


def printable(text: str) -> str:
    r"""Write invisible characters as escapes: controls, marks of direction, lone surrogates.

    Examples
    --------
    >>> printable("a\nb \x1b[2J \u202e"), printable("µm, 5 × 5")
    ('a\\nb \\x1b[2J \\u202e', 'µm, 5 × 5')
    """
    return "".join(mark if mark.isprintable() else repr(mark)[1:-1] for mark in text)
