"""The ATmega328P firmware under test: built from its sources, played on an emulated Uno, checked
to the clock cycle.

Every check here is one that the shipped firmware passes and that a firmware with a fault must
fail.
"""

from __future__ import annotations

import binascii
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import serial

from hw.cxp.protocol import BINARY, Op, State, Stored, unpack_status, unpack_stored
from hw.drivers.cxp import Controller
from hw.program import Program

FOLDER = Path(__file__).parents[2] / "hw" / "firmware" / "avr"
HEX = FOLDER / "cxp-avr.hex"

TICK_CYCLES = 8  # 0.5 us at 16 MHz
LEAD_CYCLES = 320  # announced: 20 us
EDGE_CYCLES = 4  # both simulators change pins between instructions only


class Uno(Protocol):
    """An emulated Uno on any simulator."""

    @property
    def port(self) -> str: ...

    def edges(self, signal: str = "shutter") -> tuple[tuple[int, int], ...]: ...

    def trigger(self) -> None: ...


@dataclass(frozen=True)
class Play:
    """One play as seen on the pins: times in cycles since the controller said that it was busy."""

    edges: tuple[tuple[int, int], ...]
    busy_cycles: int


class RawPort:
    """A port to which any bytes can be sent."""

    def __init__(self, name: str) -> None:
        self._port = serial.Serial(name, 115200, timeout=10)
        self._seq = 100

    def __enter__(self) -> RawPort:
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def send(self, wire: bytes) -> None:
        self._port.write(wire)

    def receive(self) -> bytes | None:
        """Body of the next frame; None when nothing comes."""
        wire = self._port.read_until(b"\0")
        return BINARY.decode(wire[:-1]) if wire else None

    def hear_nothing(self) -> bool:
        """Whether a request sent now is the next that is answered."""
        self._seq += 1
        self.send(BINARY.encode(bytes([Op.STATUS, self._seq % 256])))
        reply = self.receive()
        return reply is not None and reply[:2] == bytes([Op.STATUS | 0x80, self._seq % 256])

    def ask(self, op: int, payload: bytes = b"") -> tuple[int, bytes]:
        """Error code and data of the reply."""
        self._seq += 1
        self.send(BINARY.encode(bytes([op, self._seq % 256]) + payload))
        reply = self.receive()
        assert reply is not None, f"op {op} is not answered"
        assert reply[:2] == bytes([op | 0x80, self._seq % 256])
        return reply[2], reply[3:]


def build(
    folder: Path, *changes: tuple[str, str, str], on_us: int = 0, duty_permille: int = 1000
) -> Path:
    """Build the firmware in `folder`, with changes (file, old text, new text) of its sources; its
    hex file."""
    sources = folder / "sources"
    shutil.copytree(FOLDER, sources, ignore=shutil.ignore_patterns("*.hex*", "*.elf"))
    for name, old, new in changes:
        text = (sources / name).read_text()
        assert text.count(old) == 1, f"{name} has {old!r} {text.count(old)} times"
        (sources / name).write_text(text.replace(old, new))
    limits = [f"MAX_ON_US={on_us}", f"MAX_DUTY_PERMILLE={duty_permille}"]
    subprocess.run(
        ["make", "-s", "-C", str(sources), f"OUT={folder}", *limits],
        check=True,
        capture_output=True,
    )
    (built,) = folder.glob("*.hex")
    return built


def ideal_edges(stored: Stored) -> tuple[tuple[int, int], ...]:
    """Edges of a program in ticks of the controller, rounded to whole ones as the protocol says
    (halves up)."""
    half = Fraction(1, 2)
    return tuple(
        (int(chip * stored.chip_ticks + half), level)
        for chip, level in Program(stored.bits, chip_ns=1).edges
    )


@contextmanager
def one_play(uno: Uno) -> Iterator[list[Play]]:
    """Collect what the pins do in the context as one play; it is appended to the list when the
    context ends."""
    before = len(uno.edges())
    busy_before = len(uno.edges("busy"))
    plays: list[Play] = []
    yield plays
    busy = uno.edges("busy")[busy_before:]
    assert [level for _, level in busy] == [1, 0], "busy is not one pulse"
    start, stop = (cycle for cycle, _ in busy)
    edges = tuple((cycle - start, level) for cycle, level in uno.edges()[before:])
    plays.append(Play(edges, stop - start))


def played(uno: Uno, controller: Controller, stored: Stored) -> Play:
    """Load, read back, arm, and play a program while STATUS is polled."""
    controller.link.request(Op.LOAD, stored.payload)
    assert unpack_stored(controller.link.request(Op.READ)) == stored, "read-back differs"
    before = controller.status()
    with one_play(uno) as plays:
        controller.arm(
            lease_ms=0xFFFF
        )  # a simulator may be far quicker than the clock, and this process be held up
        controller.trigger()
        status = controller.wait(timeout_s=30)
    assert (status.state, status.pos) == (State.DONE, len(stored.bits)), "play did not end"
    assert (status.runs, status.late) == ((before.runs + 1) % 65536, 0), "play does not count"
    return plays[0]


def check_edges(play: Play, stored: Stored) -> None:
    """Check a play against its program, cycle by cycle.

    A simulator changes pins late, up to the length of what the processor was at, and never early.
    Edges late by amounts that are less than a tick apart are all within 4 cycles of their places,
    and none is in another tick.
    """
    ideal = ideal_edges(stored)
    assert [level for _, level in play.edges] == [level for _, level in ideal], (
        "levels differ from the code"
    )
    late = _lateness(play, stored)
    assert abs(late[0] - LEAD_CYCLES) <= 64, f"first chip begins {late[0]} cycles after busy"
    assert max(late) - min(late) < TICK_CYCLES, f"edges are {max(late) - min(late)} cycles off"


def on_grid(play: Play, stored: Stored) -> tuple[tuple[int, int], ...]:
    """Edges in whole ticks since the program's beginning: a simulator's grain is less than a tick
    and falls away."""
    begin = min(_lateness(play, stored))
    return tuple(((cycle - begin) // TICK_CYCLES, level) for cycle, level in play.edges)


def _lateness(play: Play, stored: Stored) -> list[int]:
    pairs = zip(play.edges, ideal_edges(stored), strict=True)
    return [cycle - tick * TICK_CYCLES for (cycle, _), (tick, _) in pairs]


def check_wrong_crc(raw: RawPort, payload: bytes) -> None:
    """A LOAD with a wrong CRC is silently counted and changes nothing."""
    _, stored = raw.ask(Op.READ)
    bad = unpack_status(raw.ask(Op.STATUS)[1]).bad_frames
    for wrong in (0x0001, 0x8000, 0xFFFF):
        body = bytes([Op.LOAD, 77]) + payload
        raw.send(
            BINARY.wrap(body + (binascii.crc_hqx(body, 0xFFFF) ^ wrong).to_bytes(2, "little"))
            + BINARY.end
        )
        assert raw.hear_nothing(), "a frame with a wrong CRC is answered"
    assert raw.ask(Op.READ) == (0, stored), "a frame with a wrong CRC changed the program"
    assert unpack_status(raw.ask(Op.STATUS)[1]).bad_frames == bad + 3


def check_codes(uno: Uno, codes: Sequence[Stored]) -> list[Play]:
    """Play codes and check every edge."""
    with Controller.open(uno.port, timeout_s=0.3) as controller:
        plays = [played(uno, controller, code) for code in codes]
    for play, code in zip(plays, codes, strict=True):
        check_edges(play, code)
    return plays
