"""Frames on a byte stream, with a CRC and a reserved end byte."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

_HEX = re.compile(rb"(?:[0-9A-F]{2})+")


class FrameError(ValueError):
    """Bytes that are not a well-formed frame or payload."""


@dataclass(frozen=True, slots=True)
class Framing:
    """Encoding of frames on a line: :data:`BINARY` for UARTs, :data:`TEXT` for consoles.

    Parameters
    ----------
    name : str
        For messages.
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

        Raises
        ------
        FrameError
            If it is malformed, shorter than a body of two bytes, or its CRC is wrong.
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
        """Split received bytes into complete frames without their ends (empty ones dropped) and
        the unfinished rest.
        """
        *frames, rest = buffer.split(self.end)
        return [frame for frame in frames if frame], rest


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, not reflected.

    Examples
    --------
    >>> hex(crc16(b"123456789"))
    '0x29b1'
    """
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        crc &= 0xFFFF
    return crc


def cobs_encode(data: bytes) -> bytes:
    """Consistent-overhead byte stuffing: the same data without any 0x00, without a delimiter.

    References
    ----------
    S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Trans. Networking 7(2),
    1999, section III.

    Examples
    --------
    >>> cobs_encode(bytes([0x11, 0x22, 0x00, 0x33])).hex()
    '0311220233'
    """
    out = bytearray()
    block = bytearray()
    for byte in data:
        if byte:
            block.append(byte)
        if not byte or len(block) == 254:
            out += bytes([len(block) + 1]) + block
            block.clear()
            full = byte != 0
    if not data or block or not full:
        out += bytes([len(block) + 1]) + block
    return bytes(out)


def cobs_decode(data: bytes) -> bytes:
    """Undo `cobs_encode`.

    Raises
    ------
    FrameError
        If `data` is empty, holds a 0x00, or a length byte points past the end.
    """
    if not data or 0 in data:
        raise FrameError("frame is empty or holds 0x00: it is not byte-stuffed")
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        if at + code > len(data):
            raise FrameError(
                f"frame is cut short: a block of {code} bytes at {at} passes its {len(data)} bytes"
            )
        out += data[at + 1 : at + code]
        at += code
        if code < 0xFF and at < len(data):
            out.append(0)
    return bytes(out)


def _to_text(data: bytes) -> bytes:
    return b":" + data.hex().upper().encode()


def _from_text(line: bytes) -> bytes:
    # A console may print a prompt or a half line in front.
    digits = line.rstrip(b"\r").rpartition(b":")
    if not digits[1] or not _HEX.fullmatch(digits[2]):
        raise FrameError("line is no frame: a colon and upper-case hexadecimal digits are needed")
    return bytes.fromhex(digits[2].decode())


BINARY = Framing("binary", b"\0", cobs_encode, cobs_decode)
"""Byte stuffing (COBS) and 0x00."""
TEXT = Framing("text", b"\n", _to_text, _from_text)
"""``:``, upper-case hexadecimal digits, newline: nothing that a console would take for a
command."""
