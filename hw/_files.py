"""Input files that a user names."""

from __future__ import annotations

import stat
from pathlib import Path


def regular_file(path: str | Path) -> Path:
    """Check that an input is no pipe, socket or device, whose reading may block for ever or never end.

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
