"""The motion in each photo of a folder: ``cep calibrate FOLDER``.

Which of its files are photos, which sharp photo belongs to each, and what is written of each.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joblib import cpu_count

from cep.calibration.calibrate import CALIBRATION_FILES, Calibration, check_method
from cep.calibration.folder_processes import (
    PhotoEstimate,
    PhotoTask,
    content_hash,
    estimate_photos,
)
from cep.files.images import PHOTO_SUFFIXES, parse_gamma, read_image, read_photo
from cep.files.tables import csv_lines
from motdiff.estimators.registry import METHODS
from motdiff.files.json_files import plain
from motdiff.files.outputs import claim_folder, new_files, write_text
from motdiff.progress import in_words

NOT_REACHED = "left out"
"""The ``failure`` of a photo that was not reached, after Ctrl-C."""

_SUMMARY = "motions.csv"
_FINISHED = ".finished.jsonl"
"""Table in the output, a line for each finished photo: what it was made of, its files and result.
Lines are only added, so that a run that is killed loses one at most."""
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


@dataclass(frozen=True)
class FolderResults:
    """Results for the photos of a folder.

    Attributes
    ----------
    folder : Path
        With a folder for each photo.
    summary : Path
        The table, CSV.
    figures : mapping from a photo's name to its figures, with ``warnings``
        Without those that failed or were not reached.
    rows : sequence of mapping
        The table's: the name, the figures, ``warnings`` and ``failure``, a reason or empty.
    missing : int
        Not reached, after Ctrl-C.
    warnings : sequence of str
    """

    folder: Path
    summary: Path
    figures: Mapping[str, Mapping[str, Any]]
    rows: Sequence[Mapping[str, Any]]
    missing: int
    warnings: Sequence[str]


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

    Each photo is written as soon as its motion is found. A photo that an earlier run has finished
    with the same options is not estimated again, if its files are as they were written.

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
        Whether existing files may be replaced. Those of a photo that fails now are removed: left
        there they would pass for results of this run.
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
    # left-out options are no part of a photo's fingerprint
    set_options = {name: value for name, value in (options or {}).items() if value is not None}
    if method in METHODS and (reason := METHODS[method].one_photo_as):
        raise ValueError(f"method {method}: {reason}; give the photos of a folder one by one")
    check_method(method, set_options)
    parse_gamma(gamma)
    sharp: Path | None = set_options.get("sharp")
    photos = photos_in(folder, but=sharp)
    sharps: dict[Path, Path] = {}
    if sharp is not None:
        sharps = sharp_of(photos, sharp)
        if not sharp.is_dir():
            # what is wrong with it is wrong with every photo
            read_image(sharp, gamma=gamma, variable="x")
    if output is None:
        if folder.name in ("", ".."):  # "." has no name of its own
            folder = folder.resolve()
        output = folder.with_name(f"{folder.name}_motion")
    # all of them before any work: one in the way must not show up hours later
    claim_folder(output, [_SUMMARY], force=force)
    for photo in photos:
        claim_folder(output / photo.stem, CALIBRATION_FILES, force=force)
    by_label = {_printable_name(photo): photo for photo in photos}
    failures = {
        label: reason for label, photo in by_label.items() if (reason := _unreadable(photo))
    }
    tasks = {}
    for label, photo in by_label.items():
        if label not in failures:
            if sharps:
                set_options = set_options | {"sharp": sharps[photo]}
            tasks[label] = PhotoTask(photo, method, set_options, gamma, seed)
    run = _Run(output, tasks, failures, force=force, progress=progress)
    run.run(workers or cpu_count())
    if force:
        # the files of an earlier run would pass for this one's
        for label in run.failures:
            _discard(output / by_label[label].stem)
    return run.results(list(by_label))


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


def _unreadable(photo: Path) -> str:
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


def _printable_name(photo: Path) -> str:
    """Return the photo's name as it can be printed, whatever bytes it has."""
    return photo.name.encode("utf-8", "backslashreplace").decode()


class _Run:
    """The estimates of a folder's photos: those finished, those that failed, and their table."""

    def __init__(
        self,
        folder: Path,
        tasks: Mapping[str, PhotoTask],
        failures: Mapping[str, str],
        *,
        force: bool,
        progress: Callable[[float, str], None],
    ) -> None:
        self.failures = dict(failures)
        self._finished: dict[str, Mapping[str, Any]] = {}
        self._folder = folder
        self._tasks = tasks
        self._keys = {label: task.key() for label, task in tasks.items()}
        self._force = force
        self._progress = progress

    def run(self, workers: int) -> None:
        """Take over what is finished, estimate and write the rest; Ctrl-C ends it early."""
        count = len(self._tasks)
        self._finished = self._read_finished()
        waiting = {
            label: task for label, task in self._tasks.items() if label not in self._finished
        }
        self._progress(0.0, f"0 of {count} photos")
        if self._finished:
            self._progress(len(self._finished) / count, f"{len(self._finished)} of {count} photos")
        started = time.monotonic()
        in_hand: tuple[str, PhotoEstimate] | None = None
        try:
            # closing ends the processes, also when Ctrl-C or a full disk ends the loop
            with closing(estimate_photos(waiting, workers)) as estimates:
                for number, in_hand in enumerate(estimates, 1):
                    self._write(*in_hand)
                    # by this run alone: photos finished by an earlier one took no time
                    left_s = (time.monotonic() - started) / number * (len(waiting) - number)
                    finished = count - len(waiting) + number
                    note = f"{finished} of {count} photos, about {in_words(left_s)} left"
                    self._progress(finished / count, note)
        except KeyboardInterrupt:
            # an estimate that was being written is finished: it took longer than its writing does
            if in_hand is not None and in_hand[0] not in {*self._finished, *self.failures}:
                self._write(*in_hand)
            return

    def _read_finished(self) -> dict[str, Mapping[str, Any]]:
        """Read the results of photos that an earlier run finished in the same way."""
        try:
            lines = (self._folder / _FINISHED).read_text(encoding="utf-8").splitlines()
        except OSError:
            return {}
        finished = {}
        for line in lines:
            try:
                record = json.loads(line)
                label = record["photo"]
                place = self._folder / self._tasks[label].photo.stem
                is_whole = record["key"] == self._keys[label] and all(
                    content_hash(place / name) == content
                    for name, content in record["files"].items()
                )
            except (ValueError, KeyError, TypeError, OSError):
                continue  # a line cut short, a photo that is gone, or a damaged or missing file
            if is_whole:
                paths = {name: place / name for name in record["files"]}
                finished[label] = record["result"] | {
                    "trajectory": paths["trajectory.json"],
                    "psf": paths["psf.npy"],
                    "files": list(paths.values()),
                }
        return finished

    def _write(self, label: str, estimated: PhotoEstimate) -> None:
        """Write the motion in a photo as ``cep calibrate PHOTO`` does."""
        if estimated.estimate is None:
            self.failures[label] = estimated.failure
            return
        task = self._tasks[label]
        try:
            photo = read_photo(task.photo, gamma=task.gamma)
        except (ValueError, OSError) as error:
            # it was there when its motion was estimated, perhaps minutes ago
            self.failures[label] = f"has changed since: {error}"
            return
        calibration = Calibration.of(estimated.estimate, photo.pixels)
        files = calibration.save(
            self._folder / task.photo.stem,
            source={"image": str(task.photo), "seed": task.seed},
            force=self._force,
            bits=min(photo.bits, 16),  # a PNG has no floating point
            gamma=task.gamma,
        )
        result = calibration.to_dict(files, seconds=estimated.seconds, warnings=estimated.warnings)
        record = {
            "photo": label,
            "key": self._keys[label],
            "files": {name: content_hash(path) for name, path in files.items()},
            "result": plain(result),
        }
        # after the photo's files: a record stands for files that are whole
        with (self._folder / _FINISHED).open("a", encoding="utf-8") as table:
            table.write(json.dumps(record) + "\n")
        self._finished[label] = result

    def results(self, labels: Sequence[str]) -> FolderResults:
        """Write the table of all photos, and return what was found."""
        finished = {label: self._finished[label] for label in labels if label in self._finished}
        outcomes = dict.fromkeys(labels, NOT_REACHED) | dict.fromkeys(finished, "") | self.failures
        rows = [
            {"photo": label, **finished.get(label, {}), "failure": outcomes[label]}
            for label in labels
        ]
        summary = self._folder / _SUMMARY
        self._folder.mkdir(parents=True, exist_ok=True)  # nothing is in it where all photos failed
        with new_files([summary], force=self._force) as staged:
            write_text(staged[summary], _csv(rows))
        missing = sum(row["failure"] == NOT_REACHED for row in rows)
        lines = [
            f"{label}: {line}" for label, result in finished.items() for line in result["warnings"]
        ]
        return FolderResults(self._folder, summary, finished, rows, missing, lines)


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Lay out the table, a line per photo; what a row lacks is empty."""
    lines = [{**row, "warnings": "; ".join(row.get("warnings", ()))} for row in rows]
    return csv_lines([_COLUMNS, *([line.get(name) for name in _COLUMNS] for line in lines)])


def _discard(folder: Path) -> None:
    """Remove the files of a calibration, and the folder where nothing else is in it."""
    if not folder.is_dir():
        return
    for name in CALIBRATION_FILES:  # what else lies there is the user's
        (folder / name).unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()
