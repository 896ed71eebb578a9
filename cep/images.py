"""Photographs in and out: PNG, TIFF, JPEG and RAW files as linear light, 0..1; 16 bit stays 16 bit."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.outputs import new_file
from motdiff.simulate import to_display, to_linear

__all__ = [
    "MIN_SIDE_PX",
    "PHOTO_SUFFIXES",
    "PICTURE_SUFFIXES",
    "Photo",
    "check_image_name",
    "parse_gamma",
    "read_image",
    "read_photo",
    "write_image",
]

FloatArray = NDArray[np.float64]

MIN_SIDE_PX = 16
"""Smallest side of a photo, px: below it there is no blur to speak of."""

PICTURE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
"""What :func:`write_image` writes."""

_RAW = {".3fr", ".arw", ".cr2", ".cr3", ".dng", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".srw"}
PHOTO_SUFFIXES = (*PICTURE_SUFFIXES, *sorted(_RAW))
"""What :func:`read_photo` reads."""

_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


@dataclass(frozen=True)
class Photo:
    """A photograph in memory.

    Attributes
    ----------
    pixels : (H, W) or (H, W, 3) float
        Linear light, 0..1, colours in the order red, green, blue.
    bits : int
        Bits per sample of the file: 8, 16, or 32 for floating point.
    warnings : tuple of str
        What was lost on the way, one sentence each.
    """

    pixels: FloatArray
    bits: int
    warnings: tuple[str, ...] = ()


def read_image(path: Path | str, *, gamma: str | float = "srgb") -> FloatArray:
    """Read a photo's pixels: :func:`read_photo` without the particulars."""
    return read_photo(path, gamma=gamma).pixels


def read_photo(path: Path | str, *, gamma: str | float = "srgb", min_side_px: int = MIN_SIDE_PX) -> Photo:
    """Read a photo as linear light.

    Parameters
    ----------
    path : path of a PNG, TIFF, JPEG, or (with the extra ``raw``) RAW file
    gamma : {"srgb", "linear"} or float
        How the file's numbers encode light: the sRGB curve, not at all, or ``value ** gamma``. Floating-point TIFF and
        RAW files hold linear light already, whatever is asked.
    min_side_px : int
        Smaller images are refused.

    Raises
    ------
    ValueError
        If the file is empty, cut short, not an image, too small, or holds NaN; the line names it.
    OSError
        If the file cannot be read.
    """
    source = Path(path)
    exponent = _exponent(gamma)
    if source.is_dir():
        raise ValueError(f"{source}: is a folder, one image file is needed")
    if source.suffix.lower() in _RAW:
        return _read_raw(source)
    data = source.read_bytes()
    _check_complete(source, data)
    decoded = _decode(source, data)
    warnings: tuple[str, ...] = ()
    if decoded.ndim == 3 and decoded.shape[2] == 4:
        alpha = decoded[:, :, 3]
        if alpha.min() < (1 if decoded.dtype.kind == "f" else np.iinfo(decoded.dtype).max):
            warnings = (f"{source}: the transparency (alpha channel) was dropped",)
        decoded = decoded[:, :, :3]
    if decoded.ndim == 3:
        decoded = decoded[:, :, 0] if decoded.shape[2] == 1 else decoded[:, :, ::-1]
    if min(decoded.shape[:2]) < min_side_px:
        height, width = decoded.shape[:2]
        raise ValueError(f"{source}: {width} x {height} px is too small, at least {min_side_px} px a side is needed")
    if decoded.dtype.kind == "f":
        return Photo(_checked_float(source, decoded), 32, warnings)
    if decoded.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{source}: has {decoded.dtype} samples, wanted 8 or 16 bit or floating point")
    full_scale = int(np.iinfo(decoded.dtype).max)
    # a table of all 2^bits values: forty megapixels cost one look-up each
    table = to_linear(np.arange(full_scale + 1) / full_scale, gamma=exponent)
    return Photo(np.ascontiguousarray(table[decoded]), 8 * decoded.dtype.itemsize, warnings)


def check_image_name(path: Path | str) -> None:
    """Check, before any work is done, that :func:`write_image` writes such files; raises ValueError as it does."""
    suffix = Path(path).suffix.lower()
    if suffix not in PICTURE_SUFFIXES:
        raise ValueError(f"{path}: images are written as .png, .tif or .jpg, not {suffix or 'without a suffix'}")


def write_image(path: Path | str, image: ArrayLike, *, bits: int = 8, gamma: str | float = "srgb") -> None:
    """Write linear light as PNG, TIFF or JPEG, whole or not at all; values outside 0..1 are clipped.

    Parameters
    ----------
    path : path ending in .png, .tif, .tiff, .jpg or .jpeg
    image : (H, W) or (H, W, 3) array_like, linear light 0..1
    bits : {8, 16, 32}
        Bits per sample: PNG takes 8 or 16, TIFF also 32 (floating point, linear), JPEG always has 8.
    gamma : {"srgb", "linear"} or float
        As :func:`read_photo`, which reads the same light back.

    Raises
    ------
    ValueError
        If the name has another suffix, or the samples are not finite.
    OSError
        If the folder cannot be written to.
    """
    import cv2

    target = Path(path)
    check_image_name(target)
    suffix, exponent = target.suffix.lower(), _exponent(gamma)
    if bits not in (8, 16, 32):
        raise ValueError(f"bits: must be 8, 16 or 32, got {bits}")
    pixels = np.asarray(image, dtype=np.float64)
    if pixels.ndim not in (2, 3) or not np.isfinite(pixels).all():
        raise ValueError(f"image: must be finite, (H, W) or (H, W, 3), got shape {pixels.shape}")
    pixels = np.clip(pixels, 0, 1)
    if suffix in (".jpg", ".jpeg"):
        bits = 8
    elif suffix == ".png":
        bits = min(bits, 16)
    samples: NDArray[Any]
    if bits == 32:
        samples = pixels.astype(np.float32)
    else:
        full_scale = 2**bits - 1
        samples = np.rint(to_display(pixels, gamma=exponent) * full_scale).astype(np.uint8 if bits == 8 else np.uint16)
    if samples.ndim == 3:
        samples = np.ascontiguousarray(samples[:, :, ::-1])
    options = [cv2.IMWRITE_JPEG_QUALITY, 95] if bits == 8 and suffix.startswith(".jp") else []
    encoded_well, encoded = cv2.imencode(suffix, samples, options)
    if not encoded_well:
        raise ValueError(f"{target}: an image of shape {samples.shape} cannot be written as {suffix}")
    with new_file(target) as temporary:
        temporary.write_bytes(encoded.tobytes())


def parse_gamma(text: str | float) -> str | float:
    """Check a response curve: ``"srgb"``, ``"linear"``, or a number in 1..4 (also as text, from a command line).

    Examples
    --------
    >>> parse_gamma("2.2")
    2.2
    """
    if text in ("srgb", "linear"):
        return text
    try:
        exponent = float(text)
    except ValueError:
        exponent = float("nan")
    if not 1 <= exponent <= 4:
        raise ValueError(f'gamma: must be "srgb", "linear" or a number from 1 to 4, got {text!r}')
    return exponent


def _exponent(gamma: str | float) -> float | None:
    """Exponent as :func:`motdiff.simulate.to_linear` takes it: None is the sRGB curve."""
    checked = parse_gamma(gamma)
    if isinstance(checked, str):
        return None if checked == "srgb" else 1.0
    return checked


def _decode(source: Path, data: bytes) -> NDArray[Any]:
    import cv2

    # A JPEG may say how the camera was held; OpenCV turns it upright unless told "unchanged".
    turned = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
    flags = turned if data.startswith(_JPEG) else cv2.IMREAD_UNCHANGED
    with _silent_opencv(cv2):
        try:
            decoded = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error:
            decoded = None
    if decoded is None:
        raise ValueError(f"{source}: the image is damaged or cut short and cannot be decoded")
    return np.asarray(decoded)


@contextmanager
def _silent_opencv(cv2: Any) -> Iterator[None]:
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _checked_float(source: Path, decoded: NDArray[Any]) -> FloatArray:
    pixels = decoded.astype(np.float64)
    if not np.isfinite(pixels).all():
        raise ValueError(f"{source}: {int((~np.isfinite(pixels)).sum())} samples are NaN or infinite")
    if pixels.min() < -1e-6 or pixels.max() > 1 + 1e-6:
        raise ValueError(f"{source}: samples run from {pixels.min():.4g} to {pixels.max():.4g}, scale them to 0..1")
    return np.ascontiguousarray(np.clip(pixels, 0, 1))


def _check_complete(source: Path, data: bytes) -> None:
    """Refuse what decoders half-read: they fill the missing part of a cut file with grey and call it a success."""
    if not data:
        raise ValueError(f"{source}: the file is empty")
    if data.startswith(_PNG):
        complete = _png_complete(data)
    elif data.startswith(_JPEG):
        complete = _jpeg_complete(data)
    elif data.startswith(_TIFF):
        complete = True  # libtiff refuses cut files by itself
    else:
        raise ValueError(f"{source}: not a PNG, JPEG or TIFF image (it begins with {data[:12]!r})")
    if not complete:
        raise ValueError(f"{source}: the image is damaged or cut short after {len(data)} bytes")


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
    """Walk the segments to the first scan, then look for the end marker: a thumbnail's own end does not count."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        at += 2 + length
        if marker == 0xDA:
            return data.find(b"\xff\xd9", at) >= 0
    return False


def _read_raw(source: Path) -> Photo:
    source.stat()  # a missing file is told before a missing extra
    try:
        import rawpy
    except ImportError:
        raise ValueError(f"{source}: RAW files need an extra: pip install coded-exposure[raw]") from None
    try:
        with rawpy.imread(str(source)) as raw:
            linear = raw.postprocess(gamma=(1, 1), no_auto_bright=True, output_bps=16, use_camera_wb=True)
    except rawpy.LibRawError as error:
        raise ValueError(f"{source}: not a RAW file that LibRaw can read ({error})") from None
    return Photo(np.asarray(linear, dtype=np.float64) / 65535, 16)
