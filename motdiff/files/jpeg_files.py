"""Segments of JPEG data: size of the frame, completeness, and the metadata."""

from __future__ import annotations

import struct
from collections.abc import Iterator

JPEG = b"\xff\xd8\xff"
"""First bytes of JPEG data."""

# SOF0 to SOF15 without DHT, JPG and DAC (ITU-T T.81, table B.1)
_FRAME_MARKERS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_SCAN = 0xDA  # SOS


def jpeg_complete(data: bytes) -> bool:
    """Whether the end marker is there, behind the first scan's header."""
    # before it there may be the end of a thumbnail
    scans = (end for marker, _, end in jpeg_segments(data) if marker == _SCAN)
    return data.find(b"\xff\xd9", next(scans, len(data))) >= 0


def jpeg_size(data: bytes) -> tuple[int, int]:
    """Width and height of the frame, px.

    Raises
    ------
    ValueError, struct.error
        If there is no frame before the first scan.
    """
    for marker, start, _ in jpeg_segments(data):
        if marker in _FRAME_MARKERS:
            height, width = struct.unpack_from(">2H", data, start + 3)
            return width, height
    raise ValueError("no frame before the first scan")


def jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield marker, start and end of each segment up to the first scan's header.

    A segment starts with its length. Behind the header comes entropy-coded data without lengths.
    """
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # padding before a marker
            at += 1
            continue
        end = at + 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        yield marker, at + 2, end
        if marker == _SCAN:
            return
        at = end
