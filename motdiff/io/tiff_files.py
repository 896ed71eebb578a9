"""Directories of TIFF files and of EXIF data: which page of a file is its photo, and how its samples are stored."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

__all__ = ["TIFF", "Tag", "TiffPage", "exif_orientation", "photo_page"]

TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF file: either byte order, the last two BigTIFF."""

_FORMATS = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}  # field types that hold unsigned integers
_MOST_PAGES = 4096
_NO_PHOTO = 0b1101  # bits of NewSubfileType: reduced, mask, depth map; bit 1 is a page of several
_TRANSPARENCY_MASK = 4  # photometric interpretation


class Tag(IntEnum):
    """Fields of a directory that say how its image is stored."""

    NEW_SUBFILE_TYPE = 254
    SUBFILE_TYPE = 255
    WIDTH = 256
    LENGTH = 257
    BITS = 258
    COMPRESSION = 259
    PHOTOMETRIC = 262
    FILL_ORDER = 266
    STRIP_OFFSETS = 273
    ORIENTATION = 274
    SAMPLES = 277
    ROWS_PER_STRIP = 278
    STRIP_BYTES = 279
    PLANES = 284
    PREDICTOR = 317
    TILE_WIDTH = 322
    TILE_LENGTH = 323
    TILE_OFFSETS = 324
    TILE_BYTES = 325
    SUB_DIRECTORIES = 330
    EXTRA_SAMPLES = 338
    SAMPLE_FORMAT = 339
    DEPTH = 32997


_TAGS = frozenset(Tag)


@dataclass(frozen=True)
class TiffPage:
    """A directory of a TIFF file (TIFF 6.0, section 2; BigTIFF).

    Attributes
    ----------
    order : {"<", ">"}
        Byte order of the file.
    offset : int
        Of the directory, bytes.
    large : bool
        Whether offsets have 8 bytes (BigTIFF).
    values : mapping of int to tuple of int
        Of each tag about the image.
    places : mapping of int to (int, str)
        Of each of these tags: where its first value stands in the file, and its format for :mod:`struct`.
    """

    order: Literal["<", ">"]
    offset: int
    large: bool
    values: Mapping[int, tuple[int, ...]]
    places: Mapping[int, tuple[int, str]]

    def value(self, tag: int, default: int) -> int:
        """First value of a tag."""
        return self.values.get(tag, (default,))[0]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px; 0 where one is missing."""
        return self.value(Tag.WIDTH, 0), self.value(Tag.LENGTH, 0)

    @property
    def is_photo(self) -> bool:
        """Whether it is said to be neither a reduced image nor a mask nor a depth map."""
        reduced = self.value(Tag.NEW_SUBFILE_TYPE, 0) & _NO_PHOTO or self.value(Tag.SUBFILE_TYPE, 1) == 2
        return not reduced and self.value(Tag.PHOTOMETRIC, 1) != _TRANSPARENCY_MASK

    @property
    def orientation(self) -> int:
        """How it is turned upright, 1 to 8 (TIFF 6.0, section 8); 1, as it is, where nothing valid is said."""
        orientation = self.value(Tag.ORIENTATION, 1)
        return orientation if 1 <= orientation <= 8 else 1

    def as_first(self, data: bytes, changes: Mapping[Tag, int]) -> bytes:
        """Copy a file's bytes so that this is its first page, with other first values of some of its tags."""
        copy = bytearray(data)
        struct.pack_into(self.order + ("Q" if self.large else "I"), copy, 8 if self.large else 4, self.offset)
        for tag, value in changes.items():
            if tag in self.places:
                place, form = self.places[tag]
                struct.pack_into(self.order + form, copy, place, value)
        return bytes(copy)


def photo_page(data: bytes) -> tuple[TiffPage, int, int]:
    """Find the photo among the pages of a TIFF file: previews, masks and depth maps are none.

    Returns
    -------
    page, number, pages : TiffPage, int, int
        The largest photo, the first of equals; its number, from 1; how many there are.

    Raises
    ------
    ValueError, struct.error
        If the file is damaged or cut short.
    """
    pages: list[TiffPage] = []
    try:
        pages.extend(_pages(data))
    except (struct.error, ValueError):
        if not any(page.is_photo for page in pages):
            raise
    photos = [page for page in pages if page.is_photo] or pages
    if not photos:
        raise ValueError("no page has a width and a height")
    areas = [page.size[0] * page.size[1] for page in photos]
    largest = areas.index(max(areas))
    return photos[largest], largest + 1, len(photos)


def exif_orientation(exif: bytes) -> int:
    """Orientation in EXIF data; 1, as it is, where there is none or the data are damaged."""
    try:
        page, _ = _directory(exif, *_header(exif))
    except (struct.error, ValueError):
        return 1
    return page.orientation


def _header(data: bytes) -> tuple[Literal["<", ">"], bool, int]:
    """Byte order, whether offsets have 8 bytes, and offset of the first directory."""
    if not data.startswith(TIFF):
        raise ValueError("no TIFF header")
    order: Literal["<", ">"] = "<" if data[:2] == b"II" else ">"
    large = data[2:4] in (b"+\0", b"\0+")
    (first,) = struct.unpack_from(order + ("Q" if large else "I"), data, 8 if large else 4)
    return order, large, first


def _pages(data: bytes) -> Iterator[TiffPage]:
    """Yield the directories with an image: those of the file's chain, then those below them."""
    order, large, offset = _header(data)
    below: list[int] = []
    seen: set[int] = set()
    while offset and offset not in seen and len(seen) < _MOST_PAGES:
        seen.add(offset)
        page, offset = _directory(data, order, large, offset)
        below += page.values.get(Tag.SUB_DIRECTORIES, ())[:_MOST_PAGES]
        if min(page.size):
            yield page
    if not seen:
        raise ValueError("no directory")
    for offset in below[:_MOST_PAGES]:
        page, _ = _directory(data, order, large, offset)
        if min(page.size):
            yield page


def _directory(data: bytes, order: Literal["<", ">"], large: bool, offset: int) -> tuple[TiffPage, int]:
    """Read one directory, and the offset of the next."""
    word, counter, head = ("Q", "Q", "HHQ") if large else ("I", "H", "HHI")
    values: dict[int, tuple[int, ...]] = {}
    places: dict[int, tuple[int, str]] = {}
    (entries,) = struct.unpack_from(order + counter, data, offset)
    at = offset + struct.calcsize(order + counter)
    inline = struct.calcsize(order + word)
    length = struct.calcsize(order + head) + inline
    if at + entries * length > len(data):
        raise ValueError("the directory is cut short")
    for entry in range(at, at + entries * length, length):
        tag, kind, count = struct.unpack_from(order + head, data, entry)
        form = _FORMATS.get(kind)
        if tag not in _TAGS or form is None or not count:
            continue
        place = entry + length - inline
        if count * struct.calcsize(order + form) > inline:
            (place,) = struct.unpack_from(order + word, data, place)
        if place + count * struct.calcsize(order + form) > len(data):
            raise ValueError("a field of the directory is cut short")
        values[tag] = struct.unpack_from(f"{order}{count}{form}", data, place)
        places[tag] = (place, form)
    end = at + entries * length
    following = struct.unpack_from(order + word, data, end)[0] if end + inline <= len(data) else 0
    return TiffPage(order, offset, large, values, places), following
