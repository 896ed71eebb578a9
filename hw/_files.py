"""Input files that a user names."""

from __future__ import annotations

import codecs
import re
import stat
from pathlib import Path

_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF32_LE: "utf-32-le",  # begins like the mark of UTF-16
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
_BINARY = re.compile(r"[\0-\x08\x0e-\x1a\x1c-\x1f]")
_MOST_BYTES = 32 * 2**20  # a capture of millions of edges; more would fill the memory


def content(path: str | Path, *, most_bytes: int = _MOST_BYTES) -> bytes:
    """Read a regular file that is not too large for its kind.

    Raises
    ------
    ValueError
        If it is no regular file, or has more than ``most_bytes``; the line does not name the file.
    OSError
        If it cannot be read.
    """
    with regular_file(path).open("rb") as stream:
        # Never by the size that the system states: a file may grow while it is read.
        data = stream.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise ValueError(
            f"it is too large, a file of this kind has at most {most_bytes >> 20} MiB"
        )
    return data


def decoded(data: bytes) -> str:
    """Decode UTF-8, -16 or -32, with a mark or without, else Windows-1252.

    Raises
    ------
    UnicodeDecodeError
        If it is neither UTF-8 nor text at all.
    """
    mark = next((mark for mark in _MARKS if data.startswith(mark)), b"")
    if mark:
        text = data.removeprefix(mark).decode(
            _MARKS[mark], errors="replace"
        )  # a cut end is the parser's to tell
    # ASCII in UTF-16 has a zero in every second byte.
    elif len(data) > 1 and 0 in data[:2]:
        text = data.decode("utf-16-le" if data[0] else "utf-16-be", errors="replace")
    else:
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            text = data.decode("cp1252", errors="replace")
            if _BINARY.search(text):
                raise
    return text.replace("\r\n", "\n").replace("\r", "\n")


def regular_file(path: str | Path) -> Path:
    """Check that an input is no pipe, socket or device, whose reading may never end.

    Raises
    ------
    ValueError
        If it is one; the line does not name the file.
    OSError
        If there is no such file.
    """
    source = Path(path)
    mode = source.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # for a folder the system's error is clear
        raise ValueError("it is a pipe, a socket or a device, not a regular file")
    return source
