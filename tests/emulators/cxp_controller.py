"""A small CXP1 controller on a pseudo-terminal, written from docs/cxp1.md alone (nothing of `hw`
is imported).

It plays in real time, logs what it did, and breaks on demand: noise, lost or wrong replies, a dead
or strange device, a stored bit gone wrong, an unplugged cable.
"""

from __future__ import annotations

import binascii
import contextlib
import os
import random
import select
import struct
import threading
import time
import tty
import zlib
from dataclasses import dataclass, field

HELLO, LOAD, READ, ARM, TRIG, ABORT, STATUS = range(1, 8)
IDLE, LOADED, ARMED, PLAY, DONE, FAULT = range(6)


@dataclass(frozen=True)
class Faults:
    """What goes wrong; nothing by default."""

    noise: float = 0.0  # chance per byte, each way, of a drop, a flip or a duplicate
    seed: int = 0
    silent: bool = False
    # op after which (done, unanswered) nothing is ever answered again
    silent_after: int | None = None
    babble: bytes = b""  # sent instead of any reply
    boot_noise: bytes = b""  # sent at once at boot
    deaf_s: float = 0.0  # bytes that come earlier after the first one vanish (bootloader)
    magic: bytes = b"CXP1"
    version: int = 1
    bad_crc_replies: int = 0
    wrong_seq_replies: int = 0
    lost_replies: dict[int, int] = field(
        default_factory=dict
    )  # op -> how many of its replies never leave
    unplug_on: int | None = None  # op during whose frame the cable is pulled
    stored_flip: int | None = None  # stored bit that goes wrong after LOAD
    stored_crc_wrong: bool = False
    stuck_play: bool = False
    state_after: dict[int, int] = field(
        default_factory=dict
    )  # op -> state it is in afterwards, whatever it should be
    fault: bool = False  # every play misses an edge


class CxpController:
    """The controller; use as a context manager. `port` is the name of its pseudo-terminal."""

    def __init__(
        self,
        faults: Faults | None = None,
        *,
        max_chips: int = 1024,
        tick_ns: int = 500,
        min_ticks: int = 100,
        max_ticks: int = 65535,
        max_on_ticks: int = 0,
        max_duty: int = 1000,
        firmware: str = "cxp-avr 1",
        text: bool = False,
        clock_ppm: float = 0.0,
        trigger_input: bool = True,
    ) -> None:
        self.faults = faults or Faults()
        self.max_chips = max_chips
        self.tick_ns = tick_ns
        self.min_ticks = min_ticks
        self.max_ticks = max_ticks
        self.max_on_ticks = max_on_ticks
        self.max_duty = max_duty
        self.firmware = firmware
        self.text = text
        self.clock_ppm = clock_ppm
        self.boot = time.monotonic()
        self.trigger_input = trigger_input
        self.rng = random.Random(self.faults.seed)
        self.bad_crc_left = self.faults.bad_crc_replies
        self.wrong_seq_left = self.faults.wrong_seq_replies
        self.lost_left = dict(self.faults.lost_replies)
        self.state = IDLE
        self.ticks = 0.0
        self.fraction = 0
        self.bits = ""
        self.runs = self.bad_frames = self.late = 0
        self.play_start = self.lease_end = 0.0
        self.last_request: tuple[int, int, int] | None = None
        self.last_reply = b""
        self.ops: list[int] = []  # executed requests, without repeats
        self.repeats = 0  # requests answered from the cache
        self.plays: list[str] = []  # bits of each play begun
        self.pending = b""  # bytes of an unfinished frame
        self.first_byte: float | None = None
        self.mute = self.faults.silent
        self.unplugged = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> CxpController:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.port = os.ttyname(self.slave)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(timeout=10)
        assert not self._thread.is_alive()

    @property
    def shutter_open(self) -> bool:
        """Whether light passes at this moment."""
        if self.state != PLAY:
            return False
        position = int((time.monotonic() - self.play_start) * 1e9 / (self.ticks * self.tick_ns))
        return self.faults.stuck_play or (position < len(self.bits) and self.bits[position] == "1")

    def _run(self) -> None:
        try:
            self._put(self.faults.boot_noise)
            while not self._stop.is_set() and not self.unplugged:
                ready, _, _ = select.select([self.master], [], [], 0.01)
                self._tick()
                if ready:
                    self._take(os.read(self.master, 4096))
        finally:
            os.close(self.master)
            os.close(self.slave)

    def _tick(self) -> None:
        now = time.monotonic()
        length_s = len(self.bits) * self.ticks * self.tick_ns * 1e-9
        if self.state == PLAY and now - self.play_start >= length_s and not self.faults.stuck_play:
            self.state = FAULT if self.faults.fault else DONE
            self.runs += not self.faults.fault
            self.late += self.faults.fault
        if self.state == ARMED and now >= self.lease_end:
            self.state = LOADED

    def _noisy(self, data: bytes) -> bytes:
        out = bytearray()
        for byte in data:
            kind = (
                self.rng.choice(["drop", "flip", "twice"])
                if self.rng.random() < self.faults.noise
                else ""
            )
            if kind == "flip":
                byte ^= 1 << self.rng.randrange(8)
            out += bytes([byte]) * {"drop": 0, "twice": 2}.get(kind, 1)
        return bytes(out)

    def _put(self, data: bytes) -> None:
        data = self._noisy(data)
        with contextlib.suppress(BlockingIOError):  # nobody reads: the UART has no memory either
            os.write(self.master, data)

    def _take(self, data: bytes) -> None:
        self.first_byte = self.first_byte or time.monotonic()
        if time.monotonic() - self.first_byte < self.faults.deaf_s:
            return
        self.pending += self._noisy(data)
        end = b"\n" if self.text else b"\0"
        # The op is the second byte of a stuffed frame: the first is COBS's own.
        if self.faults.unplug_on is not None and self.pending.lstrip(b"\0")[1:2] == bytes(
            [self.faults.unplug_on]
        ):
            self.unplugged = True
            return
        while end in self.pending:
            stuffed, self.pending = self.pending.split(end, 1)
            if not stuffed:
                continue
            if self.faults.babble:
                self._put(self.faults.babble)
                continue
            raw = untext(stuffed) if self.text else unstuff(stuffed)
            if (
                raw is None
                or len(raw) < 4
                or binascii.crc_hqx(raw[:-2], 0xFFFF) != struct.unpack("<H", raw[-2:])[0]
            ):
                self.bad_frames = min(self.bad_frames + 1, 255)
                continue
            self._serve(raw[0], raw[1], raw[2:-2], struct.unpack("<H", raw[-2:])[0])

    def _serve(self, op: int, seq: int, payload: bytes, crc: int) -> None:
        if self.last_request == (op, seq, crc):
            self.repeats += 1
        else:
            self._tick()
            self.ops.append(op)
            error, data = self._do(op, payload)
            if not error and op in self.faults.state_after:
                self.state = self.faults.state_after[op]
                self.lease_end = time.monotonic() + 60
            self.last_request = (op, seq, crc)
            self.last_reply = bytes([op | 0x80, seq, error]) + data
        self.mute = self.mute or op == self.faults.silent_after
        if self.mute:
            return
        if self.lost_left.get(op, 0):
            self.lost_left[op] -= 1
            return
        reply = self.last_reply
        if self.wrong_seq_left:
            self.wrong_seq_left -= 1
            reply = bytes([reply[0], (reply[1] + 1) % 256]) + reply[2:]
        check = binascii.crc_hqx(reply, 0xFFFF)
        if self.bad_crc_left:
            self.bad_crc_left -= 1
            check ^= 0x0101
        sealed = reply + struct.pack("<H", check)
        self._put(
            b":" + sealed.hex().upper().encode() + b"\r\n" if self.text else stuff(sealed) + b"\0"
        )

    def _do(self, op: int, payload: bytes) -> tuple[int, bytes]:
        if op not in range(HELLO, STATUS + 1):
            return 1, b""
        allowed = {
            LOAD: (IDLE, LOADED, DONE),
            READ: (LOADED, ARMED, PLAY, DONE, FAULT),
            ARM: (LOADED, ARMED, DONE),
            TRIG: (ARMED,),
        }
        if self.state not in allowed.get(op, range(6)):
            return 4, b""
        if (op in (HELLO, READ, TRIG, ABORT, STATUS) and payload) or (
            op == ARM and len(payload) != 2
        ):
            return 2, b""
        if op == HELLO:
            flags = 1 | self.trigger_input << 1
            told = (
                self.faults.version,
                flags,
                self.max_chips,
                self.tick_ns,
                self.min_ticks,
                self.max_ticks,
            )
            limits = (self.max_on_ticks, self.max_duty, 20_000, 0)
            return 0, self.faults.magic + struct.pack(
                "<BBHHIIIHIB", *told, *limits
            ) + self.firmware.encode()
        if op == LOAD:
            return self._load(payload)
        if op == READ:
            return 0, self._stored()
        if op == ARM:
            lease_ms = struct.unpack("<H", payload)[0]
            if not lease_ms:
                return 3, b""
            self.state = ARMED
            self.lease_end = time.monotonic() + lease_ms * 1e-3
        elif op == TRIG:
            self.state = PLAY
            self.play_start = time.monotonic()
            self.plays.append(self.bits)
        elif op == ABORT:
            self.state = LOADED if self.bits else IDLE
        elif op == STATUS:
            position = 0
            if self.state == PLAY:
                position = int(
                    (time.monotonic() - self.play_start) * 1e9 / (self.ticks * self.tick_ns)
                )
            position = min(position, len(self.bits))
            uptime_us = (
                int((time.monotonic() - self.boot) * 1e6 * (1 + self.clock_ppm * 1e-6))
                + 2**32
                - 300_000
            )
            counts = (self.runs % 65536, min(self.late, 255), self.bad_frames, uptime_us % 2**32)
            crc = zlib.crc32(self._stored()) if self.bits else 0
            return 0, struct.pack("<BHHBBII", self.state, position, *counts, crc)
        return 0, b""

    def _load(self, payload: bytes) -> tuple[int, bytes]:
        if len(payload) < 8:
            return 2, b""
        ticks, fraction, count = struct.unpack_from("<IHH", payload)
        if len(payload) != 8 + -(-count // 8):
            return 2, b""
        padded = "".join(format(byte, "08b") for byte in payload[8:])
        bits = padded[:count]
        if (
            not self.min_ticks <= ticks <= self.max_ticks - (fraction > 0)
            or not 1 <= count <= self.max_chips
        ):
            return 3, b""
        if "1" in padded[count:] or "1" not in bits:
            return 3, b""
        if bits.count("1") * 1000 > self.max_duty * count:
            return 5, b""
        longest = max(len(run) for run in bits.split("0"))
        if self.max_on_ticks and longest * (ticks + fraction / 65536) > self.max_on_ticks:
            return 6, b""
        self.fraction = fraction
        self.bits = bits
        self.state = LOADED
        self.ticks = ticks + fraction / 65536
        echo = struct.pack("<I", zlib.crc32(self._stored()) ^ self.faults.stored_crc_wrong)
        if self.faults.stored_flip is not None:
            k = self.faults.stored_flip
            self.bits = self.bits[:k] + "10"[int(self.bits[k])] + self.bits[k + 1 :]
        return 0, echo

    def _stored(self) -> bytes:
        count = len(self.bits)
        size = -(-count // 8)
        number = int(self.bits, 2) << (8 * size - count)
        return struct.pack("<IHH", int(self.ticks), self.fraction, count) + number.to_bytes(
            size, "big"
        )


def stuff(data: bytes) -> bytes:
    """COBS by splitting at the zeros."""
    out = b""
    parts = data.split(b"\0")
    for index, part in enumerate(parts):
        while len(part) > 254:
            out = out + b"\xff" + part[:254]
            part = part[254:]
        if len(part) == 254 and index == len(parts) - 1:
            out += b"\xff" + part
        elif len(part) == 254:
            out += b"\xff" + part + b"\x01"
        else:
            out += bytes([len(part) + 1]) + part
    return out


def unstuff(data: bytes) -> bytes | None:
    """Undo `stuff`; None when it is not stuffed data."""
    out = b""
    while data:
        code = data[0]
        block = data[1 : data[0]]
        data = data[data[0] :]
        if len(block) != code - 1:
            return None
        out += block + (b"\0" if data and code < 255 else b"")
    return out


def untext(line: bytes) -> bytes | None:
    """Bytes of a text frame; None when it is none."""
    try:
        return bytes.fromhex(line.split(b":")[-1].decode()) if b":" in line else None
    except ValueError:
        return None
