"""Atomic output files: written under temporary names, renamed together when all are written."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path


@contextmanager
def new_files(paths: Iterable[Path | str], *, force: bool = True) -> Iterator[dict[Path, Path]]:
    """Yield a temporary name for each file; on success all appear together, otherwise none does.

    Temporary names end in the file names. A symbolic link stays: the file it leads to is replaced.

    Parameters
    ----------
    paths : iterable of paths
        In folders that exist.
    force : bool
        Whether earlier files are replaced.

    Raises
    ------
    ValueError
        If two of the paths lead to the same file, or without ``force`` a file has appeared there
        meanwhile.
    OSError
        If writing fails, as on a full disk; the error names the output, and the earlier files are
        as they were.
    """
    places = [Path(path) for path in paths]
    real = {place: _behind_links(place) for place in places}
    if len({place.absolute() for place in real.values()}) < len(places):
        raise ValueError(f"{', '.join(map(str, places))}: two of these are the same file")
    with ExitStack() as stack:
        temporaries = {
            place: stack.enter_context(_hidden_folder(real[place].parent, place)) / place.name
            for place in places
        }
        nameless = None  # of several files an error without a name may be any one's
        if len(places) == 1:
            (nameless,) = places
        with naming({temporaries[place]: place for place in places}, nameless):
            yield temporaries
            _replace_all({real[place]: temporaries[place] for place in places}, force=force)


@contextmanager
def new_file(path: Path | str) -> Iterator[Path]:
    """Yield a temporary name for one file, see :func:`new_files`."""
    with new_files([path]) as temporaries:
        yield temporaries[Path(path)]


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write ``data`` through :func:`new_file`."""
    with new_file(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path | str, text: str) -> None:
    """Write ``text`` as UTF-8 through :func:`new_file`; bytes that are none become escapes."""
    with new_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="")


def check_file(path: Path | str) -> None:
    """Check, before any work is done, that a file of this name can be written.

    ValueError if something other than a regular file is in its place, or its folder is missing or
    cannot be written to.
    """
    place = Path(path)
    if place.is_dir():
        raise ValueError(f"{place}: is a folder, a file name is needed")
    if place.exists() and not place.is_file():
        raise ValueError(f"{place}: is not a regular file")
    folder = _behind_links(place).parent
    if not folder.exists():
        raise ValueError(f"{place}: there is no folder {folder}")
    _check_writable(folder, place)


def check_folder(path: Path | str) -> None:
    """Check, before any work is done, that a folder can be written to, or made.

    ValueError if a file is in its place, or the folder, or the nearest one above it, cannot be
    written to.
    """
    place = Path(path)
    if place.exists() and not place.is_dir():
        raise ValueError(f"{place}: is a file, a folder name is needed")
    _check_writable(_nearest_folder(place), place)


def _check_writable(folder: Path, output: Path) -> None:
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise ValueError(f"{output}: the folder {folder} cannot be written to")


# -- outputs of commands -------------------------------------------------------------------------


@dataclass(frozen=True)
class Outputs:
    """Files that a command writes: they appear together, or not at all.

    Attributes
    ----------
    paths : tuple of Path
    force : bool
        Whether existing files may be replaced.
    inputs : tuple of paths
        Files that are read, which are not replaced in any case; what is no file counts for
        nothing.
    """

    paths: tuple[Path, ...]
    force: bool = False
    inputs: tuple[Path | str, ...] = ()

    def check(self) -> None:
        """Check, before any work is done, that the files may be written; see :func:`claim`."""
        sources = [path for path in map(Path, self.inputs) if path.is_file()]
        claimed: set[Path] = set()
        for path in self.paths:
            # two names may lead to one file
            if (real := _behind_links(path).absolute()) in claimed:
                raise ValueError(
                    f"{path}: would be written twice, every output needs a name of its own"
                )
            claimed.add(real)
            if path.exists() and any(path.samefile(source) for source in sources):
                raise ValueError(f"{path}: is what is read, the output needs another name")
            if path.is_file() and not self.force:
                raise ValueError(f"{path}: exists already, use --force to replace it")
            check_file(path)

    @contextmanager
    def written(self, *, summary: str = "") -> Iterator[dict[Path, Path]]:
        """Yield a temporary name for each file, as :func:`new_files`; errors say the summary."""
        with summary_on_failure(summary), new_files(self.paths, force=self.force) as temporaries:
            yield temporaries


@contextmanager
def summary_on_failure(summary: str) -> Iterator[None]:
    """Add a result's summary to the error of writing it: a full disk must not lose the result."""
    try:
        yield
    except (OSError, ValueError) as error:
        if summary:
            error.add_note(f"found: {summary}")
        raise


def claim(
    paths: Iterable[Path | str], *, force: bool = False, inputs: Iterable[Path | str] = ()
) -> Outputs:
    """Check, before any work is done, that outputs may be written, and return them.

    Parameters
    ----------
    paths : iterable of paths
        Files about to be written.
    force : bool
        Whether existing files may be replaced.
    inputs : iterable of paths
        Files that are read, which are never replaced; folders are ignored.

    Raises
    ------
    ValueError
        If a file exists and ``force`` is not given, it is one of the inputs or comes twice,
        something other than a regular file is in its place, or its folder is missing or cannot be
        written to.
    """
    outputs = Outputs(tuple(map(Path, paths)), force, tuple(inputs))
    outputs.check()
    return outputs


def claim_folder(path: Path | str, names: Iterable[str], *, force: bool = False) -> None:
    """Check, before any work is done, that a :func:`new_folder` may be written.

    ValueError if a file exists and ``force`` is not given, or the folder cannot be made or written
    to.
    """
    target = Path(path)
    check_folder(target)
    if target.is_dir():
        claim((target / name for name in names), force=force)


@contextmanager
def new_folder(path: Path | str, names: Iterable[str], *, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder; on success its files appear in ``path``, otherwise none does.

    Earlier files of those names that were not written this time are removed.

    Parameters
    ----------
    path : path
        The folder, made when missing.
    names : iterable of str
        Files that will be written.
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
    missing = [folder for folder in (target, *target.parents) if not folder.exists()]
    with ExitStack() as stack:
        # within the nearest folder there is: renaming must not cross file systems
        temporary = stack.enter_context(_hidden_folder(_nearest_folder(target), target))
        stack.enter_context(naming({temporary: target}, target))
        yield temporary
        written = {item.name: item for item in sorted(temporary.iterdir())}
        for name in written:
            if (target / name).is_symlink():  # where the link leads may be another file system
                real = _behind_links(target / name)
                beside = (
                    stack.enter_context(_hidden_folder(real.parent, target / name)) / real.name
                )
                written[name] = shutil.copyfile(written[name], beside)
        try:
            target.mkdir(parents=True, exist_ok=True)
            new = {_behind_links(target / name): item for name, item in written.items()}
            _replace_all(
                new, remove=[target / name for name in names if name not in written], force=force
            )
        except BaseException:
            for folder in missing:
                with suppress(OSError):  # it was not made, or something else is in it
                    folder.rmdir()
            raise


# -- renaming -------------------------------------------------------------------------------------


def _replace_all(
    new: Mapping[Path, Path], *, remove: Iterable[Path] = (), force: bool = True
) -> None:
    """Rename files to their places, and remove others: all, or when a step fails, none.

    All files are on the disk before the first is renamed: a full one is noticed while nothing has
    changed. ``new`` has for each place the file that goes there, on the same file system. Without
    ``force`` a ValueError says which place is taken, be it since a moment ago by another process;
    on an OSError a note names what could not be restored, and where it is kept.
    """
    removed = [place for place in remove if os.path.lexists(place)]
    for temporary in new.values():
        _sync(temporary)
    rename = Path.replace if force else _put_where_none_is
    if len(new) == 1 and not removed:
        ((place, temporary),) = new.items()
        rename(temporary, place)
        return
    asides: dict[Path, Path] = {}  # a folder for earlier files, in each folder of places
    earlier: dict[Path, Path | None] = {}
    restored = True
    try:
        for place in (*new, *removed):
            earlier[place] = None
            if os.path.lexists(place):
                if place.parent not in asides:
                    asides[place.parent] = _hidden(place.parent, place)
                earlier[place] = asides[place.parent] / place.name
        for place, temporary in new.items():
            if force and (backup := earlier[place]):
                _keep(place, backup)
            rename(temporary, place)
        for place in removed:
            if backup := earlier[place]:
                place.replace(backup)
    except BaseException as error:
        for place, backup in reversed(earlier.items()):
            try:
                _restore(place, backup, new.get(place))
            except OSError:
                restored = False
                error.add_note(f"the earlier {place} is kept as {backup}")
        raise
    finally:
        if restored:
            for aside in asides.values():
                shutil.rmtree(aside, ignore_errors=True)


def _sync(file: Path) -> None:
    """Wait until a file is on the disk."""
    handle = os.open(file, os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(file)) from error
    finally:
        os.close(handle)


def _put_where_none_is(file: Path, place: Path) -> None:
    """Rename a file to a place where there is none, as one step: of two processes one is refused.

    A hard link is made only where nothing is. Without hard links, an empty file is made first,
    which is one's own.
    """
    try:
        try:
            os.link(file, place, follow_symlinks=False)
        except FileExistsError:
            raise
        except (OSError, NotImplementedError):
            os.close(os.open(place, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
            file.replace(place)
        else:
            file.unlink()
    except FileExistsError:
        raise ValueError(f"{place}: exists already, use --force to replace it") from None


def _keep(place: Path, backup: Path) -> None:
    """Give a file a second name, or where the file system has no links, another name."""
    try:
        os.link(place, backup, follow_symlinks=False)
    except (OSError, NotImplementedError):
        place.replace(backup)


def _restore(place: Path, backup: Path | None, temporary: Path | None) -> None:
    if backup is not None:
        if os.path.lexists(backup) and not (
            os.path.lexists(place) and os.path.samestat(backup.lstat(), place.lstat())
        ):
            backup.replace(place)
    elif temporary is not None and not temporary.exists():  # it has been renamed
        place.unlink(missing_ok=True)


@contextmanager
def _hidden_folder(folder: Path, output: Path | str) -> Iterator[Path]:
    """Make a temporary folder within ``folder``, an error of which names ``output``; remove it."""
    temporary = _hidden(folder, output)
    try:
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _hidden(folder: Path, output: Path | str) -> Path:
    try:
        return Path(tempfile.mkdtemp(dir=folder, prefix=f".{Path(output).stem[:32]}."))
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(output)) from error


@contextmanager
def naming(outputs: Mapping[Path, Path], nameless: Path | None) -> Iterator[None]:
    """Give an OSError the output's name in place of a temporary one.

    Parameters
    ----------
    outputs : mapping
        From a temporary file or folder to the output it stands for.
    nameless : path or None
        Name of errors that have none; such errors stay as they are when None.
    """
    try:
        yield
    except OSError as error:
        name = nameless
        if isinstance(error.filename, str | Path):
            path = Path(error.filename).absolute()
            parts = {temporary.absolute(): output for temporary, output in outputs.items()}
            inside = next((folder for folder in (path, *path.parents) if folder in parts), None)
            name = inside and parts[inside] / path.relative_to(inside)
        if name is None:
            raise
        # errno is missing where a library counted the bytes written itself
        renamed = OSError(error.errno or errno.EIO, error.strerror or str(error), str(name))
        for note in getattr(error, "__notes__", ()):
            renamed.add_note(note)
        raise renamed from error


def _behind_links(path: Path) -> Path:
    """Return the file that a symbolic link leads to, anything else as it is."""
    if path.is_symlink():
        return Path(os.path.realpath(path))
    return path


def _nearest_folder(folder: Path) -> Path:
    """Return the folder itself or the nearest one above it that exists."""
    return next(path for path in (folder, *folder.absolute().parents) if path.exists())
