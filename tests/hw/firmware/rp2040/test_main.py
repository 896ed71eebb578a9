"""The shipped `main.py`, `cxp.py` and `pio_shutter.py` together on an emulated RP2040, spoken to
by the real driver."""

from __future__ import annotations

import importlib.util
import json
import os
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from emulators.tools import give_up, require_node_module

from hw.cxp.protocol import TEXT, Op, ResetCause, State, pack_arm, request_body
from hw.device import DeviceProfile
from hw.drivers.cxp import PROVEN_FIRMWARE, Controller
from hw.drivers.driver import Trust
from hw.errors import DeviceError
from hw.port import PortError
from hw.program import Program

ROOT = Path(__file__).parents[4]
FIRMWARE = ROOT / "hw" / "firmware" / "rp2040"
RASKAR = "1010000111000001010000110011110111010111001001100111"


class Pico:
    """The emulated board; a context manager."""

    def __init__(self, folder: Path) -> None:
        command = [
            sys.executable,
            "-W",
            "error",
            "-m",
            "emulators.rp2040js.run_board",
            str(folder),
        ]
        path = os.pathsep.join([str(ROOT / "tests"), str(ROOT)])
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": path},
        )
        self.port = self._process.stdout.readline().strip()

    def __enter__(self) -> Pico:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.wait(timeout=10)
        self._process.stdout.close()

    def ask(self, *command: object):
        self._process.stdin.write(json.dumps(command) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def played(self) -> list[tuple[int, int]]:
        """Edges since the last question, from the first one, in ns."""
        edges = self.ask("edges", 15)
        return [((cycle - edges[0][0]) * 8, level) for cycle, level in edges]


@pytest.fixture(autouse=True)
def _tools() -> None:
    require_node_module("rp2040js")
    if importlib.util.find_spec("adafruit_pioasm") is None:
        give_up("adafruit-circuitpython-pioasm not installed")


@pytest.fixture
def pico() -> Iterator[Pico]:
    with Pico(FIRMWARE) as board:
        yield board


def from_first(program: Program) -> list[tuple[int, int]]:
    return [(at - program.edges[0][0], level) for at, level in program.edges]


def test_upload_arm_trigger(pico):
    program = Program(RASKAR, chip_ns=200_000)
    with Controller.open(pico.port) as controller:
        told = controller.announced
        assert (told.firmware, told.max_chips, told.tick_ns, told.fractions) == (
            "cxp-rp2040 1",
            287,
            8,
            False,
        )
        assert told.trigger_input
        assert told.reset_cause is ResetCause.POWER
        assert told.firmware in PROVEN_FIRMWARE
        assert pico.ask("edges", 15) == []
        report = controller.upload(program, arm=True)
        assert report.trust is Trust.A
        assert controller.status().state is State.ARMED
        controller.trigger()
        status = controller.wait(timeout_s=20.0)
        assert (status.state, status.pos, status.runs, status.late) == (State.DONE, 52, 1, 0)
        assert pico.played() == from_first(program)
        controller.arm(lease_ms=60_000)
        pico.ask("input", 14, 1)
        while controller.status().runs < 2:
            pass
        assert controller.status().state is State.DONE
        assert pico.played() == from_first(program)


def test_random_programs_with_status_polled(pico):
    rng = random.Random(30)
    with Controller.open(pico.port) as controller:
        for _ in range(6):
            bits = "".join(rng.choice("01") for _ in range(rng.randint(15, 286))) + "1"
            program = Program(bits, chip_ns=8 * rng.randint(125, 2000))
            controller.upload(program, arm=True)
            controller.trigger()
            assert controller.wait(timeout_s=20.0).pos == len(bits)
            assert pico.played() == from_first(program)


def test_abort_and_the_end_of_the_lease(pico):
    program = Program("1" * 50, chip_ns=1_000_000)
    with Controller.open(pico.port) as controller:
        controller.upload(program, arm=True)
        controller.trigger()
        assert controller.status().state is State.PLAY
        controller.abort()
        assert controller.status().state is State.LOADED
        edges = pico.ask("edges", 15)
        assert [level for _, level in edges] == [1, 0]
        assert 8 * (edges[1][0] - edges[0][0]) < 50_000_000
        controller.link.request(Op.ARM, pack_arm(10))
        while controller.status().state is not State.LOADED:
            pass
        pico.ask("input", 14, 1)
        controller.status()
        assert pico.ask("edges", 15) == []


def test_noise_on_the_line(pico):
    """Half frames, binary frames and a lone Ctrl-C are no reason to stop."""
    with Controller.open(pico.port) as controller:
        before = controller.status().bad_frames
        say(pico.port, b"\x03\x03:0102\n\x05\x03\x00\n\r\n")
        assert controller.status().bad_frames == before + 2


def test_carriage_return_and_ctrl_c_give_the_console_back(pico):
    with Controller.open(pico.port) as controller:
        controller.upload(Program("11", chip_ns=10_000_000), arm=True)
        controller.trigger()
    log = pico.ask("log")
    assert log == ["freq 125000000", "kbd_intr -1", "watchdog 2000", "feed"]
    say(pico.port, b"\r\x03")
    while pico.ask("log")[-1] != "returned":
        pass
    assert pico.ask("log")[-2:] == ["kbd_intr 3", "returned"]
    assert [level for _, level in pico.ask("edges", 15)] == [1, 0]
    assert not pico.ask("__getitem__", 0x40058000) & 1 << 30  # the watchdog stands still
    with pytest.raises(PortError, match="silent"):
        Controller.open(pico.port, hello_s=0.5)


def test_limits_of_the_shutter(tmp_path):
    """Edited at the top of `main.py`; kept by host and board."""
    for name in ("cxp_text.py", "cxp.py", "pio_shutter.py", "main.py"):
        text = (FIRMWARE / name).read_text(encoding="utf-8")
        text = text.replace("MAX_ON_US = 0 ", "MAX_ON_US = 500 ").replace(
            "MAX_DUTY = 1000 ", "MAX_DUTY = 500 "
        )
        (tmp_path / name).write_text(text, encoding="utf-8")
    with Pico(tmp_path) as board, Controller.open(board.port) as controller:
        limits = controller.limits
        assert (limits.max_on_ns, limits.max_duty) == (500_000, 0.5)
        with pytest.raises(ValueError, match="500"):
            controller.upload(Program("1110000", chip_ns=200_000))
        with pytest.raises(DeviceError, match="too long"):
            controller.load(Program("1110000", chip_ns=200_000))
        with pytest.raises(DeviceError, match="too much of the time"):
            controller.load(Program("1101100", chip_ns=250_000))
        controller.upload(Program("110000", chip_ns=250_000), profile=DeviceProfile(name="own"))


@pytest.mark.slow  # an emulated board that restarts
def test_a_play_cut_short_is_owed_after_a_reset_too(tmp_path):
    """A register that only the loss of power clears holds the closed time; resets themselves are
    not emulated."""
    scratch = 0x4005800C
    program = Program("1" + "0" * 49, chip_ns=400_000_000)
    for name in ("cxp_text.py", "cxp.py", "pio_shutter.py", "main.py"):
        text = (FIRMWARE / name).read_text(encoding="utf-8")
        (tmp_path / name).write_text(
            text.replace("MAX_DUTY = 1000 ", "MAX_DUTY = 500 "), encoding="utf-8"
        )
    with Pico(tmp_path) as board:
        with Controller.open(board.port) as controller:
            assert board.ask("__getitem__", scratch) == 0
            controller.upload(program, arm=True)
            assert board.ask("__getitem__", scratch) == 20_001
            controller.abort()
            assert controller.status().state is State.LOADED
            assert board.ask("__getitem__", scratch) == 0
            controller.arm()
            controller.trigger()
            controller.abort()
            with pytest.raises(DeviceError, match="cut short"):
                controller.arm()
        owed_ms = board.ask("__getitem__", scratch)
    assert 0 < owed_ms <= 20_001
    started = "import machine; machine.mem32[0x4005800C] = 1000\n"
    (tmp_path / "main.py").write_text(
        started + (tmp_path / "main.py").read_text(encoding="utf-8"), encoding="utf-8"
    )
    with Pico(tmp_path) as board, Controller.open(board.port) as controller:
        with pytest.raises(DeviceError, match="cut short"):
            controller.upload(program, arm=True)
        while board.ask("__getitem__", scratch):
            controller.status()
        controller.arm()


def say(port: str, data: bytes) -> None:
    """Write beside the driver, which holds the port for itself."""
    door = os.open(port, os.O_WRONLY | os.O_NOCTTY)
    os.write(door, data)
    os.close(door)


def test_raw_frames(pico):
    """The bytes on the line: ARM without a program, and its refusal."""
    with Controller.open(pico.port):
        pass
    with open(os.open(pico.port, os.O_RDWR | os.O_NOCTTY), "r+b", buffering=0) as line:
        line.write(TEXT.encode(request_body(Op.ARM, 9, pack_arm(100))))
        replies = b""
        while (
            not replies.endswith(b"\n") or b":8409" not in replies
        ):  # HELLO may have been answered twice
            replies += line.read(100)
    assert replies.endswith(TEXT.encode(bytes([Op.ARM | 0x80, 9, 4])))
