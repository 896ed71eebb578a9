"""Record of a checkout: what every case prints and writes."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from lab.studies.goldens.cases import CASES, FOLDER_PHOTOS, PREPARATION, Case
from lab.studies.goldens.inputs import drawn_inputs
from lab.studies.goldens.placeholders import PASSED_OVER, normalised, normalised_file

COPIED_BYTES = 200_000
"""Files up to this size are copied into the record."""

LIMIT_S = 240.0
"""A case that runs longer is ended, and recorded as such."""


class PreparationError(RuntimeError):
    """A command failed that others need."""


@dataclass(frozen=True)
class Outcome:
    """What a command left behind.

    Attributes
    ----------
    stdout, stderr : str
        Normalised.
    exit_status : str
        Exit code, or ``ended after N s``.
    """

    stdout: str
    stderr: str
    exit_status: str


class Recorder:
    """Runs cases of a checkout and stores what they leave behind.

    Parameters
    ----------
    root : Path
        The checkout, with its ``.venv``.
    target : Path
        Folder of the record.
    scratch : Path
        Temporary folder for the home and the working folders.
    """

    def __init__(self, root: Path, target: Path, scratch: Path) -> None:
        self._root = root
        self._target = target
        self._scratch = scratch
        self._home = scratch / "home"
        self._temporary = scratch / "tmp"
        for folder in (self._home, self._temporary):
            folder.mkdir()
        self.seconds: dict[str, float] = {}

    def prepare(self, folder: Path) -> None:
        """Make the inputs in a folder, and record the commands that do.

        Raises
        ------
        PreparationError
            If one of them fails: the cases would all be recorded without its input.
        """
        for name, data in drawn_inputs().items():
            write_file(folder / name, data)
        for case in PREPARATION:
            require_success(case.name, self._record(case, folder))
        for source, copy in FOLDER_PHOTOS.items():
            write_file(folder / copy, (folder / source).read_bytes())

    def record(self, case: Case, inputs: Path) -> None:
        """Run a case in a fresh folder."""
        folder = self._scratch / "work"
        shutil.copytree(inputs, folder)
        try:
            self._record(case, folder)
        finally:
            shutil.rmtree(folder)

    def _record(self, case: Case, folder: Path) -> Outcome:
        before = digests(folder)
        started = time.monotonic()
        if case.emulator:
            with self._emulator(folder):
                outcome = self._run(case, folder)
        else:
            outcome = self._run(case, folder)
        self.seconds[case.name] = round(time.monotonic() - started, 1)
        self._store(case, folder, outcome, before)
        return outcome

    def _run(self, case: Case, folder: Path) -> Outcome:
        if case.first:
            require_success(case.name, self._finish(case.first, folder))
        return self._finish(case.argv, folder)

    def _finish(self, command: str, folder: Path) -> Outcome:
        process = self._start(shlex.split(command), folder)
        try:
            stdout, stderr = process.communicate(timeout=LIMIT_S)
            status = str(process.returncode)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            stdout, stderr = process.communicate()
            status = f"ended after {LIMIT_S:g} s"
        places = self._places(folder)
        texts = (data.decode("utf-8", "backslashreplace") for data in (stdout, stderr))
        names = ("stdout", "stderr")
        normal_out, normal_err = (
            normalised(text, name, places) for text, name in zip(texts, names, strict=True)
        )
        return Outcome(normal_out, normal_err, status)

    def _start(self, words: Sequence[str], folder: Path) -> subprocess.Popen[bytes]:
        programs = self._root / ".venv" / "bin"
        return subprocess.Popen(
            [str(programs / words[0]), *words[1:]],
            cwd=folder,
            env=self._environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )

    @contextmanager
    def _emulator(self, folder: Path) -> Iterator[None]:
        """Run an emulated controller at the port ``uno`` of a folder."""
        process = self._start(["cep", "hw", "emulate", "uno", "--link", "uno"], folder)
        patience = time.monotonic() + 60.0
        while (
            not (folder / "uno").exists()
            and process.poll() is None
            and time.monotonic() < patience
        ):
            time.sleep(0.05)
        try:
            if not (folder / "uno").exists():
                raise PreparationError("the emulated controller did not start: no port uno")
            yield
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
            process.communicate(timeout=30)

    def _environment(self) -> dict[str, str]:
        return {
            "PATH": os.environ.get("PATH", os.defpath),
            "PYTHONPATH": str(self._root),
            "HOME": str(self._home),
            "XDG_CACHE_HOME": str(self._home / "cache"),
            "XDG_CONFIG_HOME": str(self._home / "config"),
            "TMPDIR": str(self._temporary),
            "COLUMNS": "100",
            "NO_COLOR": "1",
            "TERM": "dumb",
            "TZ": "UTC",
            "LC_ALL": "C.UTF-8",
            "PYTHONHASHSEED": "0",
            "OMP_NUM_THREADS": "1",
            "SOURCE_DATE_EPOCH": "0",
        }

    def _places(self, folder: Path) -> dict[str, str]:
        return {
            str(folder): "<work>",
            str(self._root): "<root>",
            str(self._scratch): "<temporary>",
        }

    def _store(
        self, case: Case, folder: Path, outcome: Outcome, before: Mapping[str, str]
    ) -> None:
        target = self._target / case.name
        target.mkdir()
        for name in ("stdout", "stderr"):
            (target / name).write_text(getattr(outcome, name), encoding="utf-8")
        (target / "exit").write_text(outcome.exit_status + "\n", encoding="utf-8")
        places = self._places(folder)
        written = {}
        after = digests(folder)
        for name in sorted(name for name in after if after[name] != before.get(name)):
            data = normalised_file(folder / name, name, places)
            written[name] = hashlib.sha256(data).hexdigest()
            if len(data) < COPIED_BYTES:
                write_file(target / "files" / name, data)
        written.update(dict.fromkeys(sorted(before.keys() - after.keys()), "removed"))
        (target / "files.json").write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")


def require_success(name: str, outcome: Outcome) -> None:
    """Refuse to go on after a command that prepares a case and failed."""
    if outcome.exit_status != "0":
        reason = " ".join(outcome.stderr.split())
        raise PreparationError(f"{name}: its preparation: exit {outcome.exit_status}: {reason}")


def digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of the files of a folder, but for byte code and finished cells."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
        and "__pycache__" not in path.parts
        and not PASSED_OVER.fullmatch(path.relative_to(folder).as_posix())
    }


def write_file(path: Path, data: bytes) -> None:
    """Write a file, and its folder where there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def record(root: Path, target: Path, *, inputs: Path | None, only: str) -> None:
    """Record all cases of a checkout.

    Parameters
    ----------
    root : Path
        The checkout.
    target : Path
        Folder of the record; it must not exist.
    inputs : Path or None
        Inputs of an earlier record, to be used for the cases.
    only : str
        Pattern of the names of cases to run; all when empty.

    Raises
    ------
    PreparationError
        If a command fails that makes inputs.
    """
    target.mkdir(parents=True)
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="goldens-") as temporary:
        recorder = Recorder(root.resolve(), target, Path(temporary).resolve())
        if inputs is None or not only:
            prepared = Path(temporary).resolve() / "inputs"
            prepared.mkdir()
            recorder.prepare(prepared)
            inputs = prepared if inputs is None else inputs
        shutil.copytree(inputs, target / "inputs")
        for case in CASES:
            if re.search(only, case.name):
                recorder.record(case, target / "inputs")
                print(f"{recorder.seconds[case.name]:6.1f} s  {case.name}", flush=True)
    (target / "seconds.json").write_text(
        json.dumps(recorder.seconds, indent=1) + "\n", encoding="utf-8"
    )
    print(f"{len(recorder.seconds)} cases in {time.monotonic() - started:.0f} s: {target}")
