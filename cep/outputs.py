"""One policy for output paths: refuse what exists, write under a temporary name, rename when whole."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["claim", "claim_folder", "new_file", "new_folder"]


def claim(paths: Iterable[Path | str], *, force: bool = False) -> None:
    """Check, before any work is done, that outputs may be written.

    Parameters
    ----------
    paths : files about to be written
    force : bool
        Whether existing files may be replaced.

    Raises
    ------
    ValueError
        If a file exists and ``force`` is not given, or its folder is missing or cannot be written to.
    """
    for path in map(Path, paths):
        if path.is_dir():
            raise ValueError(f"{path}: is a folder, a file name is needed")
        if path.exists() and not force:
            raise ValueError(f"{path}: exists already, use --force to replace it")
        folder = path.parent
        if not folder.exists():
            raise ValueError(f"{path}: there is no folder {folder}")
        if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
            raise ValueError(f"{path}: the folder {folder} cannot be written to")


def claim_folder(path: Path | str, names: Iterable[str], *, force: bool = False) -> None:
    """Check, before any work is done, that files may be written into a folder, which is made when missing.

    Parameters
    ----------
    path : folder
    names : files that will be written
    force : bool
        Whether existing ones may be replaced.

    Raises
    ------
    ValueError
        If a file exists and ``force`` is not given, or the folder cannot be made or written to.
    """
    target = Path(path)
    if target.exists() and not target.is_dir():
        raise ValueError(f"{target}: is a file, a folder name is needed")
    if target.is_dir():
        claim((target / name for name in names), force=force)
    nearest = _nearest(target)
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        raise ValueError(f"{target}: the folder {nearest} cannot be written to")


@contextmanager
def new_file(path: Path | str) -> Iterator[Path]:
    """Yield a temporary name beside ``path`` with the same suffix; on leaving well it becomes ``path``."""
    target = Path(path)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}.", suffix=target.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def new_folder(path: Path | str, names: Iterable[str], *, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder; on leaving well what it holds appears in ``path``, otherwise nothing does.

    Parameters
    ----------
    path : folder, made when missing
    names : files that will be written
    force : bool
        Whether existing ones may be replaced.

    Raises
    ------
    ValueError
        As :func:`claim_folder`.
    """
    target = Path(path)
    claim_folder(target, names, force=force)
    # within the nearest folder there is: renaming must not cross file systems
    temporary = Path(tempfile.mkdtemp(dir=_nearest(target), prefix=f".{target.name}."))
    try:
        yield temporary
        target.mkdir(parents=True, exist_ok=True)
        for item in sorted(temporary.iterdir()):
            item.replace(target / item.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _nearest(folder: Path) -> Path:
    """Return the folder itself or the nearest one above it that exists."""
    return next(path for path in (folder, *folder.absolute().parents) if path.exists())


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask
