"""CXP1, the binary shutter protocol: frames, requests, replies and their payloads as pure functions on bytes.

A frame is ``COBS(op, seq, payload..., crc16 low, crc16 high)`` followed by 0x00; numbers are little endian. The
CRC is CRC-16/CCITT-FALSE over op, seq and payload. A reply is ``op | 0x80, seq, error, data...``. A device that
sees the request it answered last (same op, seq and CRC) answers again without doing it again, so that a retry
after a lost reply never plays twice; to a frame with a wrong CRC it says nothing.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from hw.framing import FrameError, cobs_decode, cobs_encode, crc16
from hw.program import Program

__all__ = [
    "MAX_TICKS",
    "BadLengthError",
    "BadOpError",
    "DeviceError",
    "DutyLimitError",
    "ErrorCode",
    "Hello",
    "Op",
    "OutOfRangeError",
    "Reply",
    "State",
    "Status",
    "WrongStateError",
    "decode_reply",
    "device_error",
    "encode_request",
    "pack_arm",
    "pack_load",
    "unpack_hello",
    "unpack_load",
    "unpack_status",
]

MAX_TICKS = 0xFFFF
"""Most ticks per chip, and most chips, that a LOAD can say."""

_REPLY = 0x80
_MAGIC = b"CXP1"


class Op(IntEnum):
    """Requests."""

    HELLO = 1
    LOAD = 2
    READ = 3
    ARM = 4
    TRIG = 5
    ABORT = 6
    STATUS = 7


class State(IntEnum):
    """States of the player; the shutter can be open in PLAY only."""

    IDLE = 0
    LOADED = 1
    ARMED = 2
    PLAY = 3
    DONE = 4
    FAULT = 5


class ErrorCode(IntEnum):
    """Error byte of a reply."""

    OK = 0
    BAD_OP = 1
    BAD_LENGTH = 2
    OUT_OF_RANGE = 3
    WRONG_STATE = 4
    DUTY_LIMIT = 5


class DeviceError(RuntimeError):
    """The device understood a request and refused it; nothing changed in the device."""


class BadOpError(DeviceError):
    """The device does not know the request."""


class BadLengthError(DeviceError):
    """The payload has a length the request does not take."""


class OutOfRangeError(DeviceError):
    """A value is outside what the device takes."""


class WrongStateError(DeviceError):
    """The request is not allowed in the present state."""


class DutyLimitError(DeviceError):
    """The program is open for longer than the device's own limit allows."""


_ERRORS: dict[int, tuple[type[DeviceError], str]] = {
    ErrorCode.BAD_OP: (BadOpError, "unknown request: its firmware is another version"),
    ErrorCode.BAD_LENGTH: (BadLengthError, "wrong payload length: its firmware is another version"),
    ErrorCode.OUT_OF_RANGE: (OutOfRangeError, "value out of range: check chip time and number of chips"),
    ErrorCode.WRONG_STATE: (WrongStateError, "not allowed in its present state: ask STATUS; load before arm, arm "
                            "before trigger, abort before load"),
    ErrorCode.DUTY_LIMIT: (DutyLimitError, "open for longer than the device's limit: use a code with fewer open chips"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Reply:
    """A decoded reply: the request's `op` and `seq`, the `error` byte (0 is success) and its `data`."""

    op: int
    seq: int
    error: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Hello:
    """What a device says of itself: protocol version, longest code, and clock tick."""

    version: int
    max_chips: int
    tick_ns: int


@dataclass(frozen=True, slots=True)
class Status:
    """State of the player: chip position, completed plays, late edges and bad frames since boot."""

    state: State
    pos: int
    runs: int
    late: int
    bad_frames: int


def encode_request(op: int, seq: int, payload: bytes = b"") -> bytes:
    """Make a whole request frame, closing 0x00 included."""
    body = bytes([op, seq]) + payload
    return cobs_encode(body + struct.pack("<H", crc16(body))) + b"\0"


def decode_reply(frame: bytes) -> Reply:
    """Decode a stuffed reply frame (without its 0x00).

    Raises
    ------
    FrameError
        If the stuffing, length, CRC or reply bit is wrong.
    """
    raw = cobs_decode(frame)
    if len(raw) < 5:
        raise FrameError(f"frame has {len(raw)} bytes: a reply has at least 5")
    body, crc = raw[:-2], int.from_bytes(raw[-2:], "little")
    if crc16(body) != crc:
        raise FrameError(f"frame has CRC 0x{crc:04x}: its bytes give 0x{crc16(body):04x}")
    if not body[0] & _REPLY:
        raise FrameError(f"frame with op 0x{body[0]:02x} is not a reply")
    return Reply(body[0] & ~_REPLY, body[1], body[2], body[3:])


def device_error(reply: Reply, *, source: str) -> DeviceError:
    """Typed exception for a reply that refuses; `source` names the device in its message."""
    kind, text = _ERRORS.get(reply.error, (DeviceError, f"error {reply.error}, which this version does not know"))
    return kind(f"{source} refuses {op_name(reply.op)}: {text}")


def op_name(op: int) -> str:
    """Name of a request, or its number."""
    return Op(op).name if op in Op._value2member_map_ else f"op {op}"


def pack_load(program: Program, *, tick_ns: int) -> bytes:
    """Payload of LOAD for a device of the given tick.

    Raises
    ------
    ValueError
        If the chip is not a whole number of ticks or program or chip are beyond 65535.
    """
    ticks, rest = divmod(program.chip_ns, tick_ns)
    if rest or not 0 < ticks <= MAX_TICKS:
        raise ValueError(f"chip_ns is {program.chip_ns}: it must be 1..{MAX_TICKS} whole ticks of {tick_ns} ns")
    if program.chips > MAX_TICKS:
        raise ValueError(f"program has {program.chips} chips: a LOAD takes at most {MAX_TICKS}")
    return struct.pack("<HH", ticks, program.chips) + program.to_bytes()


def unpack_load(data: bytes, *, tick_ns: int) -> Program:
    """Program in the data of a LOAD or READ reply.

    Raises
    ------
    FrameError
        If lengths disagree or it is no program.
    """
    if len(data) < 4:
        raise FrameError(f"READ reply has {len(data)} bytes: at least 5 are needed")
    ticks, chips = struct.unpack_from("<HH", data)
    try:
        return Program.from_bytes(data[4:], chips=chips, chip_ns=ticks * tick_ns)
    except ValueError as error:
        raise FrameError(f"READ reply holds no program: {error}") from None


def pack_arm(lease_ms: int) -> bytes:
    """Payload of ARM: after `lease_ms` (1..65535) without a trigger the device disarms itself."""
    if isinstance(lease_ms, bool) or not isinstance(lease_ms, int) or not 1 <= lease_ms <= 0xFFFF:
        raise ValueError(f"lease_ms is {lease_ms!r}: a whole number 1..65535 is needed")
    return struct.pack("<H", lease_ms)


def unpack_hello(data: bytes) -> Hello:
    """Read the data of a HELLO reply; further bytes of later versions are ignored.

    Raises
    ------
    FrameError
        If it is not CXP1 version 1 or announces nothing that can be played.
    """
    if len(data) < 10 or data[:4] != _MAGIC:
        raise FrameError(
            f"HELLO reply begins with {data[:4]!r} and has {len(data)} bytes: {_MAGIC!r} and 10 are needed"
        )
    version, _, max_chips, tick_ns = struct.unpack_from("<BBHH", data, 4)
    if version != 1:
        raise FrameError(f"HELLO reply has protocol version {version}: version 1 is needed")
    if not max_chips or not tick_ns:
        raise FrameError(f"HELLO reply has {max_chips} chips and a tick of {tick_ns} ns: both must be at least 1")
    return Hello(version, max_chips, tick_ns)


def unpack_status(data: bytes) -> Status:
    """Read the data of a STATUS reply; further bytes of later versions are ignored.

    Raises
    ------
    FrameError
        If it is too short or the state is unknown.
    """
    if len(data) < 7:
        raise FrameError(f"STATUS reply has {len(data)} bytes: 7 are needed")
    state, pos, runs, late, bad_frames = struct.unpack_from("<BHHBB", data)
    if state not in State._value2member_map_:
        raise FrameError(f"STATUS reply has state {state}: 0..{max(State)} are known")
    return Status(State(state), pos, runs, late, bad_frames)
