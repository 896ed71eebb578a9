"""The controller's protocol core `cxp.py` on MicroPython 1.27: docs/cxp1.md, and what only this
device has."""

from __future__ import annotations

import ast
import binascii
import random
import struct
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from emulators import conformance
from emulators.conformance import (
    ABORT,
    ARM,
    CODE,
    DUTY_LIMIT,
    FAULT,
    HELLO,
    LOAD,
    LOADED,
    OK,
    PLAY,
    STATUS,
    TRIG,
    Host,
    arm,
    program,
)
from emulators.tools import require_node_module
from emulators.wasm.interpreter import MicroPython

ROOT = Path(__file__).parents[4]
FIRMWARE = ROOT / "hw" / "firmware" / "rp2040"
GREETING = bytes([HELLO, 0xCA])
WASM = ROOT / "tests" / "emulators" / "wasm"
VIRTUAL = WASM / "virtual_shutter.py"


def line_of(body: bytes, *, spoil: int = 0) -> bytes:
    """Text frame, by another CRC than the firmware's."""
    crc = binascii.crc_hqx(body, 0xFFFF) ^ spoil
    return b":" + (body + struct.pack("<H", crc)).hex().upper().encode() + b"\n"


class VirtualDevice:
    """`cxp.Player` with the virtual shutter and clock, in MicroPython."""

    def __init__(self, python: MicroPython, *, start_us: int = 0, limits: str = "") -> None:
        self.python = python
        python.run(
            "from cxp import Player\nfrom virtual_shutter import Clock, VirtualShutter\nclock ="
            f" Clock({start_us})\nshutter = VirtualShutter(clock{limits})\nplayer ="
            " Player(shutter, clock)"
        )

    def feed(self, data: bytes) -> bytes:
        return ast.literal_eval(self.python.run(f"print(repr(player.feed({data!r})))"))

    def send(self, body: bytes, *, spoil: int = 0) -> bytes | None:
        reply = self.feed(line_of(body, spoil=spoil))
        if not reply:
            return None
        raw = bytes.fromhex(reply[1:-1].decode())
        assert line_of(raw[:-2]) == reply
        return raw[:-2]

    def sleep(self, seconds: float) -> None:
        # In steps, as a loop polls.
        self.python.run(
            f"for _ in range(10):\n    clock.now_us += {round(seconds * 1e5)}\n    player.poll()",
        )

    def look(self, expression: str) -> object:
        return ast.literal_eval(self.python.run(f"print(repr({expression}))"))


@pytest.fixture(scope="module")
def python() -> Iterator[MicroPython]:
    require_node_module("@micropython/micropython-webassembly-pyscript")
    with MicroPython(FIRMWARE / "cxp_text.py", FIRMWARE / "cxp.py", VIRTUAL) as running:
        yield running


@pytest.mark.parametrize("check", conformance.CHECKS, ids=lambda check: check.__name__)
def test_docs_cxp1(python, check):
    check(VirtualDevice(python))


def test_announced_limits_are_kept(python):
    conformance.check_announced_limits(
        VirtualDevice(python, limits=", max_on_ticks=5000, max_duty=420")
    )


def test_a_play_cut_short_owes_its_closed_time(python):
    conformance.check_closed_time_is_owed(VirtualDevice(python, limits=", max_duty=420"))


def test_a_trigger_in_the_moment_of_abort_is_a_play_and_owes_its_closed_time(python):
    device = VirtualDevice(python, limits=", max_duty=420")
    host = Host(device)
    host.load()
    host.ok(ARM, arm(60000))
    # The shutter begins between the question whether it has begun and its closing.
    python.run("answers = [False, False, True]\nshutter.begun = lambda: answers.pop(0)")
    host.ok(ABORT)
    assert host.ask(ARM, arm(60000)) == (DUTY_LIMIT, b"")


def test_checksums(python):
    rng = random.Random(7)
    for size in (0, 1, 9, 44, 300):
        data = rng.randbytes(size)
        printed = python.run(
            f"import cxp, cxp_text\nprint((cxp_text.crc16({data!r}), cxp.crc32({data!r})))"
        )
        found = ast.literal_eval(printed)
        assert found == (binascii.crc_hqx(data, 0xFFFF), zlib.crc32(data))


def test_a_missed_edge_closes_and_does_not_count(python):
    device = VirtualDevice(python)
    host = Host(device)
    host.load()
    host.ok(ARM, arm(60000))
    host.ok(TRIG)
    python.run("clock.now_us += 2500\nshutter.miss = 3")
    closes = device.look("shutter.closes")
    found = host.status()
    assert (found["state"], found["begun"], found["plays"], found["missed"]) == (FAULT, 3, 0, 3)
    assert device.look("shutter.closes") == closes + 1
    stored = host.ok(conformance.READ)
    for op, payload in ((ARM, arm(9)), (TRIG, b""), (LOAD, stored)):
        assert host.ask(op, payload) == (conformance.WRONG_STATE, b"")
    assert host.ask(ABORT) == (OK, b"")
    assert host.state == LOADED
    for _ in range(2):
        host.ok(ARM, arm(60000))
        host.ok(TRIG)
        python.run("shutter.miss = 200")
        host.ok(STATUS)
        host.ok(ABORT)
    assert host.status()["missed"] == 255


def test_trigger_input(python):
    device = VirtualDevice(python)
    host = Host(device)
    payload = host.load()
    host.ok(ARM, arm(60000))
    python.run("shutter.trigger()\nplayer.poll()")
    assert host.state == PLAY
    assert host.ask(TRIG) == (conformance.WRONG_STATE, b"")
    device.sleep(0.1)
    assert host.status()["plays"] == 1
    assert device.look("shutter.plays") == [(1000, len(CODE), payload[8:])]


def test_trigger_input_in_the_moment_the_lease_ends(python):
    device = VirtualDevice(python)
    host = Host(device)
    host.load()
    host.ok(ARM, arm(100))
    python.run("clock.now_us += 200000\nshutter.trigger()")
    assert host.state == PLAY  # begun before anybody noticed the end of the lease


def test_a_new_lease_does_not_disturb_the_shutter(python):
    device = VirtualDevice(python)
    host = Host(device)
    host.load()
    host.ok(ARM, arm(60000))
    python.run("shutter.arm = None")
    assert host.ask(ARM, arm(50)) == (OK, b"")


def test_closed_whenever_not_armed_or_playing(python):
    device = VirtualDevice(python)
    host = Host(device)
    assert device.look("shutter.closes") == 1  # at boot
    host.load()
    for end in ("lease", "abort while armed", "abort while playing", "last chip"):
        closes = device.look("shutter.closes")
        host.ok(ARM, arm(100))
        assert device.look("(shutter.closes, shutter.armed)") == (closes, True)
        if end in ("abort while playing", "last chip"):
            host.ok(TRIG)
        if end.startswith("abort"):
            host.ok(ABORT)
        else:
            device.sleep(0.2)
        assert device.look("(shutter.closes, shutter.armed)") == (closes + 1, False), end


def test_time_since_boot_passes_its_own_wraps(python):
    device = VirtualDevice(python, start_us=2**30 - 1000)
    host = Host(device)
    begin = host.status()["uptime_us"]
    assert begin == 2**30 - 1000
    for step in (2000, 2**29 - 1, 2**29 - 1, 2**29 - 1, 2**29 - 1, 2**29 - 1, 2**29 - 1, 1000):
        python.run(f"clock.now_us += {step}\nplayer.poll()")
        begin += step
        assert host.status()["uptime_us"] == begin % 2**32


@pytest.mark.parametrize(
    "noise",
    [
        b"",
        b"\n\n\r\n",
        b"\r",
        b"\x05\x01\x02\x03\xff",
        b"MicroPython v1.27\r\n>>> ",
        b":01",
        b":0101AB\n",
        b"x" * 1000,
    ],
)
def test_what_stands_before_a_frame_is_ignored(python, noise):
    device = VirtualDevice(python)
    assert device.feed(noise) == b""
    flush = b"\n" if noise.startswith((b"x", b":01")) else b""
    assert device.feed(flush + line_of(bytes([HELLO, 7])))[:7] == b":810700"


@pytest.mark.parametrize(
    "line",
    [
        line_of(GREETING).lower(),
        line_of(GREETING)[1:],
        line_of(GREETING).replace(b"0", b" "),
        line_of(GREETING)[:-2] + b"\n",
        line_of(GREETING)[:-1] + b"00\n",
        b":\n",
        b"repl\n",
        b"\xff\xfe\n",
        b":" + b"0" * 5000 + b"\n",
        line_of(bytes([LOAD, 1]) + program(100, "1" * 500)),
    ],
)
def test_what_is_no_frame_is_counted_and_not_answered(python, line):
    device = VirtualDevice(python)
    assert device.feed(line) == b""
    assert Host(device).status()["bad"] == 1


def test_frames_in_pieces_and_several_at_once(python):
    device = VirtualDevice(python)
    frame = line_of(bytes([STATUS, 1]))
    assert [device.feed(frame[k : k + 1]) for k in range(len(frame) - 1)] == [b""] * (
        len(frame) - 1
    )
    assert device.feed(frame[-1:]).startswith(b":870100")
    three = device.feed(b"".join(line_of(bytes([STATUS, seq])) for seq in (2, 3, 4)))
    assert [reply[:7] for reply in three.splitlines()] == [b":870200", b":870300", b":870400"]
    assert device.feed(line_of(bytes([STATUS, 5])).replace(b"\n", b"\r\n")).startswith(b":870500")


def test_noise_both_ways_never_plays_twice(python):
    """2 % of bytes broken each way: 40 triggers give 40 plays, with the host's retries."""
    device = VirtualDevice(python)
    rng = random.Random(3)

    def spoilt(data: bytes) -> bytes:
        out = bytearray()
        for byte in data:
            kind = rng.choice(["drop", "flip", "twice"]) if rng.random() < 0.02 else ""
            byte ^= (1 << rng.randrange(8)) if kind == "flip" else 0
            out += bytes([byte]) * {"drop": 0, "twice": 2}.get(kind, 1)
        return bytes(out)

    seq = 0
    retries = 0

    def ask(op: int, payload: bytes = b"") -> int:
        nonlocal seq, retries
        seq = (seq + 1) % 256
        body = bytes([op, seq]) + payload
        wanted = bytes([op | 0x80, seq])
        for _ in range(100):
            for line in spoilt(device.feed(spoilt(b"\n" + line_of(body)))).split(b"\n"):
                try:
                    raw = bytes.fromhex(line[1:].decode())
                except ValueError:
                    continue
                if len(raw) > 4 and raw[:2] == wanted and line_of(raw[:-2]) == line + b"\n":
                    return raw[2]
            retries += 1
        raise AssertionError("no reply")

    for k in range(40):
        assert ask(LOAD, program(100 + k, CODE)) == OK
        assert ask(ARM, arm(60000)) == OK
        assert ask(TRIG) == OK
        device.sleep(0.1)
    assert retries > 40
    assert [play[0] for play in device.look("shutter.plays")] == [100 + k for k in range(40)]
    assert Host(device).status()["plays"] == 40


MUTANTS = {
    "no CRC check": (
        "cxp_text.py",
        'if crc16(bytes(frame[:-2])) == frame[-2] | frame[-1] << 8 else b""',
        "",
    ),
    "another CRC start": ("cxp_text.py", "crc = 0xFFFF", "crc = 0x1D0F"),
    "a retry is done again": ("cxp.py", "if request != self._last:", "if True:"),
    "retries known by op and seq only": (
        "cxp.py",
        "(op, frame[1], frame[-2], frame[-1])",
        "(op, frame[1])",
    ),
    "a refused LOAD is kept": (
        "cxp.py",
        "if not open_chips or padding:",
        "self._stored = payload\n        if padding:",
    ),
    "the lease never ends": ("cxp.py", "self._lease_us -= elapsed", "pass"),
    "LOAD while armed": ("cxp.py", "0b010011", "0b010111"),
    "length before state": (
        "cxp.py",
        "if not _ALLOWED[op] >> self.state & 1:",
        "if op != 3 and not _ALLOWED[op] >> self.state & 1:",
    ),
    "aborted plays count": (
        "cxp.py",
        "self._close(_LOADED if self._stored else _IDLE)",
        "self.plays += 1\n            self._close(_LOADED if self._stored else _IDLE)",
    ),
}


def pass_all_checks(python: MicroPython) -> None:
    for check in conformance.CHECKS:
        check(VirtualDevice(python))


@pytest.mark.parametrize("mutant", MUTANTS)
def test_mutants_are_caught(tmp_path, mutant):
    require_node_module("@micropython/micropython-webassembly-pyscript")
    altered, old, new = MUTANTS[mutant]
    for name in ("cxp_text.py", "cxp.py"):
        source = (FIRMWARE / name).read_text(encoding="utf-8")
        if name == altered:
            assert source.count(old) == 1
            source = source.replace(old, new)
        (tmp_path / name).write_text(source, encoding="utf-8")
    with (
        MicroPython(tmp_path / "cxp_text.py", tmp_path / "cxp.py", VIRTUAL) as python,
        pytest.raises(AssertionError),
    ):
        pass_all_checks(python)


def test_the_pio_shutter_does_the_same_in_micropython(python, tmp_path):
    """The same register accesses as in CPython, in which the other tests run it on an emulated
    chip."""
    rng = random.Random(11)
    codes = []
    for chips in (1, 31, 32, 33, 52, 63, 64, 223, 255, 256, 287):
        bits = "".join(rng.choice("01") for _ in range(chips))
        payload = program(rng.choice([125, 25_000, 2**32 - 1]), bits)
        codes.append((struct.unpack_from("<I", payload)[0], chips, payload[8:]))
    work = (
        "log = recorder.install()\nfound = recorder.transcript(pio_shutter.PioShutter, log,"
        f" {codes!r})\n"
    )
    with MicroPython(
        WASM / "recorder.py", FIRMWARE / "pio_shutter.py", FIRMWARE / "main.py"
    ) as fresh:
        fresh.run("import main")  # its syntax; it starts as a script only
        there = ast.literal_eval(
            fresh.run(f"import recorder, pio_shutter\n{work}print(repr(found))")
        )
    with pytest.MonkeyPatch.context() as patch:
        for name in ("machine", "rp2", "recorder", "pio_shutter"):
            patch.delitem(sys.modules, name, raising=False)
        patch.syspath_prepend(str(WASM))
        patch.syspath_prepend(str(FIRMWARE))
        here: dict[str, object] = {}
        exec(f"import recorder, pio_shutter\n{work}", here)
        for name in ("machine", "rp2", "recorder", "pio_shutter"):
            patch.delitem(sys.modules, name)
    assert len(there) > 200
    assert there == here["found"]
