"""Innermost loops compiled by numba, cached between runs, without the interpreter's lock.

numba keys the machine code it keeps by the file of each function alone, and a loop into which
other modules' functions were inlined would survive their change. So the folder of the kept code is
named after all compiled sources together. Whoever can write there can have his code run here: no
folder is used that another user can write.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

import numba
from numba import njit

F = TypeVar("F", bound=Callable[..., object])
_OPTIONS = {
    "nogil": True,
    # as C divides: a check for zero in every iteration would keep vector instructions away
    "error_model": "numpy",
    # sums may be reordered, for the same reason; NaN and infinities keep their meaning
    "fastmath": {"reassoc", "contract", "arcp", "nsz"},
}
_NAME = "compiled-"
_ROOM_BYTES = 2**20  # of machine code; on a full disk a folder can be made, but not filled


def compiled(function: F) -> F:
    """Compile at the first call, and cache the machine code on disk.

    Where neither can be written, it is compiled anew in every run, which a warning says. Threads
    may run it side by side.
    """
    return _compile(function)


def inlined(function: F) -> F:
    """Compile into the calling function: passing many arrays costs more than a short loop."""
    return _compile(function, forceinline=True)


def kept_folder(package: Path, *, otherwise: Path | None) -> Path | None:
    """Make the cache folder of a package's sources as they are now; drop those of earlier ones.

    Parameters
    ----------
    package : Path
        Folder whose modules are searched for users of this one.
    otherwise : Path, optional
        Where to keep the code when the package's own folder cannot be written.

    Returns
    -------
    Path or None
        None where neither can be written by this user alone.
    """
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if b"cep.compiled import" in source:
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + source)
    for parent in filter(None, (package / "__pycache__", otherwise)):
        folder = parent / f"{_NAME}{digest.hexdigest()[:16]}"
        if not (_is_writable(folder) and _is_own(folder) and _is_own(parent)):
            continue
        with suppress(OSError):
            for old in parent.glob(f"{_NAME}*"):
                if old != folder:
                    shutil.rmtree(old, ignore_errors=True)
        return folder
    return None


def _is_writable(folder: Path) -> bool:
    """Whether a folder keeps code or has room; a missing one is made for this user alone."""
    try:
        # the parent too: the umask of many systems lets the user's group write
        folder.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            if not any(folder.rglob("*.nbi")):  # numba's index: kept code is read without room
                file.write(bytes(_ROOM_BYTES))
                file.flush()
            return True
    except OSError:
        return False


def _is_own(folder: Path) -> bool:
    """Whether nobody but this user and root can write into a folder."""
    if not hasattr(os, "geteuid"):  # Windows, where folders of a user are the user's
        return True
    about = folder.stat()
    return about.st_uid in (0, os.geteuid()) and not about.st_mode & 0o022


def _compile(function: F, **more: object) -> F:
    folder = _cache_folder()
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder or "")
    try:
        return cast(F, njit(cache=folder is not None, **_OPTIONS, **more)(function))
    finally:
        numba.config.CACHE_DIR = before


@cache
def _cache_folder() -> Path | None:
    """Return the user's folder for numba, the one of the sources, or a temporary one."""
    user_folder = numba.config.CACHE_DIR
    if user_folder:
        if _is_writable(Path(user_folder)):
            return Path(user_folder)
        return _passing_folder(user_folder)
    try:
        otherwise = (
            Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "coded-exposure"
        )
    except RuntimeError:  # this user has no home
        otherwise = None
    package = Path(__file__).parent
    folders = " and ".join(map(str, filter(None, (package / "__pycache__", otherwise))))
    return kept_folder(package, otherwise=otherwise) or _passing_folder(folders)


def _passing_folder(folders: str) -> Path | None:
    """Make a folder for this process and its children; None where none can be made."""
    warnings.warn(
        f"compiled loops cannot be kept in {folders}, not writable by this user alone: they are"
        " compiled anew in every run; NUMBA_CACHE_DIR names a folder to keep them in",
        RuntimeWarning,
        stacklevel=2,
    )
    try:
        folder = tempfile.mkdtemp(prefix="cep-compiled-")
    except OSError:
        return None
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    if not _is_writable(Path(folder)):
        return None
    os.environ["NUMBA_CACHE_DIR"] = folder
    return Path(folder)
