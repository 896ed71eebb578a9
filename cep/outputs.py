"""One policy for output paths: refuse what exists, write under a temporary name, rename when whole."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["claim", "claim_folder", "new_file", "new_folder", "write_text"]


def claim(paths: Iterable[Path | str], *, force: bool = False, inputs: Iterable[Path | str] = ()) -> None:
    """Check, before any work is done, that outputs may be written.

    Parameters
    ----------
    paths : files about to be written
    force : bool
        Whether existing files may be replaced.
    inputs : files that are read, which are not replaced in any case; what is no file counts for nothing

    Raises
    ------
    ValueError
        If a file exists and ``force`` is not given, it is one of the inputs, something other than a regular file is in
        its place, or its folder is missing or cannot be written to.
    """
    read = [path for path in map(Path, inputs) if path.is_file()]
    for path in map(Path, paths):
        if path.exists() and any(path.samefile(one) for one in read):
            raise ValueError(f"{path}: is what is read, the output needs another name")
        if path.is_dir():
            raise ValueError(f"{path}: is a folder, a file name is needed")
        if path.exists() and not path.is_file():
            raise ValueError(f"{path}: is not a regular file")
        if path.exists() and not force:
            raise ValueError(f"{path}: exists already, use --force to replace it")
        folder = _behind_links(path).parent
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
    """Yield a temporary name beside ``path`` with the same suffix; on leaving well it becomes ``path``.

    A symbolic link stays: the file it leads to is replaced.

    Raises
    ------
    OSError
        If writing fails, as on a full disk; the error carries ``path``.
    """
    target = _behind_links(Path(path))
    with _named(path):
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}.", suffix=Path(path).suffix)
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            temporary.chmod(0o666 & ~_umask())
            temporary.replace(target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def write_text(path: Path | str, text: str) -> None:
    """Write ``text`` as UTF-8 through :func:`new_file`."""
    with new_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")


@contextmanager
def new_folder(path: Path | str, names: Iterable[str], *, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder; on leaving well what it holds appears in ``path``, otherwise nothing does.

    Files of those names that are there from before, but were not written this time, go.

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
    OSError
        If writing fails, as on a full disk; the error carries ``path``.
    """
    names = tuple(names)
    target = Path(path)
    claim_folder(target, names, force=force)
    # within the nearest folder there is: renaming must not cross file systems
    with _named(path):
        temporary = Path(tempfile.mkdtemp(dir=_nearest(target), prefix=f".{target.name}."))
    try:
        with _named(path, instead_of=temporary):
            yield temporary
            target.mkdir(parents=True, exist_ok=True)
            written = sorted(temporary.iterdir())
            for item in written:
                _put(item, target / item.name)
            for name in set(names) - {item.name for item in written}:
                (target / name).unlink(missing_ok=True)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _put(item: Path, place: Path) -> None:
    if place.is_symlink():
        # where the link leads may be another file system
        with new_file(place) as temporary:
            shutil.copyfile(item, temporary)
    else:
        item.replace(place)


@contextmanager
def _named(path: Path | str, *, instead_of: Path | None = None) -> Iterator[None]:
    """Give an OSError of writing the output's name: where it has none, or one that only we know.

    Without ``instead_of`` any temporary name beside ``path`` counts as such.
    """
    try:
        yield
    except OSError as error:
        name, hidden = Path(path), (instead_of or _behind_links(Path(path)).parent).absolute()
        if isinstance(error.filename, str | Path):
            known = Path(error.filename).absolute()
            if hidden not in (known, *known.parents):
                raise
            name = name / known.relative_to(hidden) if instead_of else name
        # errno is missing where a library counted the bytes written itself
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(name)) from error


def _behind_links(path: Path) -> Path:
    """Return the file that a symbolic link leads to, anything else as it is."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def _nearest(folder: Path) -> Path:
    """Return the folder itself or the nearest one above it that exists."""
    return next(path for path in (folder, *folder.absolute().parents) if path.exists())


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask
