"""Compilation of the innermost loops by numba, cached between runs, without the interpreter's lock.

numba keys the machine code it keeps by the file of each function alone, and a loop into which other modules' functions
were inlined would survive their change. So the folder of the kept code is named after all compiled sources together.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

import numba
from numba import njit

__all__ = ["compiled", "inlined", "kept_folder"]

F = TypeVar("F", bound=Callable[..., object])
_OPTIONS = {
    "nogil": True,
    # as C divides: a check for zero in every iteration would keep vector instructions away
    "error_model": "numpy",
    # sums may be reordered, for the same reason; NaN and infinities keep their meaning
    "fastmath": {"reassoc", "contract", "arcp", "nsz"},
}
_NAME = "compiled-"


def compiled(function: F) -> F:
    """Compile at the first call; the machine code is kept in the package's folder, or else in the user's cache folder.

    Threads may run it side by side.
    """
    return _compile(function)


def inlined(function: F) -> F:
    """Compile into the calling compiled function: passing many arrays costs more than a short loop."""
    return _compile(function, forceinline=True)


def kept_folder(package: Path, *, otherwise: Path) -> Path:
    """Name the folder for the machine code of a package's sources as they are now, and drop that of earlier ones.

    Parameters
    ----------
    package : Path
        Folder whose modules are searched for users of this one.
    otherwise : Path
        Where to keep the code when the package's own folder cannot be written.
    """
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if b"cep.compiled import" in source:
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + source)
    parent = package / "__pycache__"
    try:
        parent.mkdir(exist_ok=True)
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError:
        parent = otherwise
    folder = parent / f"{_NAME}{digest.hexdigest()[:16]}"
    with suppress(OSError):
        for old in parent.glob(f"{_NAME}*"):
            if old != folder:
                shutil.rmtree(old, ignore_errors=True)
    return folder


def _compile(function: F, **more: object) -> F:
    before = numba.config.CACHE_DIR
    if not before:  # a folder that the user names for numba is left to numba
        numba.config.CACHE_DIR = str(_own_folder())
    try:
        return cast(F, njit(cache=True, **_OPTIONS, **more)(function))
    finally:
        numba.config.CACHE_DIR = before


@cache
def _own_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return kept_folder(Path(__file__).parent, otherwise=Path(base) / "coded-exposure")
