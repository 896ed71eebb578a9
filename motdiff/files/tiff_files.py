"""TIFF files by tifffile: the page that is the photo, and its samples as RGB or grey."""

from __future__ import annotations

import math
from collections.abc import Iterator
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from motdiff.files.jpeg_files import jpeg_complete, jpeg_size

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPage

TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF file: either byte order, the last two BigTIFF."""

Samples = NDArray[Any]

# of all directories; reading a directory counts as eight fields: half a second in all
_MOST_FIELDS = 2**15
_MOST_DIRECTORY_BYTES = 2**23  # 120 megapixels in tiles of 16 px take less
_LEAST_PX = 2**24  # a small image may be stored in one large tile
_NO_PHOTO = 0b1101  # bits of NewSubfileType: reduced, mask, depth map; bit 1 is a page of several
_WHITE_IS_ZERO = 0
_BLACK_IS_ZERO = 1
_RGB = 2
_PALETTE = 3
_MASK = 4
_YCBCR = 6
_COLOURS = {5: "CMYK", 8: "CIELab", 32803: "a colour filter mosaic", 34892: "linear RAW"}
_FLOAT = 3
_SAMPLES = {
    2: "integers with a sign",
    _FLOAT: "floating point",
    5: "complex numbers",
    6: "complex numbers",
}
_JPEG = 7
# their decoders unpack no more than is wanted; others may fill memory from a small file
_COMPRESSIONS = (1, 2, 3, 4, 5, _JPEG, 8, 32773, 32946, 34925, 50000)
_MOST_CHANNELS = 8
_ALPHA = (1, 2)  # extra samples: associated, unassociated


class _Directories(BytesIO):
    """A file of which a limited number of bytes is read; directories may name some many times."""

    limit: float = _MOST_DIRECTORY_BYTES

    def read(self, size: int | None = -1, /) -> bytes:
        piece = super().read(size)
        self.limit -= len(piece)
        if self.limit < 0:
            raise ValueError("the directories of the file are too long")
        return piece


def photo_page(data: bytes) -> tuple[TiffPage, int, int]:
    """Find the photo among the pages of a TIFF file: previews, masks and depth maps are none.

    Returns
    -------
    page, number, pages : tifffile.TiffPage, int, int
        The largest photo, the first of equals; its number, from 1; how many there are.

    Raises
    ------
    Exception
        Of any kind, if the file is damaged or cut short.
    """
    stream = _Directories(data)
    pages: dict[int, TiffPage] = {}
    fields = 0
    try:
        for page in _pages(_opened(stream)):
            fields += 8 + len(page.tags)
            if fields > _MOST_FIELDS:
                break
            if min(page.imagewidth, page.imagelength) > 0:
                pages.setdefault(page.offset, page)
    except Exception:  # what follows a photo, and is damaged, does not matter
        if not any(_is_photo(page) for page in pages.values()):
            raise
    stream.limit = math.inf
    photos = [page for page in pages.values() if _is_photo(page)] or [*pages.values()]
    areas = [page.imagewidth * page.imagelength for page in photos]
    largest = areas.index(max(areas))
    return photos[largest], largest + 1, len(photos)


def _opened(stream: BytesIO) -> TiffFile:
    import logging

    from tifffile import TiffFile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)  # it prints what it finds wrong
    # what microscopes add, as frames that no directory describes, is left alone
    return TiffFile(stream, is_lsm=False, is_scanimage=False, is_ndpi=False)


def _pages(file: TiffFile) -> Iterator[Any]:
    """Yield the pages of the file's chain, then those below them."""
    chain = []
    for page in file.pages:
        chain.append(page)
        yield page
    for page in chain:
        yield from page.pages or ()


def _is_photo(page: TiffPage) -> bool:
    return not page.subfiletype & _NO_PHOTO and page.photometric != _MASK


def tiff_orientation(page: TiffPage) -> int:
    """How a page is turned upright, 1 to 8 (TIFF 6.0, section 8); 1 without valid tag."""
    orientation = page.tags.valueof(274)
    if orientation not in range(1, 9):
        return 1
    return int(orientation)


def exif_orientation(exif: bytes) -> int:
    """Orientation in EXIF data, a TIFF file without an image; 1 where they are none or damaged."""
    if not exif:  # most photos that are no TIFF files: tifffile need not be loaded
        return 1
    try:
        return tiff_orientation(_opened(_Directories(exif)).pages.first)
    except Exception:  # of many kinds
        return 1


def _photometric(page: TiffPage) -> int:
    if 262 in page.tags:
        return int(page.photometric)
    if page.samplesperpixel >= 3:
        return _RGB
    return _BLACK_IS_ZERO


def refusal(page: TiffPage) -> str:
    """Why a page is not read, and what would be; empty if it is read."""
    from tifffile import PHOTOMETRIC, TIFF

    photometric = _photometric(page)
    samples = page.samplesperpixel
    bits = page.bitspersample
    compression = int(page.compression)
    kind = int(page.sampleformat)
    if photometric not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PALETTE, _YCBCR):
        names = {colours.value: colours.name for colours in PHOTOMETRIC} | _COLOURS
        return (
            f"its colours are {names.get(photometric, f'of kind {photometric}')}, save it as RGB"
            " or grey"
        )
    if compression not in _COMPRESSIONS or compression not in TIFF.DECOMPRESSORS:
        method = getattr(page.compression, "name", f"method {compression}")
        return f"is compressed by {method}, save it uncompressed, or by LZW or Deflate"
    if page.imagedepth > 1:
        return f"is a volume of {page.imagedepth} layers, save one of them as a photo"
    if samples > _MOST_CHANNELS:
        return f"has {samples} channels, save those of red, green and blue, or one of them"
    alpha = sum(sample in _ALPHA for sample in page.extrasamples)
    if photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO) and samples - alpha > 1:
        return f"has {samples - alpha} channels of no colour, save one of them, or three as RGB"
    if photometric in (_RGB, _YCBCR) and samples < 3:
        return f"has {samples} channels for red, green and blue, save it as RGB or grey"
    if isinstance(bits, tuple):
        return "its channels differ in kind, save it with 8 or 16 bits in each"
    is_integer = kind not in _SAMPLES and 1 <= bits <= 16
    is_float = kind == _FLOAT and bits in (16, 32, 64)
    if not (is_integer or is_float):
        return (
            f"has {bits}-bit {_SAMPLES.get(kind, 'integers')}, save it as 8 or 16 bit, or as"
            " floating point of 32"
        )
    if photometric == _YCBCR and (bits != 8 or (page.is_subsampled and compression != _JPEG)):
        return (
            "its colours are YCbCr of fewer samples than pixels, or not of 8 bits; save it as RGB"
            " or grey"
        )
    return ""


def channels(page: TiffPage) -> tuple[Samples, Samples]:
    """Read the samples of a page that is not refused: its colours, and what is beside them.

    Returns
    -------
    colours : (H, W) or (H, W, 3) array of uint8, uint16 or floating point
        Grey, or red green blue; 0 is black; not turned upright.
    extra : (H, W, C) array

    Raises
    ------
    Exception
        Of any kind, if the file is damaged or cut short.
    """
    _check_segments(page)
    photometric = _photometric(page)
    bits = page.bitspersample
    # planes, rows, columns, channels that are stored together
    planes = page.asarray(squeeze=False)[:, 0]
    samples = planes[0]
    if len(planes) > 1:
        samples = np.moveaxis(planes[:, :, :, 0], 0, 2)
    if photometric == _PALETTE:
        palette = (np.asarray(page.colormap) >> 8).astype(np.uint8).T
        return palette[samples[:, :, 0].astype(np.uint16)], samples[:, :, 1:]
    if bits % 8:
        # codes of 1 to 15 bits, stretched to the full scale of the integers that hold them
        unsigned = np.dtype(f"u{samples.itemsize}")
        largest = 2**bits - 1
        codes = (np.arange(2**bits) * full_scale(unsigned) + largest // 2) // largest
        samples = codes.astype(unsigned)[samples.view(unsigned)]
    if photometric == _WHITE_IS_ZERO:
        samples = full_scale(samples.dtype) - samples
    # JPEG's decoder gives RGB, unless its planes are apart
    if photometric == _YCBCR and (page.compression != _JPEG or page.planarconfig == 2):
        import cv2

        return cv2.cvtColor(samples[:, :, [0, 2, 1]], cv2.COLOR_YCrCb2RGB), samples[:, :, 3:]
    if photometric in (_RGB, _YCBCR):
        return samples[:, :, :3], samples[:, :, 3:]
    return samples[:, :, 0], samples[:, :, 1:]


def full_scale(dtype: np.dtype[Any]) -> int:
    """Value of white: the largest integer, or 1 of floating point."""
    if dtype.kind == "f":
        return 1
    return int(np.iinfo(dtype).max)


def _check_segments(page: TiffPage) -> None:
    """Check strips or tiles: missing ones would be black, those of a small file gigabytes."""
    file = page.parent.filehandle
    number = math.prod(page.chunked)
    px = math.prod(page.chunks)
    segments = [*zip(page.dataoffsets, page.databytecounts, strict=False)][:number]
    if len(segments) != number or not all(
        0 < offset < offset + length <= file.size for offset, length in segments
    ):
        raise ValueError("a strip or tile is missing or cut short")
    packed = sum(length for _, length in segments)
    if (
        number * px > 2 * page.size + _LEAST_PX
        or packed > file.size + 2 * page.nbytes
        or page.jpegheader
    ):
        raise ValueError("strips or tiles are larger than the image")
    if page.compression != _JPEG:
        return
    for offset, length in segments:
        file.seek(offset)
        jpeg = file.read(length)
        if not jpeg_complete(jpeg) or math.prod(jpeg_size(jpeg)) > 2 * px + _LEAST_PX:
            raise ValueError("a strip or tile is damaged")
