"""Estimates of the photos of a folder, in processes of one thread each."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import time
import warnings
from collections.abc import Generator, Mapping
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError

from cep.calibration.calibrate import estimate_motion, read_options
from cep.files.images import read_photo
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.registry import blind_methods
from motdiff.files.plugins import is_reference
from motdiff.processes import end_with_parent
from motdiff.threads import one_thread

_DIED = "its process died: not enough memory, or a crash in compiled code"


@dataclass(frozen=True)
class PhotoTask:
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
                options[name] = content_hash(value)
        code = _code_hash(self.method)
        photo = content_hash(self.photo)
        # another version may estimate otherwise
        parts = [__version__, photo, self.method, code, options, self.gamma, self.seed]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


@dataclass(frozen=True)
class PhotoEstimate:
    """The motion in a photo with the warnings about both, or the reason why there is none."""

    estimate: MotionEstimate | None
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    failure: str = ""


def estimate_photos(
    tasks: Mapping[str, PhotoTask], workers: int
) -> Generator[tuple[str, PhotoEstimate], None, None]:
    """Yield the estimates as they are made, in this process or in others of one thread each."""
    if workers == 1 or len(tasks) < 2:  # processes would cost the seconds of loading torch
        for label, task in tasks.items():
            yield label, _estimate_photo(task)
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
                    yield label, PhotoEstimate(None, failure=_DIED)


def _in_processes(
    tasks: Mapping[str, PhotoTask], workers: int
) -> Generator[tuple[str, PhotoEstimate], None, None]:
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


def _in_folder(folder: Path, label: str, task: PhotoTask) -> tuple[str, PhotoEstimate]:
    os.chdir(folder)  # joblib's processes may be those of an earlier run in another folder
    return label, _estimate_photo(task)


def _estimate_photo(task: PhotoTask) -> PhotoEstimate:
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
        return PhotoEstimate(None, failure=" ".join(text.removeprefix(f"{task.photo}: ").split()))
    notes = [line.removeprefix(f"{task.photo}: ") for line in photo.warnings]
    return PhotoEstimate(estimate, (*notes, *estimate.warnings), seconds)


def content_hash(path: Path) -> str:
    """Fingerprint of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _code_hash(method: str) -> str:
    """Fingerprint of a user-defined estimator's module; that of others is the version's."""
    if not is_reference(method):
        return ""
    spec = find_spec(method.partition(":")[0])
    if spec is None or spec.origin is None:  # no file to tell versions by
        return ""
    return content_hash(Path(spec.origin))
