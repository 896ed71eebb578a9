"""The motion in each photo of a folder: ``cep calibrate FOLDER``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from cep.calibration.calibrate import CALIBRATION_FILES, Calibration, check_method
from cep.calibration.photo_cell import estimate_from_figures, estimate_photo, estimator_version
from cep.files.images import PHOTO_SUFFIXES, parse_gamma, read_image, read_photo
from cep.jobs.cells import Cell, Figure
from cep.jobs.engine import Engine
from cep.jobs.folders import FolderResults, NotWrittenError, is_spelled, run_folder
from motdiff.estimators.registry import METHODS
from motdiff.files.outputs import claim_folder

_SUMMARY = "motions.csv"
_COLUMNS = (
    "photo",
    "length_px",
    "extent_px",
    "direction",
    "confidence",
    "seconds",
    "method",
    "warnings",
    "failure",
)


def calibrate_folder(
    folder: Path,
    output: Path | None = None,
    *,
    method: str = "motdiff",
    options: Mapping[str, Any] | None = None,
    gamma: str = "srgb",
    seed: int = 0,
    workers: int | None = None,
    force: bool = False,
    progress: Callable[[float, str], None] = lambda _fraction, _note: None,
) -> FolderResults:
    """Estimate and write the motion in each photo, one by one; one that fails costs no other.

    Parameters
    ----------
    folder : Path
        Photos.
    output : Path, optional
        Folder to write into, with a folder for each photo, named like it, and ``motions.csv``;
        ``FOLDER_motion`` when omitted.
    method : str
        As of :func:`cep.calibration.calibrate.estimate_motion`; no "gyro", whose ``start_s`` is
        that of one photo.
    options : mapping, optional
        Options of the method, as of :func:`cep.calibration.calibrate.read_options`: ``sharp`` is a
        sharp photo, or a folder with one for each photo, by name.
    gamma : str
        Of the photos, as of :func:`cep.files.images.read_photo`.
    workers : int, optional
        Processes; as many as cores when omitted.
    force : bool
        Whether existing files may be replaced.
    progress : callable, optional
        Called with the fraction done and a note.

    Returns
    -------
    FolderResults
        After Ctrl-C with the photos finished until then. Each is described as by
        :meth:`cep.calibration.calibrate.Calibration.to_dict`.

    Raises
    ------
    ValueError
        If there are no photos, a file is in the way, or an option is not valid.
    """
    given = {name: value for name, value in (options or {}).items() if value is not None}
    reason = METHODS[method].one_photo_as if method in METHODS else ""
    if reason:
        raise ValueError(f"method {method}: {reason}; give the photos of a folder one by one")
    check_method(method, given)
    sharp: Path | None = given.pop("sharp", None)
    parse_gamma(gamma)
    photos = photos_in(folder, but=sharp)
    sharps = {} if sharp is None else sharp_of(photos, sharp)
    if sharp is not None and not sharp.is_dir():
        read_image(
            sharp, gamma=gamma, variable="x"
        )  # what is wrong with it is wrong with every photo
    named = (
        folder if folder.name not in ("", "..") else folder.resolve()
    )  # as "." has no name of its own
    target = output or named.with_name(f"{named.name}_motion")
    claim_folder(target, [_SUMMARY], force=force)
    for photo in photos:
        claim_folder(target / photo.stem, CALIBRATION_FILES, force=force)
    by_label = {_label(photo): photo for photo in photos}
    failures = {
        label: reason for label, photo in by_label.items() if (reason := unreadable(photo))
    }
    version = estimator_version(method)
    cells = [
        Cell(
            (label,),
            estimate_photo,
            {
                "photo": photo,
                "method": method,
                "gamma": gamma,
                "seed": seed,
                "sharp": sharps.get(photo),
                **given,
            },
            version,
        )
        for label, photo in by_label.items()
        if label not in failures
    ]

    def write(label: str, figures: Mapping[str, Figure]) -> dict[str, Any]:
        """Write what was found in a photo as ``cep calibrate PHOTO`` does."""
        photo = by_label[label]
        try:
            read = read_photo(photo, gamma=gamma)
        except (
            ValueError,
            OSError,
        ) as error:  # it was there when its motion was estimated, maybe hours ago
            raise NotWrittenError(f"has changed since: {error}") from None
        found, warnings = estimate_from_figures(figures)
        source = {"image": str(photo), "seed": seed}
        bits = min(read.bits, 16)
        calibration = Calibration.of(found, read.pixels)
        files = calibration.save(
            target / photo.stem, source=source, force=force, bits=bits, gamma=gamma
        )
        return calibration.to_dict(
            files, seconds=cast(float, figures["seconds"]), warnings=warnings
        )

    return run_folder(
        target,
        {label: target / photo.stem for label, photo in by_label.items()},
        cells,
        noun="photos",
        files=CALIBRATION_FILES,
        summary=_SUMMARY,
        columns=_COLUMNS,
        failures=failures,
        write=write,
        engine=Engine.of(target, cache=None, workers=workers, dask=None),
        force=force,
        progress=progress,
    )


def photos_in(folder: Path | str, *, but: Path | None = None) -> tuple[Path, ...]:
    """List the photos of a folder, sorted; no hidden files, no subfolders, and no pictures of
    PSFs.

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
    found = [
        path
        for path in sorted(root.iterdir())
        if path.suffix.lower() in PHOTO_SUFFIXES
        and not path.name.startswith(".")
        and not (path.name.endswith("_psf.png") and path.with_suffix(".npy").is_file())
        and (
            path.is_file() or not path.exists()
        )  # a link that leads nowhere is told of, not passed over
        and not (but is not None and path.exists() and path.samefile(but))
    ]
    if not found:
        raise ValueError(
            f"{root}: holds no photos (.png, .tif, .jpg, .webp or RAW files; subfolders are left"
            " alone)"
        )
    by_stem: dict[str, Path] = {}
    for path in found:
        other = by_stem.setdefault(
            path.stem.casefold(), path
        )  # some file systems do not tell A from a
        if other is not path:
            raise ValueError(
                f"{root}: {other.name} and {path.name} would be written to one folder {path.stem};"
                " rename one of them"
            )
    return tuple(found)


def unreadable(photo: Path) -> str:
    """Say why a photo cannot even be opened, empty where it can; and a name that no table can hold
    is refused.
    """
    if not is_spelled(photo.name):
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


def _label(photo: Path) -> str:
    """Return the photo's name as it can be printed, whatever bytes it has."""
    return photo.name.encode("utf-8", "backslashreplace").decode()
