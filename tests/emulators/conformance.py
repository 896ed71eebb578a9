"""What docs/cxp1.md demands of every device, as checks that share no code with `hw`.

Each check gets a `Device` that has just started. It sends bodies (op, seq, payload) and sees
bodies; framing and time are the device's.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

HELLO, LOAD, READ, ARM, TRIG, ABORT, STATUS = range(1, 8)
IDLE, LOADED, ARMED, PLAY, DONE, FAULT = range(6)
OK, BAD_OP, BAD_LENGTH, OUT_OF_RANGE, WRONG_STATE, DUTY_LIMIT, ON_LIMIT = range(7)
CODE = "1101000010"


class Device(Protocol):
    """A device that has just started."""

    def send(self, body: bytes, *, spoil: int = 0) -> bytes | None:
        """Send a frame whose CRC is xored with `spoil`; return the body of the reply, None when
        none comes."""

    def sleep(self, seconds: float) -> None:
        """Let time pass on the device."""


@dataclass
class Host:
    """Asks with a new sequence number each time."""

    device: Device
    seq: int = 40
    last: bytes = field(default=b"", repr=False)

    def ask(self, op: int, payload: bytes = b"") -> tuple[int, bytes]:
        """Send a request; return error and data."""
        self.seq = (self.seq + 1) % 256
        self.last = bytes([op, self.seq]) + payload
        return self.read(self.device.send(self.last))

    def again(self) -> tuple[int, bytes]:
        """Send the very same frame again."""
        return self.read(self.device.send(self.last))

    def read(self, reply: bytes | None) -> tuple[int, bytes]:
        assert reply is not None, f"no reply to {self.last.hex()}"
        assert reply[:2] == bytes([self.last[0] | 0x80, self.last[1]]), (
            f"{reply.hex()} to {self.last.hex()}"
        )
        return reply[2], reply[3:]

    def ok(self, op: int, payload: bytes = b"") -> bytes:
        error, data = self.ask(op, payload)
        assert error == OK, f"error {error} to {self.last.hex()}"
        return data

    def hello(self) -> dict[str, int]:
        data = self.ok(HELLO)
        names = (
            "version",
            "flags",
            "chips",
            "tick_ns",
            "least",
            "most",
            "on",
            "duty",
            "lead_ns",
            "cause",
        )
        assert data[:4] == b"CXP1"
        return dict(zip(names, struct.unpack_from("<BBHHIIIHIB", data, 4), strict=True))

    def status(self) -> dict[str, int]:
        names = ("state", "begun", "plays", "missed", "bad", "uptime_us", "crc")
        return dict(zip(names, struct.unpack_from("<BHHBBII", self.ok(STATUS)), strict=True))

    @property
    def state(self) -> int:
        return self.status()["state"]

    def ticks(self, chip_s: float) -> int:
        told = self.hello()
        return max(told["least"], round(chip_s * 1e9 / told["tick_ns"]))

    def load(self, chip_s: float = 0.001) -> bytes:
        payload = program(self.ticks(chip_s), CODE)
        self.ok(LOAD, payload)
        return payload


def program(ticks: int, bits: str, *, fraction: int = 0, chips: int | None = None) -> bytes:
    """Payload of LOAD."""
    size = -(-len(bits) // 8)
    packed = int(bits.ljust(8 * size, "0") or "0", 2).to_bytes(size, "big")
    return struct.pack("<IHH", ticks, fraction, len(bits) if chips is None else chips) + packed


def arm(lease_ms: int) -> bytes:
    """Payload of ARM."""
    return struct.pack("<H", lease_ms)


def check_hello(device: Device) -> None:
    host = Host(device)
    told = host.hello()
    assert told["version"] == 1
    assert told["flags"] < 4
    assert 1 <= told["least"] <= told["most"]
    assert told["chips"] >= len(CODE)
    assert told["tick_ns"]
    assert 1 <= told["duty"] <= 1000
    assert told["cause"] in (0, 1, 2, 3, 255)
    assert host.ok(HELLO)[31:].decode("ascii").isprintable()
    assert host.state == IDLE


def check_idle(device: Device) -> None:
    host = Host(device)
    for op, payload in ((READ, b""), (ARM, arm(1000)), (TRIG, b"")):
        assert host.ask(op, payload) == (WRONG_STATE, b"")
    assert host.ask(ABORT) == (OK, b"")
    found = host.status()
    assert {
        name: found[name] for name in ("state", "begun", "plays", "missed", "bad", "crc")
    } == dict.fromkeys(("state", "begun", "plays", "missed", "bad", "crc"), 0)


def check_unknown_requests(device: Device) -> None:
    host = Host(device)
    for op in (0, 8, 0x42, 0x7E):
        assert host.ask(op) == (BAD_OP, b"")
    assert host.state == IDLE


def check_load_and_read(device: Device) -> None:
    host = Host(device)
    told = host.hello()
    for chips in {1, 7, 8, 9, told["chips"] - 1, told["chips"]}:
        bits = ("10010" * chips)[:chips]
        payload = program(told["most"] if chips > 9 else told["least"], bits)
        if told["on"] and payload[:4] == struct.pack("<I", told["most"]):
            continue  # an opening of one chip may be too long already
        crc = zlib.crc32(payload)
        assert host.ask(LOAD, payload) == (OK, struct.pack("<I", crc))
        assert host.ask(READ) == (OK, payload)
        assert host.status()["crc"] == crc
        assert host.state == LOADED


def check_refused_load_changes_nothing(device: Device) -> None:
    host = Host(device)
    told = host.hello()
    least = told["least"]
    most = told["most"]
    refused = [
        program(least - 1, CODE),
        program(0, CODE),
        program(least, "0" * 10),
        program(least, "", chips=0),
    ]
    refused.append(program(least, "1" + "0" * told["chips"]))  # one chip too many
    refused.append(program(least, "1000000000000001", chips=15))  # an open padding bit
    if most < 2**32 - 1:
        refused.append(program(most + 1, CODE))
    if not told["flags"] & 1:
        refused += [program(least, CODE, fraction=1), program(least, CODE, fraction=0xFF00)]
    for payload in refused:
        assert host.ask(LOAD, payload) == (OUT_OF_RANGE, b""), payload.hex()
        assert host.state == IDLE
    stored = host.load()
    for payload in refused:
        assert host.ask(LOAD, payload) == (OUT_OF_RANGE, b"")
        assert host.ask(READ) == (OK, stored)
    assert host.status()["crc"] == zlib.crc32(stored)


def check_lengths(device: Device) -> None:
    host = Host(device)
    good = program(host.ticks(0.001), CODE)
    for payload in (b"", good[:4], good[:7], good[:-1], good + b"\0"):
        assert host.ask(LOAD, payload) == (BAD_LENGTH, b"")
    host.load()
    for op, payload in (
        (READ, b"\0"),
        (ARM, b""),
        (ARM, b"\1"),
        (ARM, b"\1\0\0"),
        (ABORT, b"\0"),
        (HELLO, b"\0"),
        (STATUS, b"\0\0"),
    ):
        assert host.ask(op, payload) == (BAD_LENGTH, b"")
        assert host.state == LOADED
    host.ok(ARM, arm(60000))
    assert host.ask(TRIG, b"\0") == (BAD_LENGTH, b"")
    assert host.ask(ABORT, b"\0") == (BAD_LENGTH, b"")
    assert host.state == ARMED


def check_order_of_errors(device: Device) -> None:
    host = Host(device)
    least = host.hello()["least"]
    assert host.ask(READ, b"\0") == (WRONG_STATE, b"")  # state before length
    assert host.ask(ARM, b"\0") == (WRONG_STATE, b"")
    assert host.ask(LOAD, program(0, CODE) + b"\0") == (BAD_LENGTH, b"")  # length before range
    host.load()
    assert host.ask(ARM, arm(0)) == (OUT_OF_RANGE, b"")
    host.ok(ARM, arm(60000))
    assert host.ask(LOAD, b"") == (WRONG_STATE, b"")
    assert host.ask(LOAD, program(least - 1, CODE)) == (WRONG_STATE, b"")  # state before range


def check_states(device: Device) -> None:
    host = Host(device)
    stored = host.load(chip_s=0.02)
    assert host.ask(TRIG) == (WRONG_STATE, b"")
    for _ in range(2):
        assert host.ask(ARM, arm(60000)) == (OK, b"")
        assert host.state == ARMED
    assert host.status()["begun"] == 0
    assert host.ask(LOAD, stored) == (WRONG_STATE, b"")
    assert host.ask(READ) == (OK, stored)
    assert host.ask(TRIG) == (OK, b"")
    for op, payload in ((LOAD, stored), (ARM, arm(60000)), (TRIG, b"")):
        assert host.ask(op, payload) == (WRONG_STATE, b"")
    assert host.ask(READ) == (OK, stored)
    playing = host.status()
    assert playing["state"] == PLAY
    assert 1 <= playing["begun"] <= len(CODE)
    device.sleep(0.05)
    later = host.status()
    assert playing["begun"] < later["begun"] <= len(CODE)
    device.sleep(0.4)
    done = host.status()
    assert (done["state"], done["begun"], done["plays"], done["missed"]) == (DONE, len(CODE), 1, 0)
    assert host.ask(TRIG) == (WRONG_STATE, b"")
    assert host.ask(READ) == (OK, stored)
    assert host.ask(ARM, arm(60000)) == (OK, b"")
    assert host.ask(ABORT) == (OK, b"")
    assert host.state == LOADED
    host.ok(ARM, arm(60000))
    host.ok(TRIG)
    assert host.ask(ABORT) == (OK, b"")
    found = host.status()
    assert (found["state"], found["plays"]) == (LOADED, 1)  # a play cut short does not count


def check_load_after_a_play(device: Device) -> None:
    host = Host(device)
    host.load()
    host.ok(ARM, arm(60000))
    host.ok(TRIG)
    device.sleep(0.1)
    assert host.state == DONE
    other = program(host.ticks(0.002), "111")
    assert host.ask(LOAD, other)[0] == OK
    assert host.state == LOADED
    assert host.ask(READ) == (OK, other)


def check_a_retry_does_nothing(device: Device) -> None:
    host = Host(device)
    host.load()
    host.ok(ARM, arm(60000))
    assert host.ask(TRIG) == (OK, b"")
    assert host.again() == (OK, b"")
    device.sleep(0.1)
    assert host.again() == (OK, b"")
    assert host.status()["plays"] == 1
    host.ok(ARM, arm(60000))
    host.ok(TRIG)
    trigger = host.last
    host.ok(ABORT)
    assert host.again() == (OK, b"")
    # Not the last request any more, so it is a new one, and refused.
    host.last = trigger
    assert host.again() == (WRONG_STATE, b"")
    assert host.again() == (WRONG_STATE, b"")
    assert host.ask(ARM, arm(0)) == (OUT_OF_RANGE, b"")
    # Same op and seq, another payload: another CRC, so not a retry.
    assert host.read(device.send(host.last[:2] + arm(60000))) == (OK, b"")


def check_wrong_crc_changes_nothing(device: Device) -> None:
    host = Host(device)
    stored = host.load()
    spoiled = 0
    for spoil in (0x0001, 0x0100, 0x8000, 0xFFFF):
        for body in (
            bytes([LOAD, 1]) + program(host.ticks(0.002), "111"),
            bytes([ARM, 2]) + arm(60000),
            bytes([HELLO, 3]),
        ):
            assert device.send(body, spoil=spoil) is None
            spoiled += 1
    assert host.ask(READ) == (OK, stored)
    host.ok(ARM, arm(60000))
    assert device.send(bytes([ABORT, 4]), spoil=1) is None
    assert device.send(bytes([TRIG, 5]), spoil=1) is None
    found = host.status()
    assert (found["state"], found["bad"], found["plays"]) == (ARMED, spoiled + 2, 0)


def check_short_frames_are_counted(device: Device) -> None:
    host = Host(device)
    assert device.send(b"") is None
    assert device.send(bytes([HELLO])) is None
    assert host.status()["bad"] == 2
    for _ in range(260):
        assert device.send(bytes([HELLO])) is None
    assert host.status()["bad"] == 255


def check_lease(device: Device) -> None:
    host = Host(device)
    host.load()
    host.ok(ARM, arm(400))
    device.sleep(0.1)
    assert host.state == ARMED
    device.sleep(0.4)
    assert host.state == LOADED
    assert host.ask(TRIG) == (WRONG_STATE, b"")
    host.ok(ARM, arm(400))
    device.sleep(0.25)
    host.ok(ARM, arm(800))  # a new lease
    device.sleep(0.3)
    assert host.state == ARMED
    host.ok(ARM, arm(100))  # a shorter one
    device.sleep(0.2)
    assert host.state == LOADED


def check_time_since_boot(device: Device) -> None:
    host = Host(device)
    before = host.status()["uptime_us"]
    device.sleep(0.1)
    assert 100_000 <= (host.status()["uptime_us"] - before) % 2**32 < 1_000_000


def check_announced_limits(device: Device) -> None:
    """Only for a device that announces both limits."""
    host = Host(device)
    told = host.hello()
    assert told["duty"] < 1000
    assert told["on"]
    least = told["least"]
    on = told["on"]
    duty = told["duty"]
    opened = 50 * duty // 1000
    assert host.ask(LOAD, program(least, ("10" * 25)[: 2 * opened].ljust(50, "0")))[0] == OK
    assert host.ask(LOAD, program(least, "01" * (opened + 1) + "0" * (48 - 2 * opened))) == (
        DUTY_LIMIT,
        b"",
    )
    assert host.ask(LOAD, program(on, "1" + "0" * 49))[0] == OK
    assert host.ask(LOAD, program(on + 1, "1" + "0" * 49)) == (ON_LIMIT, b"")
    assert host.ask(LOAD, program(on // 2, "0110" + "0" * 46))[0] == OK
    assert host.ask(LOAD, program(on // 2 + 1, "0110" + "0" * 46)) == (ON_LIMIT, b"")
    assert host.ask(LOAD, program(on // 2 + 1, "0101" + "0" * 46))[0] == OK
    assert host.state == LOADED


def check_closed_time_is_owed(device: Device) -> None:
    """Only for a device that announces a limit of the open fraction: a play cut short delays the
    next one."""
    host = Host(device)
    assert host.hello()["duty"] < 1000
    ticks = host.ticks(0.01)

    def refused() -> bool:
        error, data = host.ask(ARM, arm(60000))
        assert (error, data) in ((OK, b""), (DUTY_LIMIT, b""))
        return error == DUTY_LIMIT

    host.ok(LOAD, program(ticks, "1" * 8 + "0" * 32))
    host.ok(ARM, arm(60000))
    host.ok(TRIG)
    host.ok(ABORT)
    assert refused()
    assert host.state == LOADED
    host.ok(LOAD, program(ticks, "1" * 2 + "0" * 8))
    assert refused()
    device.sleep(0.2)
    assert refused()
    device.sleep(0.3)
    assert not refused()
    host.ok(ABORT)  # armed only: nothing was played, so nothing is owed
    host.ok(ARM, arm(100))
    host.ok(ARM, arm(50))
    device.sleep(0.2)
    assert host.state == LOADED
    assert not refused()
    host.ok(TRIG)
    device.sleep(0.15)
    assert host.state == DONE
    assert not refused()


CHECKS: tuple[Callable[[Device], None], ...] = (
    check_hello,
    check_idle,
    check_unknown_requests,
    check_load_and_read,
    check_refused_load_changes_nothing,
    check_lengths,
    check_order_of_errors,
    check_states,
    check_load_after_a_play,
    check_a_retry_does_nothing,
    check_wrong_crc_changes_nothing,
    check_short_frames_are_counted,
    check_lease,
    check_time_since_boot,
)
"""For every device."""
