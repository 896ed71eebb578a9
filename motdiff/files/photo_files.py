"""Image files before they are decoded: kind, completeness, orientation, limited size."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from motdiff.files.inputs import regular_file
from motdiff.files.jpeg_files import JPEG, jpeg_complete, jpeg_segments, jpeg_size
from motdiff.files.tiff_files import TIFF, exif_orientation, photo_page

MOST_PX = 120_000_000
"""Pixels of the largest photo that is read: in colour 2.9 GB as float64, and restoring it takes
several times that."""

_PNG = b"\x89PNG\r\n\x1a\n"
_EXIF = b"Exif\0\0"  # before EXIF data in JPEG, and by mistake in some WebP files
_MOST_BYTES = 2**31  # 120 megapixels of four 32-bit samples


def photo_bytes(path: Path | str) -> bytes:
    """Read an image file for decoding; incomplete and too large files are refused.

    Decoders fill the missing part of a cut file with grey and call it a success. And a small file
    may hold a large image: a white one of 30,000 x 30,000 px fits into a megabyte, and takes
    gigabytes once it is decoded.

    Parameters
    ----------
    path : path
        A PNG, JPEG, TIFF or WebP file, whatever its name.

    Raises
    ------
    ValueError
        If the file is no regular file, empty, of another format, cut short, or has more than
        :data:`MOST_PX` pixels; the line names it.
    OSError
        If the file cannot be read.
    """
    source = regular_file(path)
    length = source.stat().st_size
    if length > _MOST_BYTES:
        raise ValueError(
            f"{source}: has {length / 1e9:.1f} GB, an image file of at most 2 GB is read"
        )
    data = source.read_bytes()
    if not data:
        raise ValueError(f"{source}: the file is empty")
    if data.startswith(_PNG):
        complete = _png_complete(data)
        size = _png_size
    elif data.startswith(JPEG):
        complete = jpeg_complete(data)
        size = jpeg_size
    elif data.startswith(TIFF):
        complete = True  # what is cut off shows as it is decoded
        size = _tiff_size
    elif _is_webp(data):
        complete = _webp_complete(data)
        size = _webp_size
    else:
        raise ValueError(
            f"{source}: not a PNG, JPEG, TIFF or WebP image (it begins with {data[:12]!r})"
        )
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
            f"{name}: {width} x {height} px are {width * height / 1e6:.0f} megapixels, at most"
            f" {MOST_PX / 1e6:.0f} are read; crop the photo or scale it down"
        )


# -- completeness ---------------------------------------------------------------------------------


def _png_complete(data: bytes) -> bool:
    """Check each chunk's CRC up to IEND (PNG specification, section 5.3)."""
    for kind, start, end in _png_chunks(data):
        if zlib.crc32(memoryview(data)[start - 4 : end]).to_bytes(4, "big") != data[end : end + 4]:
            return False
        if kind == b"IEND":
            return True
    return False


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Yield kind, start and end of each whole chunk's content."""
    at = len(_PNG)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        if at + 12 + length > len(data):
            return
        yield kind, at + 8, at + 8 + length
        at += 12 + length


def _is_webp(data: bytes) -> bool:
    return data.startswith(b"RIFF") and data[8:12] == b"WEBP"


def _webp_complete(data: bytes) -> bool:
    """Compare the length with the one in the file's header."""
    (length,) = struct.unpack_from("<I", data, 4)
    return bool(8 + length <= len(data))


# -- orientation, animation -----------------------------------------------------------------------


def orientation(data: bytes) -> int:
    """How a PNG, JPEG or WebP image is turned upright by its EXIF data.

    1 to 8 as in EXIF 2.32, section 4.6.4; 1, as it is, where there are no such data.
    """
    exif = next(_exif(data), b"")
    return exif_orientation(exif.removeprefix(_EXIF))


def is_animated(data: bytes) -> bool:
    """Whether a PNG or WebP file holds more than one picture."""
    if data.startswith(_PNG):
        return any(kind == b"acTL" for kind, _, _ in _png_chunks(data))
    return _is_webp(data) and any(kind == b"ANIM" for kind, _, _ in _webp_chunks(data))


def _exif(data: bytes) -> Iterator[bytes]:
    if data.startswith(_PNG):
        yield from (data[start:end] for kind, start, end in _png_chunks(data) if kind == b"eXIf")
    elif data.startswith(JPEG):
        bodies = (
            data[start + 2 : end] for marker, start, end in jpeg_segments(data) if marker == 0xE1
        )
        yield from (body for body in bodies if body.startswith(_EXIF))
    elif _is_webp(data):
        yield from (data[start:end] for kind, start, end in _webp_chunks(data) if kind == b"EXIF")


def _webp_chunks(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Yield kind, start and end of each chunk's content (RFC 9649, section 2.3)."""
    at = 12
    while at + 8 <= len(data):
        kind, length = struct.unpack_from("<4sI", data, at)
        yield kind, at + 8, at + 8 + length
        at += 8 + length + length % 2


# -- width and height, px -------------------------------------------------------------------------


def _png_size(data: bytes) -> tuple[int, int]:
    kind, width, height = struct.unpack_from(">4s2I", data, len(_PNG) + 4)
    if kind != b"IHDR":
        raise ValueError("the first chunk must be IHDR")
    return width, height


def _tiff_size(data: bytes) -> tuple[int, int]:
    try:
        page, _, _ = photo_page(data)
    except Exception as error:  # of many kinds
        raise ValueError("no page can be read") from error
    return page.imagewidth, page.imagelength


def _webp_size(data: bytes) -> tuple[int, int]:
    """Read the first chunk: lossy, lossless or extended (RFC 9649)."""
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<2H", data, 26)
        return width & 0x3FFF, height & 0x3FFF  # the upper two bits are a scale for display
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1  # 14 bits each, less 1
    if kind == b"VP8X" and len(data) >= 30:
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    raise ValueError("no such chunk")
