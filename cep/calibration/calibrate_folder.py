"""The motion in each photo of a folder: ``cep calibrate FOLDER``."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import time
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

from joblib import Parallel, cpu_count, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError

from cep.calibration.calibrate import (
    CALIBRATION_FILES,
    Calibration,
    check_method,
    estimate_motion,
    read_options,
)
from cep.calibration.folder_photos import photos_in, printable_name, sharp_of, unreadable
from cep.files.images import parse_gamma, read_image, read_photo
from cep.files.tables import csv_lines
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.registry import METHODS, blind_methods
from motdiff.files.json_files import plain
from motdiff.files.outputs import claim_folder, new_files, write_text
from motdiff.files.plugins import is_reference
from motdiff.processes import end_with_parent
from motdiff.progress import in_words
from motdiff.threads import one_thread

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
_DIED = "its process died: not enough memory, or a crash in compiled code"


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


@dataclass(frozen=True)
class _Task:
    """A photo and how its motion is estimated, as a process is given it."""

    photo: Path
    method: str
    options: Mapping[str, Any]
    gamma: str
    seed: int

    def key(self) -> str:
        """Fingerprint of all that makes the estimate: files by their content."""
        from cep import __version__

        options = dict(self.options)
        for name, value in options.items():
            if isinstance(value, Path):
                options[name] = _content(value)
        code = _code_of(self.method)
        photo = _content(self.photo)
        # another version may estimate otherwise
        parts = [__version__, photo, self.method, code, options, self.gamma, self.seed]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


@dataclass(frozen=True)
class _Estimated:
    """The motion in a photo with the warnings about both, or the reason why there is none."""

    estimate: MotionEstimate | None
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    failure: str = ""


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
    by_label = {printable_name(photo): photo for photo in photos}
    failures = {
        label: reason for label, photo in by_label.items() if (reason := unreadable(photo))
    }
    tasks = {}
    for label, photo in by_label.items():
        if label not in failures:
            if sharps:
                set_options = set_options | {"sharp": sharps[photo]}
            tasks[label] = _Task(photo, method, set_options, gamma, seed)
    run = _Run(output, tasks, failures, force=force, progress=progress)
    run.run(workers or cpu_count())
    if force:
        # the files of an earlier run would pass for this one's
        for label in run.failures:
            _discard(output / by_label[label].stem)
    return run.results(list(by_label))


class _Run:
    """The estimates of a folder's photos: those finished, those that failed, and their table."""

    def __init__(
        self,
        folder: Path,
        tasks: Mapping[str, _Task],
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
        in_hand: tuple[str, _Estimated] | None = None
        try:
            # closing ends the processes, also when Ctrl-C or a full disk ends the loop
            with closing(_estimates(waiting, workers)) as estimates:
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
                    _content(place / name) == content for name, content in record["files"].items()
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

    def _write(self, label: str, estimated: _Estimated) -> None:
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
            "files": {name: _content(path) for name, path in files.items()},
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


def _estimates(
    tasks: Mapping[str, _Task], workers: int
) -> Generator[tuple[str, _Estimated], None, None]:
    """Yield the estimates as they are made, in this process or in others of one thread each."""
    if workers == 1 or len(tasks) < 2:  # processes would cost the seconds of loading torch
        for label, task in tasks.items():
            yield label, _estimated(task)
        return
    waiting = dict(tasks)
    while waiting:
        try:
            with closing(_in_processes(waiting, workers)) as estimates:
                for label, estimated in estimates:
                    del waiting[label]
                    yield label, estimated
        except TerminatedWorkerError:
            # one of the photos that were handed out ended its process: each alone shows which
            for label in list(islice(waiting, 2 * workers)):  # as many as pre_dispatch hands out
                task = waiting.pop(label)
                try:
                    yield from _in_processes({label: task}, workers)
                except TerminatedWorkerError:
                    yield label, _Estimated(None, failure=_DIED)


def _in_processes(
    tasks: Mapping[str, _Task], workers: int
) -> Generator[tuple[str, _Estimated], None, None]:
    beginning = {"initializer": _begin_worker, "initargs": (os.getpid(),)}
    with (
        parallel_config("loky", n_jobs=workers, inner_max_num_threads=1, **beginning),
        warnings.catch_warnings(),
    ):
        # loky restarts processes whose memory has grown, as PyTorch's does, and warns of it;
        # joblib warns of the photos that Ctrl-C leaves out
        warnings.simplefilter("ignore", UserWarning)
        # one photo a batch: each is written as soon as its motion is found
        run = Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch=2 * workers)
        stream = run(delayed(_in_folder)(Path.cwd(), label, task) for label, task in tasks.items())
        try:
            yield from stream
        finally:
            stream.close()


def _begin_worker(parent: int) -> None:
    # a terminal sends Ctrl-C to this process too; joblib ends it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(parent)


def _in_folder(folder: Path, label: str, task: _Task) -> tuple[str, _Estimated]:
    os.chdir(folder)  # joblib's processes may be those of an earlier run in another folder
    return label, _estimated(task)


def _estimated(task: _Task) -> _Estimated:
    """Estimate the motion in a photo; an exception becomes the reason of a failure."""
    # as many as there are workers run at once, and sums must not depend on how many do
    threads: AbstractContextManager[None] = nullcontext()
    if task.method in blind_methods():
        threads = one_thread()
    try:
        photo = read_photo(task.photo, gamma=task.gamma)
        values = read_options(task.method, task.options, gamma=task.gamma)
        started = time.perf_counter()
        with threads:
            estimate = estimate_motion(photo.pixels, method=task.method, seed=task.seed, **values)
        seconds = time.perf_counter() - started
    except Exception as error:  # whatever a photo or a user-defined estimator raises
        text = str(error)
        if not text or not isinstance(error, ValueError | RuntimeError):
            text = f"{type(error).__name__}: {error}".removesuffix(": ")
        # one line without the photo's name, which stands in the table beside it
        return _Estimated(None, failure=" ".join(text.removeprefix(f"{task.photo}: ").split()))
    notes = [line.removeprefix(f"{task.photo}: ") for line in photo.warnings]
    return _Estimated(estimate, (*notes, *estimate.warnings), seconds)


def _content(path: Path) -> str:
    """Fingerprint of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _code_of(method: str) -> str:
    """Fingerprint of a user-defined estimator's module; that of others is the version's."""
    if not is_reference(method):
        return ""
    spec = find_spec(method.partition(":")[0])
    if spec is None or spec.origin is None:  # no file to tell versions by
        return ""
    return _content(Path(spec.origin))


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
