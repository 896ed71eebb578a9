"""CXP1: frames, requests and replies of the shutter controller as pure functions on bytes.

``docs/cxp1.md`` is its definition. Bodies are ``op, seq, payload...`` and ``op | 0x80, seq, error,
data...``; numbers are little endian; :class:`Framing` puts bodies on a line.
"""

from __future__ import annotations

import binascii
import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from fractions import Fraction

from cobs import cobs

from hw.program import Program

_HEX = re.compile(rb"(?:[0-9A-F]{2})+")
_REPLY = 0x80  # set in the op of a reply
_MAGIC = b"CXP1"
_HELLO = struct.Struct("<4sBBHHIIIHIB")
_STORED = struct.Struct("<IHH")
_STATUS = struct.Struct("<BHHBBII")
_FRACTIONS = 1  # bits of HELLO's flags
_TRIGGER_INPUT = 2


class FrameError(ValueError):
    """Bytes that are not a well-formed frame or payload."""


@dataclass(frozen=True, slots=True)
class Framing:
    """Encoding of frames on a line: :data:`BINARY` for UARTs, :data:`TEXT` for consoles.

    Attributes
    ----------
    name : str
    end : bytes
        The one byte that ends a frame and occurs in none.
    wrap, unwrap : callable of bytes to bytes
        From bytes to a frame without its end, and back; `unwrap` raises `FrameError`.
    """

    name: str
    end: bytes
    wrap: Callable[[bytes], bytes]
    unwrap: Callable[[bytes], bytes]

    def encode(self, body: bytes) -> bytes:
        """Make a whole frame of a body: CRC-16 appended, low byte first, and the end."""
        return self.wrap(body + crc16(body).to_bytes(2, "little")) + self.end

    def decode(self, frame: bytes) -> bytes:
        """Return the body of a frame without its end.

        FrameError if it is malformed, shorter than a body of two bytes, or its CRC is wrong.
        """
        raw = self.unwrap(frame)
        if len(raw) < 4:
            raise FrameError(f"frame has {len(raw)} bytes: at least 4 are needed")
        body = raw[:-2]
        crc = int.from_bytes(raw[-2:], "little")
        if crc16(body) != crc:
            raise FrameError(f"frame has CRC 0x{crc:04x}: its bytes give 0x{crc16(body):04x}")
        return body

    def split(self, buffer: bytes) -> tuple[list[bytes], bytes]:
        """Split received bytes into complete frames, without their ends, and the rest."""
        # a sender begins with an end, which closes noise: such frames are empty
        *frames, unfinished = buffer.split(self.end)
        return [frame for frame in frames if frame], unfinished


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, not reflected.

    Examples
    --------
    >>> hex(crc16(b"123456789"))
    '0x29b1'
    """
    return binascii.crc_hqx(data, 0xFFFF)


def _from_stuffed(stuffed: bytes) -> bytes:
    try:
        return bytes(cobs.decode(stuffed))
    except cobs.DecodeError as error:
        raise FrameError(f"frame is not byte-stuffed: {error}") from None


def _to_text(data: bytes) -> bytes:
    return b":" + data.hex().upper().encode()


def _from_text(line: bytes) -> bytes:
    # A console may print a prompt or a half line in front.
    digits = line.rstrip(b"\r").rpartition(b":")
    if not digits[1] or not _HEX.fullmatch(digits[2]):
        raise FrameError("line is no frame: a colon and upper-case hexadecimal digits are needed")
    return bytes.fromhex(digits[2].decode())


BINARY = Framing("binary", b"\0", cobs.encode, _from_stuffed)
"""Consistent-overhead byte stuffing and 0x00.

References
----------
S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Trans. Networking 7(2),
1999, section III."""
TEXT = Framing("text", b"\n", _to_text, _from_text)
"""``:``, upper-case hexadecimal digits, newline: nothing that a console would take for a
command."""


class Op(IntEnum):
    """Requests."""

    HELLO = 1  # properties of the device
    LOAD = 2  # store a program
    READ = 3  # send the stored program back
    ARM = 4  # obey the next trigger, for as long as the lease
    TRIG = 5  # play once, as the trigger input does
    ABORT = 6  # close and disarm, in any state
    STATUS = 7


class State(IntEnum):
    """States of the player; the shutter can be open in PLAY only."""

    IDLE = 0  # nothing is stored
    LOADED = 1
    ARMED = 2  # the lease runs
    PLAY = 3
    DONE = 4  # a play has ended
    FAULT = 5  # an edge was missed: closed, and the play does not count


AT_REST = frozenset({State.IDLE, State.LOADED})
"""States after ABORT: closed, and no trigger is obeyed."""


class ResetCause(IntEnum):
    """Cause of the device's last reset."""

    POWER = 0
    RESET_LINE = 1  # the button, or opening the serial port
    BROWN_OUT = 2  # the supply was too low
    WATCHDOG = 3  # the program hung
    UNKNOWN = 255

    @classmethod
    def _missing_(cls, _value: object) -> ResetCause:
        return cls.UNKNOWN  # a later version may know more causes


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply: the request's `op` and `seq`, the `error` byte (0 is success) and its `data`."""

    op: int
    seq: int
    error: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Hello:
    """Properties of a device; times in its ticks where so named, and None for no limit.

    Parameters
    ----------
    version : int
        Protocol version.
    fractions, trigger_input : bool
        Whether a chip may last a fraction of a tick, and whether there is a trigger input.
    max_chips, tick_ns, min_ticks, max_ticks : int
        Longest code, clock tick, and range of the chip time.
    max_on_ticks : int or None
        Longest opening.
    max_duty : float or None
        Largest open fraction of a program.
    lead_ns : int
        Time from a trigger to the first chip.
    reset_cause : ResetCause
    firmware : str
        Name and version.
    """

    version: int
    fractions: bool
    trigger_input: bool
    max_chips: int
    tick_ns: int
    min_ticks: int
    max_ticks: int
    max_on_ticks: int | None
    max_duty: float | None
    lead_ns: int
    reset_cause: ResetCause
    firmware: str

    @property
    def max_on_ns(self) -> int | None:
        """Longest opening, ns."""
        return None if self.max_on_ticks is None else self.max_on_ticks * self.tick_ns


@dataclass(frozen=True, slots=True)
class Status:
    """State of the player, with chips begun, plays ended and edges missed."""

    state: State
    pos: int
    runs: int
    late: int
    bad_frames: int
    uptime_us: int
    stored_crc32: int


def request_body(op: int, seq: int, payload: bytes = b"") -> bytes:
    """Make the body of a request."""
    return bytes([op, seq]) + payload


def parse_reply(body: bytes) -> Reply:
    """Parse the body of a reply; FrameError if it is too short, or no reply."""
    if len(body) < 3:
        raise FrameError(f"frame has a body of {len(body)} bytes: a reply has at least 3")
    if not body[0] & _REPLY:
        raise FrameError(f"frame with op 0x{body[0]:02x} is not a reply")
    return Reply(body[0] & ~_REPLY, body[1], body[2], body[3:])


def op_name(op: int) -> str:
    """Name of a request, or its number."""
    return Op(op).name if op in Op._value2member_map_ else f"op {op}"


def unpack_crc(data: bytes) -> int:
    """Parse the data of LOAD's reply: the CRC-32 of the stored program.

    FrameError if it is not four bytes.
    """
    if len(data) != 4:
        raise FrameError(f"LOAD reply has {len(data)} bytes: 4 are needed")
    return int.from_bytes(data, "little")


def pack_arm(lease_ms: int) -> bytes:
    """Payload of ARM: after `lease_ms` (1..65535) without a trigger the device disarms itself."""
    if isinstance(lease_ms, bool) or not isinstance(lease_ms, int) or not 1 <= lease_ms <= 0xFFFF:
        raise ValueError(f"lease_ms is {lease_ms!r}: a whole number 1..65535 is needed")
    return struct.pack("<H", lease_ms)


def unpack_hello(data: bytes) -> Hello:
    """Parse the data of HELLO.

    FrameError if it is not CXP1 version 1 or announces nothing that can be played.
    """
    if data[:4] != _MAGIC:
        raise FrameError(f"HELLO reply begins with {data[:4]!r}: {_MAGIC!r} is needed")
    if len(data) > 4 and data[4] != 1:
        raise FrameError(f"HELLO reply has protocol version {data[4]}: version 1 is needed")
    if len(data) < _HELLO.size:
        raise FrameError(f"HELLO reply has {len(data)} bytes: at least {_HELLO.size} are needed")
    # the layout, and which values stand for no limit, is in docs/cxp1.md
    _, version, flags, chips, tick_ns, *limits, lead_ns, cause = _HELLO.unpack_from(data)
    min_ticks, max_ticks, max_on_ticks, permille = limits
    if not chips or not tick_ns or not 1 <= min_ticks <= max_ticks:
        raise FrameError(
            f"HELLO reply has {chips} chips of {min_ticks}..{max_ticks} ticks of {tick_ns} ns:"
            " all must be at least 1, in order"
        )
    return Hello(
        version=version,
        fractions=bool(flags & _FRACTIONS),
        trigger_input=bool(flags & _TRIGGER_INPUT),
        max_chips=chips,
        tick_ns=tick_ns,
        min_ticks=min_ticks,
        max_ticks=max_ticks,
        max_on_ticks=max_on_ticks or None,
        max_duty=permille / 1000 if 0 < permille < 1000 else None,
        lead_ns=lead_ns,
        reset_cause=ResetCause(cause),
        firmware=data[_HELLO.size :].decode("ascii", "replace").split("\0")[0],
    )


def unpack_status(data: bytes) -> Status:
    """Parse the data of STATUS; FrameError if it is too short or the state is unknown."""
    if len(data) < _STATUS.size:
        raise FrameError(f"STATUS reply has {len(data)} bytes: {_STATUS.size} are needed")
    state, *figures = _STATUS.unpack_from(data)
    if state not in State._value2member_map_:
        raise FrameError(f"STATUS reply has state {state}: 0..{max(State)} are known")
    return Status(State(state), *figures)


@dataclass(frozen=True, slots=True)
class Stored:
    """A program as stored: `bits`, each for ``ticks + fraction / 65536`` ticks of the device."""

    bits: str
    ticks: int
    fraction: int

    @property
    def payload(self) -> bytes:
        """Payload of LOAD, and data of READ."""
        packed = Program(self.bits, 1).to_bytes()
        return _STORED.pack(self.ticks, self.fraction, len(self.bits)) + packed

    @property
    def crc32(self) -> int:
        """CRC-32 of `payload`, as the device computes it."""
        return zlib.crc32(self.payload)

    @property
    def chip_ticks(self) -> Fraction:
        """Exact chip time, ticks."""
        return self.ticks + Fraction(self.fraction, 65536)

    def difference(self, stored: Stored) -> str:
        """Describe how ``stored`` differs, in a few words; empty when they are equal."""
        if self.chip_ticks != stored.chip_ticks:
            return (
                f"chip of {float(stored.chip_ticks):.7g} ticks, not {float(self.chip_ticks):.7g}"
            )
        if len(self.bits) != len(stored.bits):
            return f"{len(stored.bits)} chips, not {len(self.bits)}"
        wrong = [k for k, (a, b) in enumerate(zip(self.bits, stored.bits, strict=True)) if a != b]
        if not wrong:
            return ""
        return f"{len(wrong)} of {len(self.bits)} chips differ, the first is chip {wrong[0]}"


def stored_program(program: Program, hello: Hello, *, clock_ppm: float = 0.0) -> Stored:
    """Express a program in a device's ticks.

    Parameters
    ----------
    hello : Hello
        HELLO of the device.
    clock_ppm : float
        Error of the device's clock, parts per million, positive when fast: chips are stretched by
        as much, to the nearest fraction of a tick when the device takes fractions, or else to the
        nearest tick. With 0 the chip must be a whole number of ticks.

    Raises
    ------
    ValueError
        If the chip is not a whole number of ticks, or out of the device's range, or there are too
        many chips.
    """
    if not abs(clock_ppm) <= 100_000:
        raise ValueError(
            f"clock_ppm is {clock_ppm}: a clock is off by at most 100000 ppm, anything else is not"
            " its clock"
        )
    # As a fraction: 1/65536 of a tick over 65535 chips must not depend on float rounding.
    exact = Fraction(program.chip_ns, hello.tick_ns) * (1 + Fraction(clock_ppm) / 10**6)
    units = round(exact * 65536) if hello.fractions else round(exact) * 65536
    ticks, fraction = divmod(units, 65536)
    if not clock_ppm and program.chip_ns % hello.tick_ns:
        raise ValueError(
            f"chip of {program.chip_ns} ns is not a whole number of the device's {hello.tick_ns}"
            " ns ticks"
        )
    # The longest chip of the device is whole: a fraction more would overflow its counter.
    if not hello.min_ticks <= ticks <= hello.max_ticks - (fraction > 0):
        min_ns = hello.min_ticks * hello.tick_ns
        max_ns = hello.max_ticks * hello.tick_ns
        raise ValueError(
            f"chip of {program.chip_ns} ns cannot be played: the device takes {min_ns} to"
            f" {max_ns} ns"
        )
    if program.chips > hello.max_chips:
        raise ValueError(
            f"code of {program.chips} chips is too long: the device plays at most"
            f" {hello.max_chips}"
        )
    return Stored(program.bits, ticks, fraction)


def unpack_stored(data: bytes) -> Stored:
    """Parse the data of READ; FrameError if lengths disagree or it is no program."""
    if len(data) <= _STORED.size:
        raise FrameError(
            f"READ reply has {len(data)} bytes: at least {_STORED.size + 1} are needed"
        )
    ticks, fraction, chips = _STORED.unpack_from(data)
    try:
        return Stored(
            Program.from_bytes(data[_STORED.size :], chips=chips, chip_ns=1).bits, ticks, fraction
        )
    except ValueError as error:
        raise FrameError(f"READ reply holds no program: {error}") from None
