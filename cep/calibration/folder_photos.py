"""Photos of a folder: which files they are, and the sharp photo that belongs to each."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from cep.files.images import PHOTO_SUFFIXES


def photos_in(folder: Path | str, *, but: Path | None = None) -> tuple[Path, ...]:
    """List the photos of a folder, sorted: no hidden files, no subfolders, no pictures of PSFs.

    A ``NAME_psf.png`` beside ``NAME_psf.npy`` is what ``cep simulate`` writes beside a photo.

    Parameters
    ----------
    folder : Path
    but : Path, optional
        A photo that is left out.

    Raises
    ------
    ValueError
        If there are none, or two would have the same name without its suffix.
    """
    root = Path(folder)
    photos = [
        path
        for path in sorted(root.iterdir())  # file systems have orders of their own
        if path.suffix.lower() in PHOTO_SUFFIXES
        and not path.name.startswith(".")
        # as cep simulate writes it beside its photo
        and not (path.name.endswith("_psf.png") and path.with_suffix(".npy").is_file())
        # a link that leads nowhere is reported as a failure, not passed over
        and (path.is_file() or not path.exists())
        # the sharp photo may lie among the blurred ones
        and not (but is not None and path.exists() and path.samefile(but))
    ]
    if not photos:
        raise ValueError(
            f"{root}: holds no photos (.png, .tif, .jpg, .webp or RAW files; subfolders are left"
            " alone)"
        )
    by_stem: dict[str, Path] = {}
    for path in photos:
        # some file systems do not tell A from a
        namesake = by_stem.setdefault(path.stem.casefold(), path)
        if namesake is not path:
            raise ValueError(
                f"{root}: {namesake.name} and {path.name} would be written to one folder"
                f" {path.stem}; rename one of them"
            )
    return tuple(photos)


def unreadable(photo: Path) -> str:
    """Say why a photo cannot even be opened, or its name not be written; empty where both can."""
    try:
        photo.name.encode("utf-8")  # Python keeps other bytes as lone surrogates
    except UnicodeEncodeError:
        return "the name is no UTF-8, rename it"
    try:
        photo.open("rb").close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def sharp_of(photos: Iterable[Path], sharp: Path | str) -> dict[Path, Path]:
    """Find the sharp photo of each blurred one: the same for all, or of the same name in a folder.

    Parameters
    ----------
    photos : iterable of Path
    sharp : Path
        A photo, or a folder with a photo for each.

    Raises
    ------
    ValueError
        If the folder lacks one; the line names it.
    """
    root = Path(sharp)
    if not root.is_dir():
        return dict.fromkeys(photos, root)
    by_stem = {path.stem: path for path in photos_in(root)}
    pairs = {}
    for photo in photos:
        if photo.stem not in by_stem:
            raise ValueError(f"{root}: holds no sharp photo named {photo.stem}, for {photo}")
        pairs[photo] = by_stem[photo.stem]
    return pairs


def printable_name(photo: Path) -> str:
    """Return the photo's name as it can be printed, whatever bytes it has."""
    return photo.name.encode("utf-8", "backslashreplace").decode()
