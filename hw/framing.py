"""Frames on a byte stream: byte stuffing, so that 0x00 always ends a frame, and the CRC that guards it."""

from __future__ import annotations

__all__ = ["FrameError", "cobs_decode", "cobs_encode", "crc16", "split_frames"]


class FrameError(ValueError):
    """Bytes that are not a well-formed frame or payload."""


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
    S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Trans. Networking 7(2), 1999, section III.

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
            raise FrameError(f"frame is cut short: a block of {code} bytes at {at} passes its {len(data)} bytes")
        out += data[at + 1 : at + code]
        at += code
        if code < 0xFF and at < len(data):
            out.append(0)
    return bytes(out)


def split_frames(buffer: bytes) -> tuple[list[bytes], bytes]:
    """Split received bytes at 0x00 into complete stuffed frames (empty ones dropped) and the unfinished rest."""
    *frames, rest = buffer.split(b"\0")
    return [frame for frame in frames if frame], rest
