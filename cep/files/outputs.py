"""Output paths of commands: existing files are refused; new files appear together, whole or not at
all.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from motdiff.files.outputs import (
    behind_links,
    check_file,
    check_folder,
    hidden_folder,
    naming,
    nearest_folder,
    new_files,
    replace_all,
)


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
        """Check, before any work is done, that the files may be written; raises as :func:`claim`
        does.
        """
        read = [path for path in map(Path, self.inputs) if path.is_file()]
        known: set[Path] = set()
        for path in self.paths:
            if (real := behind_links(path).absolute()) in known:
                raise ValueError(
                    f"{path}: would be written twice, every output needs a name of its own"
                )
            known.add(real)
            if path.exists() and any(path.samefile(one) for one in read):
                raise ValueError(f"{path}: is what is read, the output needs another name")
            if path.is_file() and not self.force:
                raise ValueError(f"{path}: exists already, use --force to replace it")
            check_file(path)

    @contextmanager
    def written(self, *, summary: str = "") -> Iterator[dict[Path, Path]]:
        """Yield a temporary name for each file, as :func:`new_files`; where that fails, the error
        says the summary.
        """
        with summary_on_failure(summary), new_files(self.paths, force=self.force) as made:
            yield made


@contextmanager
def summary_on_failure(summary: str) -> Iterator[None]:
    """Add a result's summary to the error of writing it, as of a full disk: the result must not be
    lost.
    """
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
    paths : files about to be written
    force : bool
        Whether existing files may be replaced.
    inputs : files that are read, which are never replaced; folders are ignored

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
    """Check, before any work is done, that files may be written into a folder, which is made when
    missing.

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
    check_folder(target)
    if target.is_dir():
        claim((target / name for name in names), force=force)


@contextmanager
def new_folder(path: Path | str, names: Iterable[str], *, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder; on success its files appear in ``path``, otherwise none does.

    Earlier files of those names that were not written this time are removed.

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
    missing = [folder for folder in (target, *target.parents) if not folder.exists()]
    with ExitStack() as stack:
        # within the nearest folder there is: renaming must not cross file systems
        temporary = stack.enter_context(hidden_folder(nearest_folder(target), target))
        stack.enter_context(naming({temporary: target}, target))
        yield temporary
        written = {item.name: item for item in sorted(temporary.iterdir())}
        for name in written:
            if (target / name).is_symlink():  # where the link leads may be another file system
                real = behind_links(target / name)
                beside = stack.enter_context(hidden_folder(real.parent, target / name)) / real.name
                written[name] = shutil.copyfile(written[name], beside)
        try:
            target.mkdir(parents=True, exist_ok=True)
            new = {behind_links(target / name): item for name, item in written.items()}
            replace_all(
                new, remove=[target / name for name in names if name not in written], force=force
            )
        except BaseException:
            for folder in missing:
                with suppress(OSError):  # it was not made, or something else is in it
                    folder.rmdir()
            raise
