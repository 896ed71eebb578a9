"""Faults of ``cep shoot``, 12 kinds, put into the twin and the emulated controller.

    python -m lab.studies.shoot_faults [TIMES]

Each runs the command itself. It passes when the shutter was closed within a second of the fault or
at the code's end, the camera was released, the photos taken before are whole, the exit code is
right, and one line says what counts.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar
from unittest.mock import patch

import numpy as np

import cep.shutter.shoot as shooting
from cep.commands.console import INTERRUPTED
from cep.commands.main import main as cep_main
from cep.files.images import write_image
from cep.files.shot_files import read_shot, record_beside
from cep.shutter.cameras import CAMERAS
from cep.shutter.twin import TwinCamera
from hw.cameras.camera import CameraError, CameraSettings, Frame, FrameLostError
from hw.cxp.protocol import Stored
from hw.drivers.cxp import Controller
from hw.emulation.uno import CLOCK_HZ, EmulatedUno
from lab.studies.inputs import study_parser

CODE = "1011001110100110" * 4
CHIP_NS = 400_000
_CODE_S = len(CODE) * CHIP_NS * 1e-9
_LATEST_S = 1.0  # after which the shutter has to be closed and disarmed
_SHOTS = 3
_PATIENCE_S = 60.0  # until a host plays


class FaultyTwin(TwinCamera):
    """A twin with a fault in one of its photos, whose board outlives it."""

    fault: ClassVar[str] = ""
    photo: ClassVar[int] = 1
    moment: ClassVar[float] = 0.5
    boards: ClassVar[list[EmulatedUno]] = []
    closings: ClassVar[int] = 0

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Let the board be known, as it outlives the camera."""
        FaultyTwin.boards = [self.uno]
        return super().configure(settings)

    def close(self) -> None:
        """Release the camera; the board runs on, as a real one does."""
        FaultyTwin.closings += 1

    def wait_ready(self, timeout_s: float) -> None:
        """Set a fault off, before, while or after the code plays."""
        super().wait_ready(timeout_s)
        if self._is_due("never ready"):
            raise FrameLostError("twin: it does not become ready")
        if self._is_due("port unplugged"):
            threading.Timer(self.moment * _CODE_S, self.uno.unplug).start()
        if self._is_due("controller hangs"):
            threading.Timer(self.moment * _CODE_S, self.uno.hang).start()
        if self._is_due("Ctrl-C"):
            threading.Timer(self.moment * _CODE_S, os.kill, (os.getpid(), signal.SIGINT)).start()

    def read(self, timeout_s: float) -> Frame:
        """Read a frame, or what a fault makes of it."""
        if self._stale is not None:
            frame, self._stale = self._stale, None
            return frame
        if self._armed_cycle is not None and self._is_due("camera unplugged"):
            raise CameraError("twin: the camera is gone")
        if self._armed_cycle is not None and self._is_due("frame lost"):
            self._armed_cycle = None
            raise FrameLostError("twin: no frame came")
        frame = super().read(timeout_s)
        if self._is_due("two frames", frame.frame_id):
            self._stale = replace(frame, frame_id=frame.frame_id + 1)
        if self._is_due("frame skipped", frame.frame_id):
            self._frames += 1
            return replace(frame, frame_id=self._frames)
        if self._is_due("exposure too short", frame.frame_id):
            return replace(frame, exposure_s=self.moment * _CODE_S)
        return frame

    _stale: Frame | None = None

    def _is_due(self, fault: str, photo: int | None = None) -> bool:
        return self.fault == fault and (photo or self._frames + 1) == self.photo


@dataclass(frozen=True)
class Outcome:
    """What a fault led to.

    Attributes
    ----------
    code : int
        Exit code.
    lines : tuple of str
        On standard error.
    photos, expected : int
        Photos on the disk that count, and that should.
    open_s : float
        For how long the shutter was open, or could have been opened, after the fault at most; the
        time by which the emulated pins were at rest.
    released : bool
        Whether the camera was closed.
    """

    code: int
    lines: tuple[str, ...]
    photos: int
    expected: int
    open_s: float
    released: bool

    @property
    def passed(self) -> bool:
        """Whether nothing was lost and nothing stayed open."""
        # Ctrl-C has a line of its own
        one_line = len(self.lines) == (2 if self.code == INTERRUPTED else 1)
        return (
            self.code != 0
            and one_line
            and self.photos == self.expected
            and self.open_s <= (_LATEST_S if self.lines != ("killed",) else 64 * 0.02)
            and self.released
        )


def scene(folder: Path) -> Path:
    """Write the scene that the twin sees."""
    rng = np.random.default_rng(0)
    light = np.kron(rng.uniform(0.1, 0.8, (12, 12)), np.ones((8, 8)))
    path = folder / "scene.png"
    write_image(path, light, bits=16)
    return path


def run_twin(fault: str, folder: Path, rng: np.random.Generator) -> Outcome:
    """Take three photos with a fault in one of them."""
    photo = int(rng.integers(1, _SHOTS + 1))
    if fault == "frame skipped":
        photo = max(photo, 2)  # the first has nothing to be compared with
    FaultyTwin.fault, FaultyTwin.photo = fault, photo
    FaultyTwin.moment = float(rng.uniform(0.05, 0.9))
    FaultyTwin.boards, FaultyTwin.closings = [], 0
    shot = folder / "shot"
    arguments = [
        *("shoot", "--camera", f"faulty:scene={scene(folder)},seed={rng.integers(1000)}"),
        *("--code", CODE, "--chip-ns", CHIP_NS, "--repeat", _SHOTS, "-o", shot),
    ]
    kinds = {**CAMERAS, "faulty": f"{FaultyTwin.__module__}:FaultyTwin"}
    with patch.object(shooting, "CAMERAS", kinds), _put(fault, photo, shot), _stderr() as stderr:
        code = cep_main([str(argument) for argument in arguments])
    ended_s = time.monotonic()
    board = FaultyTwin.boards[0] if FaultyTwin.boards else None
    open_s = _open_s(board, ended_s) if board is not None else 0.0
    expected = 0 if fault == "wrong readback" else photo - 1
    photos = _whole(shot)
    for spare in folder.glob("cep-*"):  # what a full disk did not take
        photos += _whole(spare)
    expected += fault == "full disk"
    return Outcome(
        code,
        tuple(stderr.getvalue().splitlines()),
        photos,
        expected,
        open_s,
        FaultyTwin.closings == 1,
    )


def run_killed(_fault: str, folder: Path, rng: np.random.Generator) -> Outcome:
    """Kill the host with signal 9 while the controller is armed, or plays."""
    plays = bool(rng.integers(2))
    how = ["--arm", "always", "--chip-ns", str(CHIP_NS)]
    if plays:
        how = ["--camera", f"folder:{folder}", "--trigger", "shutter", "--chip-ns", "20000000"]
    program = (sys.executable, "-c", "from cep.commands.main import run; run()", "shoot", *how)
    with EmulatedUno() as uno:
        host = subprocess.Popen(
            [*program, "--port", uno.port, "--code", CODE, "-o", str(folder / "shot")],
            stderr=subprocess.DEVNULL,
        )
        deadline_s = time.monotonic() + _PATIENCE_S
        while not uno.edges() and host.poll() is None and time.monotonic() < deadline_s:
            if not plays:
                uno.trigger()  # obeyed as soon as it is armed
            time.sleep(0.02)
        if not uno.edges():
            host.kill()
            line = f"the host never played; its exit code: {host.wait()}"
            return Outcome(0, (line,), 0, 0, 0.0, released=True)
        time.sleep(float(rng.uniform(0.1, 0.5)))
        killed = host.poll() is None
        host.kill()
        host.wait()
        cycle = uno.cycle()
        if plays:  # the firmware's own limit is the code's end
            time.sleep(64 * 0.02 + 0.1)
            closed_cycles = [when for when, level in uno.edges() if when > cycle and not level]
            open_s = (closed_cycles[-1] - cycle) / CLOCK_HZ if closed_cycles else 0.0
        else:
            time.sleep(_LATEST_S + 0.1)
            uno.trigger()  # the killed host renews no lease: the shutter must stay closed
            time.sleep(0.1)
            open_s = 99.0 if uno.edges()[-1][0] > cycle else 0.0
        is_open = uno.edges()[-1][1] or uno.edges("busy")[-1][1]
    return Outcome(
        int(killed), ("killed",), 0, 0, 99.0 if is_open else min(open_s, 99.0), released=True
    )


FAULTS: dict[str, Callable[[str, Path, np.random.Generator], Outcome]] = {
    "frame lost": run_twin,
    "camera unplugged": run_twin,
    "never ready": run_twin,
    "two frames": run_twin,
    "frame skipped": run_twin,
    "exposure too short": run_twin,
    "wrong readback": run_twin,
    "port unplugged": run_twin,
    "controller hangs": run_twin,
    "Ctrl-C": run_twin,
    "full disk": run_twin,
    "kill -9": run_killed,
}


def run(fault: str, seed: int) -> Outcome:
    """Run one fault at a moment that the seed chooses."""
    rng = np.random.default_rng([seed, *fault.encode()])
    with tempfile.TemporaryDirectory() as folder:
        return FAULTS[fault](fault, Path(folder), rng)


@contextlib.contextmanager
def _put(fault: str, photo: int, shot: Path) -> Iterator[None]:
    """Put those faults in that are not the camera's."""
    import tifffile

    imwrite, read = tifffile.imwrite, Controller.read

    def full(path: Path, *arguments: Any, **options: Any) -> None:
        if Path(path).name == f"photo_{photo:03d}.tif" and "cep-" not in str(path):
            raise OSError(28, "No space left on device", str(path))
        imwrite(path, *arguments, **options)

    def other(controller: Controller) -> Stored:
        stored = read(controller)
        return replace(stored, bits="1" + stored.bits[1:])

    spare = partial(tempfile.mkdtemp, dir=shot.parent)
    with contextlib.ExitStack() as stack:
        if fault == "full disk":
            stack.enter_context(patch("tifffile.imwrite", full))
            stack.enter_context(patch("cep.files.shot_files.mkdtemp", spare))
        if fault == "wrong readback":
            stack.enter_context(patch.object(Controller, "read", other))
        yield


@contextlib.contextmanager
def _stderr() -> Iterator[io.StringIO]:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as e:
        yield e


def _open_s(board: EmulatedUno, ended_s: float) -> float:
    """Time after the command's end until no trigger opens the shutter; 0 if none did at once."""
    trigger_cycle = board.cycle()
    board.trigger()
    time.sleep(0.05)
    edges = [edge for edge in board.edges() if edge[0] >= trigger_cycle]
    is_open = bool(board.edges()) and board.edges()[-1][1] == 1
    if not edges and not is_open:
        board.stop()
        return 0.0
    while board.edges()[-1][1] or board.edges("busy")[-1][1]:
        time.sleep(0.01)
        if time.monotonic() - ended_s > 10:
            break
    last_s = (board.edges()[-1][0] - trigger_cycle) / CLOCK_HZ
    board.stop()
    return last_s


def _whole(shot: Path) -> int:
    """Photos on the disk that count and can be read."""
    photos = sorted(shot.glob("photo_*.tif"))
    records = [(path, record_beside(path)) for path in photos]
    for path, record in records:
        if record is not None:
            read_shot(path, record)
    return sum(record is not None and record.counts for _path, record in records)


def table(times: int) -> None:
    """Print how many of each kind passed."""
    total = 0
    print("| fault | passed | shutter closed after, s, at most | line |")
    print("|---|---|---|---|")
    for fault in FAULTS:
        outcomes = [run(fault, seed) for seed in range(times)]
        passed = sum(outcome.passed for outcome in outcomes)
        total += passed
        worst_s = max(outcome.open_s for outcome in outcomes)
        line = (outcomes[0].lines or ("",))[0]
        print(f"| {fault} | {passed} of {times} | {worst_s:.2f} | {line} |", flush=True)
        for outcome in outcomes:
            if not outcome.passed:
                print(outcome, file=sys.stderr)
    print(f"\n{total} of {times * len(FAULTS)} passed")


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("times", type=int, nargs="?", default=20, help="of each fault")
    options = parser.parse_args()
    # a shell starts what runs in the background deaf to Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)
    table(options.times)


if __name__ == "__main__":
    main()
