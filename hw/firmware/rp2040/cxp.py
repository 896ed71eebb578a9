# mypy: disable-error-code="import-not-found"
"""Shutter controller of protocol CXP1 without the hardware: its state and its answers.

Written for MicroPython 1.9 and later (no f-strings, no `struct`): it also runs on boards of 16 kB,
and in CPython.
"""

from cxp_text import from_text, to_text

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Protocol

    class Clock(Protocol):
        """MicroPython's module `time`, or a clock for tests."""

        def ticks_us(self) -> int:
            """Microseconds, modulo a power of two."""

        def ticks_diff(self, later: int, earlier: int) -> int:
            """Microseconds between two values of `ticks_us`."""

    class Shutter(Protocol):
        """What plays: it owns the timing, and closes by itself at the end of a code."""

        name: bytes  # and version of the firmware, ASCII
        flags: int  # 2 with a trigger input
        max_chips: int
        tick_ns: int
        min_ticks: int
        max_ticks: int
        max_on_ticks: int  # longest opening, 0: no limit
        max_duty: int  # largest open fraction of a code in 1/1000
        lead_ns: int  # from trigger to first chip
        reset_cause: int

        def arm(self, ticks: int, chips: int, code: bytes) -> None:
            """Get ready to play `code` and obey the trigger input from now on."""

        def start(self) -> None:
            """Play now what is armed, unless the trigger input has just begun it."""

        def begun(self) -> bool:
            """Whether what was armed is being played, or has been."""

        def ended(self) -> bool:
            """Whether the last chip is over."""

        def missed(self) -> int:
            """Count the edges that could not be made in time."""

        def close(self) -> None:
            """Close at once and obey no trigger."""


_IDLE, _LOADED, _ARMED, _PLAY, _DONE, _FAULT = range(6)
_HELLO, _LOAD, _READ, _ARM, _TRIG, _ABORT, _STATUS = range(1, 8)
_OK, _BAD_OP, _BAD_LENGTH, _OUT_OF_RANGE, _WRONG_STATE, _DUTY_LIMIT, _ON_LIMIT = range(7)

# By request, the states in which it is allowed: bit k for state k.
_ALLOWED = (0, 0b111111, 0b010011, 0b111110, 0b010110, 0b000100, 0b111111, 0b111111)


class Player:
    """The controller's state and its answers.

    Call `feed` with every byte received and `poll` at least every few milliseconds.

    Parameters
    ----------
    shutter : Shutter
        What plays.
    clock : Clock
        MicroPython's module `time`.
    owed_us : int
        Value of the attribute before a reset. With a limit of the open fraction, a play that is
        cut short owes the closed chips the limit counted on: nothing is armed before it would have
        ended.
    """

    def __init__(self, shutter: "Shutter", clock: "Clock", owed_us: int = 0) -> None:
        self.shutter = shutter
        self.clock = clock
        self.state = _IDLE
        self.bad_frames = 0
        self.missed = 0
        self.plays = 0
        self._stored = b""
        self._crc = 0
        self.owed_us = owed_us
        self._lease_us = 0
        self._played_us = 0
        self._now = clock.ticks_us()
        self._uptime_us = self._now
        self._line = bytearray()
        # The longest request, LOAD, with a few bytes more: a code slightly too long is still
        # refused in words.
        self._longest = 2 * (32 + shutter.max_chips // 8)
        self._last = ()  # type: tuple[int, ...]
        self._reply = b""
        shutter.close()

    def feed(self, data: bytes) -> bytes:
        """Take received bytes and return the bytes to send, often none."""
        out = b""
        for byte in data:
            # a carriage return alone ends a line too: terminals send it
            if byte == 10 or byte == 13:
                if self._line:
                    out += self._answer(bytes(self._line))
                    self._line = bytearray()
            elif len(self._line) <= self._longest:
                self._line.append(byte)
        return out

    def poll(self) -> None:
        """Bring the state up to date with clock and shutter."""
        now_us = self.clock.ticks_us()
        elapsed = self.clock.ticks_diff(now_us, self._now)
        self._now = now_us
        self._uptime_us = (self._uptime_us + elapsed) & 0xFFFFFFFF
        if self.state != _ARMED:
            self.owed_us = max(self.owed_us - elapsed, 0)
        if self.state == _ARMED:
            if self.shutter.begun():
                self._begin()
            else:
                self._lease_us -= elapsed
                if self._lease_us <= 0:
                    self._close(_LOADED)
        elif self.state == _PLAY:
            self._played_us += elapsed
        if self.state == _PLAY:
            missed = self.shutter.missed()
            if missed:
                self.missed = min(self.missed + missed, 255)
                self._close(_FAULT)
            elif self.shutter.ended():
                self.plays = (self.plays + 1) & 0xFFFF
                self._close(_DONE)

    def _begin(self) -> None:
        self.state = _PLAY
        self._played_us = 0

    def _close(self, state: int) -> None:
        playing = self.state != _ARMED or self.shutter.begun()
        self.shutter.close()
        # a trigger may have come in between
        if state == _DONE or not (playing or self.shutter.begun()):
            self.owed_us = 0
        self.state = state

    def _answer(self, line: bytes) -> bytes:
        frame = from_text(line) if len(line) <= self._longest else b""
        if not frame:
            self.bad_frames = min(self.bad_frames + 1, 255)
            return b""
        op = frame[0]
        request = (op, frame[1], frame[-2], frame[-1])
        if request != self._last:
            self.poll()
            error, data = self._serve(op, frame[2:-2])
            self._reply = to_text(bytes((op | 0x80, frame[1], error)) + data)
            self._last = request
        return self._reply

    def _serve(self, op: int, payload: bytes) -> "tuple[int, bytes]":
        if not 1 <= op <= 7:
            return _BAD_OP, b""
        if not _ALLOWED[op] >> self.state & 1:
            return _WRONG_STATE, b""
        if op == _LOAD:
            return self._load(payload)
        if len(payload) != (2 if op == _ARM else 0):
            return _BAD_LENGTH, b""
        if op == _HELLO:
            return _OK, self._hello()
        if op == _READ:
            return _OK, self._stored
        if op == _STATUS:
            return _OK, self._status()
        if op == _ARM:
            return self._arm(payload[0] | payload[1] << 8), b""
        if op == _TRIG:
            self.shutter.start()
            self._begin()
        else:
            self._close(_LOADED if self._stored else _IDLE)
        return _OK, b""

    def _hello(self) -> bytes:
        s = self.shutter
        return (
            b"CXP1"
            + bytes((1, s.flags))
            + _le(s.max_chips, 2)
            + _le(s.tick_ns, 2)
            + _le(s.min_ticks, 4)
            + _le(s.max_ticks, 4)
            + _le(s.max_on_ticks, 4)
            + _le(s.max_duty, 2)
            + _le(s.lead_ns, 4)
            + bytes((s.reset_cause,))
            + s.name
        )

    def _load(self, payload: bytes) -> "tuple[int, bytes]":
        chips = int.from_bytes(payload[6:8], "little")
        if len(payload) < 8 or len(payload) != 8 + (chips + 7) // 8:
            return _BAD_LENGTH, b""
        s = self.shutter
        ticks = int.from_bytes(payload[:4], "little")
        code = payload[8:]
        if (
            not (s.min_ticks <= ticks <= s.max_ticks and 1 <= chips <= s.max_chips)
            or payload[4]
            or payload[5]
        ):
            return _OUT_OF_RANGE, b""
        open_chips, longest, padding = _census(code, chips)
        if not open_chips or padding:
            return _OUT_OF_RANGE, b""
        if open_chips * 1000 > s.max_duty * chips:
            return _DUTY_LIMIT, b""
        if s.max_on_ticks and longest * ticks > s.max_on_ticks:
            return _ON_LIMIT, b""
        self._stored = payload
        self._crc = crc32(payload)
        self.state = _LOADED
        return _OK, _le(self._crc, 4)

    def _arm(self, lease_ms: int) -> int:
        if not lease_ms:
            return _OUT_OF_RANGE
        # a new lease must not disturb a trigger that comes this very moment
        if self.state != _ARMED:
            if self.owed_us:
                return _DUTY_LIMIT
            ticks, chips = self._timing()
            if self.shutter.max_duty < 1000:
                self.owed_us = (
                    ticks * chips * self.shutter.tick_ns + self.shutter.lead_ns
                ) // 1000 + 1
            self.shutter.arm(ticks, chips, self._stored[8:])
            self.state = _ARMED
        self._lease_us = 1000 * lease_ms
        return _OK

    def _timing(self) -> "tuple[int, int]":
        return int.from_bytes(self._stored[:4], "little"), int.from_bytes(
            self._stored[6:8], "little"
        )

    def _status(self) -> bytes:
        position = 0
        if self.state >= _PLAY:
            ticks, position = self._timing()
            if self.state != _DONE:
                position = min(
                    position, self._played_us * 1000 // (ticks * self.shutter.tick_ns) + 1
                )
        return (
            bytes((self.state,))
            + _le(position, 2)
            + _le(self.plays, 2)
            + bytes((self.missed, self.bad_frames))
            + _le(self._uptime_us, 4)
            + _le(self._crc, 4)
        )


def crc32(data: bytes) -> int:
    """CRC-32 as zlib computes it; the module `binascii` is not on every board."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xEDB88320 * (crc & 1)
    return crc ^ 0xFFFFFFFF


def _le(value: int, size: int) -> bytes:
    return value.to_bytes(size, "little")


def _census(code: bytes, chips: int) -> "tuple[int, int, int]":
    # Open chips, longest run of them, and open padding bits.
    open_chips = longest = run = padding = 0
    for k in range(8 * len(code)):
        if not code[k >> 3] << (k & 7) & 0x80:
            run = 0
        elif k < chips:
            open_chips += 1
            run += 1
            longest = max(longest, run)
        else:
            padding += 1
    return open_chips, longest, padding
