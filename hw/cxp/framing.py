"""Frames on a byte stream, with a CRC and a reserved end byte."""

from __future__ import annotations

import binascii
import re
from collections.abc import Callable
from dataclasses import dataclass

from cobs import cobs

_HEX = re.compile(rb"(?:[0-9A-F]{2})+")


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
