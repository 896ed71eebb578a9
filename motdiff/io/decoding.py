"""Decoding of image files to samples, upright: by OpenCV, and TIFF by its tags; decoders' messages are captured."""

from __future__ import annotations

import lzma
import math
import os
import struct
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motdiff.io.inputs import one_line
from motdiff.io.photo_files import MOST_PX, is_animated, orientation
from motdiff.io.tiff_files import TIFF, Tag, TiffPage, photo_page

__all__ = ["decode", "decoder_output"]

Samples = NDArray[Any]

_STDERR = 2
_TURN = threading.Lock()  # there is one standard error for all threads

_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PALETTE, _YCBCR = 0, 1, 2, 3, 6
_OTHER_COLOURS = {
    5: "CMYK", 8: "CIELab", 9: "ICCLab", 10: "ITULab", 32803: "a colour filter mosaic", 32844: "LogL", 32845: "LogLuv",
    34892: "linear RAW",
}  # fmt: skip
_PLAIN, _LZW, _JPEG, _PACKBITS, _LZMA = 1, 5, 7, 32773, 34925
_DEFLATE = (8, 32946)
_FAX_AND_JPEG = (2, 3, 4, 6, _JPEG)  # what libtiff alone decodes
_OTHER_COMPRESSIONS = {34712: "JPEG 2000", 34887: "LERC", 50000: "ZSTD", 50001: "WebP", 50002: "JPEG XL"}
_HORIZONTAL, _FLOATING_POINT = 2, 3  # predictors
_LZMA_BYTES = 2**28  # memory of its decoder
_MOST_CHANNELS = 8
_KINDS = {1: "u", 2: "i", 3: "f", 4: "u"}  # sample formats; the last is undefined
_ALPHA = (1, 2)  # extra samples: associated, unassociated


def decode(data: bytes, name: object) -> tuple[Samples, tuple[str, ...]]:
    """Decode an image of :func:`motdiff.io.photo_files.photo_bytes`, upright as the camera was held.

    Of a TIFF file with several pages the largest is decoded, the first of equals; previews and masks do not count.

    Parameters
    ----------
    data : bytes
    name : path
        For errors and warnings.

    Returns
    -------
    samples : (H, W) or (H, W, 3) array of uint8, uint16 or floating point
        Red green blue; 0 is black.
    warnings : tuple of str
        Losses and assumptions, one sentence each.

    Raises
    ------
    ValueError
        If the image cannot be decoded, or its samples or colours are none that are read; the line names it.
    """
    if not data.startswith(TIFF):
        samples, warnings = _decoded_by_opencv(data, name)
        if is_animated(data):
            warnings += (f"{name}: is animated, its first picture was read",)
        return _turned(samples, orientation(data)), warnings
    try:
        page, number, pages = photo_page(data)
        _check_page(page, name)
        samples, warnings = _decoded_page(data, page, name)
    except (struct.error, zlib.error, lzma.LZMAError, IndexError):
        raise _damaged(name) from None
    if pages > 1:
        which = "the first" if number == 1 else f"the largest, number {number},"
        warnings += (f"{name}: holds {pages} pages, {which} was read; save the others as files of their own",)
    return _turned(samples, page.orientation), warnings


def _turned(samples: Samples, orientation: int) -> Samples:
    """Turn upright by an orientation of EXIF, 1 to 8."""
    if orientation >= 5:
        samples = samples.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        samples = samples[:, ::-1]
    return samples[::-1] if orientation in (3, 4, 7, 8) else samples


def _damaged(name: object) -> ValueError:
    return ValueError(f"{name}: the image is damaged or cut short and cannot be decoded")


# -- OpenCV -----------------------------------------------------------------------------------------------------------


def _decoded_by_opencv(data: bytes, name: object) -> tuple[Samples, tuple[str, ...]]:
    with decoder_output() as printed:
        samples = _opencv_samples(data)
    if samples is None:
        raise _damaged(name)
    warnings = tuple(
        f"{name}: the image is damaged in places ({one_line(line)})"
        for line in printed
        if line.startswith("Corrupt JPEG data")
    )
    if samples.ndim == 2:
        return samples, warnings
    colours, others = samples[:, :, :3][:, :, ::-1], samples[:, :, 3:]
    return (colours if colours.shape[2] == 3 else colours[:, :, 0]), warnings + _dropped(others, name)


def _opencv_samples(data: bytes) -> Samples | None:
    """Return samples as OpenCV has them, blue green red, not turned upright; None if they cannot be decoded."""
    import cv2

    try:
        samples = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    return None if samples is None else np.asarray(samples)


def _dropped(others: Samples, name: object, *, alpha: bool = True) -> tuple[str, ...]:
    """Warnings of channels (H, W, C) beside the colours, which are left out."""
    full = 1 if others.dtype.kind == "f" else np.iinfo(others.dtype).max
    if not others.size or (alpha and others.min() >= full):
        return ()
    what = "the transparency (alpha channel) was dropped" if alpha else "its channels beside the colours were dropped"
    return (f"{name}: {what}",)


# -- TIFF -------------------------------------------------------------------------------------------------------------


def _check_page(page: TiffPage, name: object) -> None:
    """Refuse what is not read."""
    photometric, samples = _photometric(page), page.value(Tag.SAMPLES, 1)
    colours = _OTHER_COLOURS.get(photometric)
    if colours is not None or photometric not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PALETTE, _YCBCR):
        raise ValueError(f"{name}: its colours are {colours or f'of kind {photometric}'}, save it as RGB or grey")
    compression = page.value(Tag.COMPRESSION, _PLAIN)
    if compression not in (_PLAIN, _LZW, *_DEFLATE, _PACKBITS, _LZMA, *_FAX_AND_JPEG):
        method = _OTHER_COMPRESSIONS.get(compression, f"method {compression}")
        raise ValueError(f"{name}: is compressed by {method}, save it uncompressed, or by LZW or Deflate")
    if page.value(Tag.DEPTH, 1) > 1:
        raise ValueError(f"{name}: is a volume of {page.value(Tag.DEPTH, 1)} layers, save one of them as a photo")
    if page.value(Tag.FILL_ORDER, 1) == 2 and compression not in _FAX_AND_JPEG:
        raise ValueError(f"{name}: its bits are stored in reverse order, save it with FillOrder 1")
    if samples > _MOST_CHANNELS:
        raise ValueError(f"{name}: has {samples} channels, save those of red, green and blue, or one of them")
    alpha = sum(kind in _ALPHA for kind in page.values.get(Tag.EXTRA_SAMPLES, ()))
    if photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO) and samples - alpha > 1:
        raise ValueError(f"{name}: has {samples - alpha} channels of no colour, save one of them, or three as RGB")
    if photometric in (_RGB, _YCBCR) and samples < 3:
        raise ValueError(f"{name}: has {samples} channels for red, green and blue, save it as RGB or grey")
    bits, formats = page.values.get(Tag.BITS, (1,)), page.values.get(Tag.SAMPLE_FORMAT, (1,))
    if len({*bits}) > 1 or len({*formats}) > 1:
        raise ValueError(f"{name}: its channels differ in kind, save it with 8 or 16 bits in each")
    kind = _KINDS.get(formats[0], "")
    if not (1 <= bits[0] <= 16 if kind == "u" else kind == "f" and bits[0] in (16, 32, 64)):
        what = {"u": "integers", "i": "integers with a sign", "f": "floating point"}.get(kind, "complex numbers")
        raise ValueError(f"{name}: has {bits[0]}-bit {what}, save it as 8 or 16 bit, or as floating point of 32")


def _photometric(page: TiffPage) -> int:
    return page.value(Tag.PHOTOMETRIC, _RGB if page.value(Tag.SAMPLES, 1) >= 3 else _BLACK_IS_ZERO)


def _decoded_page(data: bytes, page: TiffPage, name: object) -> tuple[Samples, tuple[str, ...]]:
    """Return the samples of a page that was checked, red green blue, not turned upright, and warnings."""
    photometric = _photometric(page)
    if photometric in (_PALETTE, _YCBCR) or page.value(Tag.COMPRESSION, _PLAIN) in _FAX_AND_JPEG:
        # libtiff would turn some pages itself, and multiply colours by an unassociated transparency
        return _decoded_by_opencv(page.as_first(data, {Tag.ORIENTATION: 1, Tag.EXTRA_SAMPLES: 1}), name)
    samples = _stored(data, page, name)
    count = 3 if photometric == _RGB else 1
    kinds = page.values.get(Tag.EXTRA_SAMPLES, ())
    warnings = _dropped(samples[:, :, count:], name, alpha=all(kind in _ALPHA for kind in kinds[:1]))
    if photometric == _WHITE_IS_ZERO:
        samples = (1 if samples.dtype.kind == "f" else np.iinfo(samples.dtype).max) - samples
    return (samples[:, :, :3] if count == 3 else samples[:, :, 0]), warnings


def _stored(data: bytes, page: TiffPage, name: object) -> Samples:
    """Read the samples (H, W, S) of a page of whole bytes, from its strips or tiles."""
    width, height = page.size
    channels, separate = page.value(Tag.SAMPLES, 1), page.value(Tag.PLANES, 1) == 2
    planes, together = (channels, 1) if separate else (1, channels)
    if Tag.TILE_OFFSETS in page.values:
        columns, rows = page.value(Tag.TILE_WIDTH, 0), page.value(Tag.TILE_LENGTH, 0)
        offsets, lengths = page.values[Tag.TILE_OFFSETS], page.values.get(Tag.TILE_BYTES, ())
    else:
        columns, rows = width, min(page.value(Tag.ROWS_PER_STRIP, height), height)
        offsets, lengths = page.values.get(Tag.STRIP_OFFSETS, ()), page.values.get(Tag.STRIP_BYTES, ())
    if not 0 < columns * rows <= MOST_PX:
        raise _damaged(name)
    across, down = math.ceil(width / columns), math.ceil(height / rows)
    bits = page.value(Tag.BITS, 1)
    kind = np.dtype(f"{_KINDS[page.value(Tag.SAMPLE_FORMAT, 1)]}{2 ** math.ceil(math.log2(max(bits, 8) / 8))}")
    samples = np.empty((height, width, channels), kind)
    for part in range(planes * down * across):
        plane, row, column = part // (down * across), part // across % down * rows, part % across * columns
        shape = (rows if Tag.TILE_OFFSETS in page.values else min(rows, height - row), columns, together)
        size = shape[0] * math.ceil(columns * together * bits / 8)
        at = offsets[part]
        packed = memoryview(data)[at : at + (lengths[part] if part < len(lengths) else size)]
        unpacked = _unpacked(packed, page.value(Tag.COMPRESSION, _PLAIN), shape[0], size)
        if not at or len(unpacked) < size:
            raise _damaged(name)
        values = _restored(np.frombuffer(unpacked, np.uint8, size), shape, kind, page)
        target = samples[row : row + rows, column : column + columns, plane : plane + together]
        target[:] = values[: target.shape[0], : target.shape[1]]
    return samples


def _unpacked(packed: memoryview, compression: int, rows: int, size: int) -> bytes | memoryview:
    """Decompress a strip or tile to at most ``size`` bytes; fewer if it is damaged."""
    if compression == _PLAIN:
        return packed
    if compression in _DEFLATE:
        return zlib.decompressobj().decompress(packed, size)
    if compression == _LZMA:
        return lzma.LZMADecompressor(memlimit=_LZMA_BYTES).decompress(packed, size)
    fields = {
        Tag.WIDTH: size // rows, Tag.LENGTH: rows, Tag.BITS: 8, Tag.COMPRESSION: compression, Tag.PHOTOMETRIC: 1,
        Tag.STRIP_OFFSETS: 0, Tag.SAMPLES: 1, Tag.ROWS_PER_STRIP: rows, Tag.STRIP_BYTES: len(packed),
    }  # fmt: skip
    fields[Tag.STRIP_OFFSETS] = 8 + 2 + 12 * len(fields) + 4
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in fields.items())
    header = b"II*\0" + struct.pack("<IH", 8, len(fields))
    with decoder_output():
        samples = _opencv_samples(header + entries + bytes(4) + packed)
    return b"" if samples is None else samples.tobytes()


def _scaled_integers(rows: NDArray[np.uint8], bits: int, count: int) -> NDArray[np.uint16]:
    """Integers (R, count) of 1 to 15 bits that follow each other in rows of bytes, scaled to 8 or 16 bits."""
    planes = np.unpackbits(rows, axis=1, count=count * bits).reshape(len(rows), count, bits)
    integers = np.zeros((len(rows), count), np.uint32)
    for bit in range(bits):
        integers = 2 * integers + planes[:, :, bit]
    full, largest = (255 if bits < 8 else 65535), 2**bits - 1
    return np.asarray((integers * full + largest // 2) // largest, dtype=np.uint16)


def _restored(stored: NDArray[np.uint8], shape: tuple[int, int, int], kind: np.dtype[Any], page: TiffPage) -> Samples:
    """Return samples (rows, columns, channels) of a strip or tile: its predictor and byte order are undone."""
    compressed = page.value(Tag.COMPRESSION, _PLAIN) in (_LZW, *_DEFLATE, _LZMA)
    predictor = page.value(Tag.PREDICTOR, 1) if compressed else 1
    rows, columns, channels = shape
    bits = page.value(Tag.BITS, 1)
    if bits % 8:
        return _scaled_integers(stored.reshape(rows, -1), bits, columns * channels).astype(kind).reshape(shape)
    if predictor == _FLOATING_POINT:  # the bytes of a row, sorted by significance, as differences
        differences = stored.reshape(rows, -1, channels)
        by_byte = np.cumsum(differences, axis=1, dtype=np.uint8).reshape(rows, kind.itemsize, columns * channels)
        return np.ascontiguousarray(by_byte.swapaxes(1, 2)).view(kind.newbyteorder(">")).reshape(shape)
    if predictor == _HORIZONTAL:
        whole = np.dtype(f"u{kind.itemsize}")
        differences = stored.view(whole.newbyteorder(page.order)).reshape(shape)
        return np.cumsum(differences, axis=1, dtype=whole).view(kind)
    return stored.view(kind.newbyteorder(page.order)).reshape(shape)


@contextmanager
def decoder_output() -> Iterator[list[str]]:
    """Capture standard error of C libraries: OpenCV and LibRaw do not pass on the messages of their decoders.

    Yields
    ------
    list of str, which afterwards holds the lines that were printed, as far as a pipe takes them
    """
    lines: list[str] = []
    with _TURN:
        try:
            kept = os.dup(_STDERR)
        except OSError:  # a service may run without one
            yield lines
            return
        reading, writing = os.pipe()
        for end in (reading, writing):
            os.set_blocking(end, False)
        os.dup2(writing, _STDERR)
        os.close(writing)
        try:
            yield lines
        finally:
            os.dup2(kept, _STDERR)
            os.close(kept)
            with os.fdopen(reading, "rb") as stream:
                lines += (stream.read() or b"").decode(errors="replace").splitlines()
