"""Input files that a user names."""

from __future__ import annotations

import stat
from pathlib import Path

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
    source = Path(path)
    mode = source.stat().st_mode
    # Reading a pipe may never end; for a folder the system's own error is clear.
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise ValueError("it is a pipe, a socket or a device, not a regular file")
    with source.open("rb") as stream:
        # Never by the size that the system states: a file may grow while it is read.
        data = stream.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise ValueError(
            f"it is too large, a file of this kind has at most {most_bytes >> 20} MiB"
        )
    return data
