"""Image files before they are decoded: kind, completeness, and size in pixels, which is limited."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from motdiff.io.inputs import regular_file

__all__ = ["JPEG", "MOST_PX", "check_px", "photo_bytes"]

MOST_PX = 120_000_000
"""Pixels of the largest photo that is read: in colour 2.9 GB as float64, and restoring it takes several times that."""

JPEG = b"\xff\xd8\xff"
"""First bytes of a JPEG file."""

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_MOST_BYTES = 2**31  # 120 megapixels of four 32-bit samples
_FRAME_MARKERS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # SOF0 to SOF15 without DHT, JPG and DAC


def photo_bytes(path: Path | str) -> bytes:
    """Read an image file for decoding; incomplete and too large files are refused.

    Decoders fill the missing part of a cut file with grey and call it a success. And a small file may hold a large
    image: a white one of 30,000 x 30,000 px fits into a megabyte, and takes gigabytes once it is decoded.

    Parameters
    ----------
    path : path of a PNG, JPEG, TIFF or WebP file, whatever its name

    Returns
    -------
    bytes, never empty

    Raises
    ------
    ValueError
        If the file is no regular file, empty, of another format, cut short, or has more than :data:`MOST_PX` pixels;
        the line names it.
    OSError
        If the file cannot be read.
    """
    source = regular_file(path)
    length = source.stat().st_size
    if length > _MOST_BYTES:
        raise ValueError(f"{source}: has {length / 1e9:.1f} GB, an image file of at most 2 GB is read")
    data = source.read_bytes()
    if not data:
        raise ValueError(f"{source}: the file is empty")
    if data.startswith(_PNG):
        complete, size = _png_complete(data), _png_size
    elif data.startswith(JPEG):
        complete, size = _jpeg_complete(data), _jpeg_size
    elif data.startswith(_TIFF):
        complete, size = True, _tiff_size  # libtiff refuses cut files by itself
    elif data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        complete, size = _webp_complete(data), _webp_size
    else:
        raise ValueError(f"{source}: not a PNG, JPEG, TIFF or WebP image (it begins with {data[:12]!r})")
    try:
        width, height = size(data)
    except (struct.error, ValueError):
        complete = False
    if not complete:
        raise ValueError(f"{source}: the image is damaged or cut short after {len(data)} bytes")
    check_px(width, height, source)
    return data


def check_px(width: int, height: int, name: object) -> None:
    """Refuse an image of more than :data:`MOST_PX` pixels.

    Raises
    ------
    ValueError
        The line begins with ``name``.
    """
    if width * height > MOST_PX:
        raise ValueError(
            f"{name}: {width} x {height} px are {width * height / 1e6:.0f} megapixels, at most {MOST_PX / 1e6:.0f} are "
            "read; crop the photo or scale it down"
        )


# -- completeness -----------------------------------------------------------------------------------------------------


def _png_complete(data: bytes) -> bool:
    """Walk the chunks to IEND, checking each CRC (PNG specification, section 5.3)."""
    at = len(_PNG)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        if at + 12 + length > len(data):
            return False
        (crc,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(memoryview(data)[at + 4 : at + 8 + length]) != crc:
            return False
        if kind == b"IEND":
            return True
        at += 12 + length
    return False


def _jpeg_complete(data: bytes) -> bool:
    """Look for the end marker behind the first scan's header: a thumbnail's own end does not count."""
    scan = next((end for marker, _, end in _jpeg_segments(data) if marker == 0xDA), None)
    return scan is not None and data.find(b"\xff\xd9", scan) >= 0


def _webp_complete(data: bytes) -> bool:
    """Compare the length with the one in the file's header."""
    (length,) = struct.unpack_from("<I", data, 4)
    return bool(8 + length <= len(data))


# -- width and height, px ---------------------------------------------------------------------------------------------


def _png_size(data: bytes) -> tuple[int, int]:
    kind, width, height = struct.unpack_from(">4s2I", data, len(_PNG) + 4)
    if kind != b"IHDR":
        raise ValueError("the first chunk must be IHDR")
    return width, height


def _jpeg_size(data: bytes) -> tuple[int, int]:
    for marker, start, _ in _jpeg_segments(data):
        if marker in _FRAME_MARKERS:
            height, width = struct.unpack_from(">2H", data, start + 3)
            return width, height
    raise ValueError("no frame before the first scan")


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield marker, start and end of each segment's body (its length included) up to the first scan's header."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # padding before a marker
            at += 1
            continue
        end = at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        yield marker, at + 2, end
        if marker == 0xDA:
            return
        at = end


def _tiff_size(data: bytes) -> tuple[int, int]:
    """Read the first directory (TIFF 6.0, section 2; BigTIFF)."""
    order, large = ("<" if data[:2] == b"II" else ">"), data[2:4] in (b"+\0", b"\0+")
    offset, count, entry = ("Q", "Q", "HHQ") if large else ("I", "H", "HHI")
    (at,) = struct.unpack_from(order + offset, data, 8 if large else 4)
    (entries,) = struct.unpack_from(order + count, data, at)
    at += struct.calcsize(order + count)
    sides: dict[int, int] = {}
    for _ in range(min(entries, 2**16)):
        tag, kind, _ = struct.unpack_from(order + entry, data, at)
        at += struct.calcsize(order + entry)
        if tag in (256, 257) and kind in (3, 4, 16):  # width and height, of 2, 4 or 8 bytes
            (sides[tag],) = struct.unpack_from(order + {3: "H", 4: "I", 16: "Q"}[kind], data, at)
        at += struct.calcsize(order + offset)
        if len(sides) == 2:
            return sides[256], sides[257]
    raise ValueError("no width or no height")


def _webp_size(data: bytes) -> tuple[int, int]:
    """Read the first chunk: lossy, lossless or extended (RFC 9649)."""
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<2H", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X" and len(data) >= 30:
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    raise ValueError("no such chunk")
