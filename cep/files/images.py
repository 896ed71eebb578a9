"""Photographs in and out, as linear light 0..1; 16 bit stays 16 bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.files.raw_files import RAW_SUFFIXES, read_raw
from cep.files.white_level import WhiteLevel, white_level
from motdiff.files.decoding import decode
from motdiff.files.mat_files import read_mat
from motdiff.files.outputs import new_file
from motdiff.files.photo_files import check_px, photo_bytes
from motdiff.photo_values import to_display, to_linear
from motdiff.types import FloatArray

# photos of more pixels are held in single precision: half the memory, and finer than any sensor
SINGLE_PRECISION_PX = 2**24
MIN_SIDE_PX = 16  # of a photo: below it there is no blur to speak of
PICTURE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")  # that write_image writes
_JPEG_QUALITY = 95  # OpenCV's default
# photos of a folder: what read_photo reads, but for .mat files, which hold other things as well
PHOTO_SUFFIXES = (*PICTURE_SUFFIXES, ".webp", *RAW_SUFFIXES)


@dataclass(frozen=True)
class Photo:
    """A photograph in memory.

    Attributes
    ----------
    pixels : (H, W) or (H, W, 3) float64, or float32 of more than SINGLE_PRECISION_PX pixels
        Linear light, 0..1, colours in the order red, green, blue.
    bits : int
        Bits per sample of the file: 8, 16, or 32 for floating point.
    warnings : tuple of str
        Losses and assumptions of the decoding, one sentence each.
    """

    pixels: FloatArray
    bits: int
    warnings: tuple[str, ...] = ()


def read_image(
    path: Path | str, *, gamma: str | float = "srgb", variable: str = "y"
) -> FloatArray:
    """Read a photo as linear light, 0..1; parameters and errors are those of :func:`read_photo`.

    Returns
    -------
    (H, W) or (H, W, 3) float64

    Examples
    --------
    ::

        photo = read_image("blurred.jpg")
        recorded_linearly = read_image("frame.tif", gamma="linear")
    """
    return read_photo(path, gamma=gamma, variable=variable).pixels


def read_photo(
    path: Path | str,
    *,
    gamma: str | float = "srgb",
    min_side_px: int = MIN_SIDE_PX,
    variable: str = "y",
) -> Photo:
    """Read a photo as linear light.

    Parameters
    ----------
    path : path of a PNG, TIFF, JPEG, WebP, .mat or (with the package ``rawpy``) RAW file
    gamma : {"srgb", "linear"} or float
        How the file's numbers encode light: the sRGB curve, not at all, or ``value ** gamma``.
        Floating-point TIFF, RAW and .mat files always hold linear light.
    min_side_px : int
        Smaller images are refused.
    variable : str
        Of a .mat file: the variable that is the photo. In Levin's files ``y`` is blurred and ``x``
        sharp.

    Raises
    ------
    ValueError
        If the file is empty, cut short, not an image, too small, has more than
        :data:`motdiff.files.photo_files.MOST_PX` pixels, or holds NaN; the line names it.
    OSError
        If the file cannot be read.
    """
    decoded, linear, warnings = _decoded(path, gamma, min_side_px, variable)
    return Photo(linear(decoded), _bits(decoded), warnings)


def read_code_values(
    path: Path | str, *, min_side_px: int = MIN_SIDE_PX
) -> tuple[NDArray[Any], tuple[str, ...]]:
    """Read the code values of a PNG, TIFF, JPEG or WebP file as they are stored, with warnings.

    They are (H, W) or (H, W, 3), in 8 or 16 bits.
    """
    source = Path(path)
    codes, warnings = decode(photo_bytes(source), source)
    _check_side(source, codes, min_side_px)
    if codes.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"{source}: holds floating-point numbers, and no code values; give files of 8 or 16"
            " bits"
        )
    return codes, warnings


def read_detail(
    path: Path | str, *, side_px: int, preview_px: int
) -> tuple[Photo, FloatArray, tuple[int, int]]:
    """Read the part of a photo with most detail, and all of it small.

    All of it in floating point would take several times the memory of its samples.

    Parameters
    ----------
    path
        As of :func:`read_photo`.
    side_px : int
        Longest side of the part.
    preview_px : int
        Longest side of the small version.

    Returns
    -------
    Photo, (h, w) or (h, w, 3) float ndarray, (int, int)
        The part, the small version, and height and width of the photo.
    """
    import cv2

    decoded, linear, warnings = _decoded(path, "srgb", MIN_SIDE_PX, "y")
    height, width = decoded.shape[:2]
    factor = max(max(height, width) / preview_px, 1.0)

    def shrunk(length: int) -> int:
        return max(1, int(np.rint(length / factor)))

    small_codes = decoded
    if factor > 1:  # of the code values: of light, a full copy in floating point would be made
        size = (shrunk(width), shrunk(height))
        small_codes = cv2.resize(decoded, size, interpolation=cv2.INTER_AREA)  # means: no aliasing
    small = linear(small_codes)
    rows = min(side_px, height)
    columns = min(side_px, width)
    grey = np.atleast_3d(small).mean(axis=2)
    detail = np.abs(np.diff(grey, axis=0, prepend=grey[:1])) + np.abs(
        np.diff(grey, axis=1, prepend=grey[:, :1])
    )
    # the sum over the window to the right of and below each pixel
    window = (shrunk(columns), shrunk(rows))
    summed = cv2.boxFilter(
        detail, cv2.CV_64F, window, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT
    )
    row, column = (
        int(place * factor) for place in np.unravel_index(int(summed.argmax()), summed.shape)
    )
    row = min(row, height - rows)
    column = min(column, width - columns)
    crop = linear(decoded[row : row + rows, column : column + columns])
    return Photo(crop, _bits(decoded), warnings), small, (height, width)


def _decoded(
    path: Path | str, gamma: str | float, min_side_px: int, variable: str
) -> tuple[NDArray[Any], Callable[[NDArray[Any]], FloatArray], tuple[str, ...]]:
    """Decode a photo: its samples, what makes linear light of them, and warnings."""
    source = Path(path)
    exponent = _exponent(gamma)
    suffix = source.suffix.lower()
    warnings: tuple[str, ...] = ()
    if suffix in RAW_SUFFIXES:
        decoded = read_raw(source)
        exponent = 1.0
    elif suffix == ".mat":
        decoded = _read_mat(source, variable)
        exponent = 1.0
        warnings = (
            f'{source}: its variable "{variable}" was taken as linear light, as it is stored',
        )
    else:
        decoded, warnings = decode(photo_bytes(source), source)
    _check_side(source, decoded, min_side_px)
    if decoded.dtype.kind == "f":
        return _checked_float(source, decoded), lambda samples: samples, warnings
    if decoded.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"{source}: has {decoded.dtype} samples, wanted 8 or 16 bit or floating point"
        )
    white = WhiteLevel(int(np.iinfo(decoded.dtype).max))
    if suffix not in RAW_SUFFIXES:  # LibRaw scales to 16 bits itself
        white = white_level(decoded)
    if white.assumption:
        warnings += (f"{source}: {white.assumption}",)
    # a table of all 2^bits values: forty megapixels cost one look-up each
    values = np.minimum(np.arange(np.iinfo(decoded.dtype).max + 1) / white.code, 1.0)
    table: FloatArray = to_linear(values, gamma=exponent).astype(_precision(decoded))
    return decoded, lambda samples: np.ascontiguousarray(table[samples]), warnings


def _check_side(source: Path, decoded: NDArray[Any], min_side_px: int) -> None:
    height, width = decoded.shape[:2]
    if min(height, width) < min_side_px:
        raise ValueError(
            f"{source}: {width} x {height} px is too small, at least {min_side_px} px a side is"
            " needed"
        )


def _bits(decoded: NDArray[Any]) -> int:
    return 32 if decoded.dtype.kind == "f" else 8 * decoded.dtype.itemsize


def check_image_name(path: Path | str) -> None:
    """Check, before any work is done, that :func:`write_image` writes such files."""
    suffix = Path(path).suffix.lower()
    if suffix not in PICTURE_SUFFIXES:
        raise ValueError(
            f"{path}: images are written as .png, .tif or .jpg, not {suffix or 'without a suffix'}"
        )


def write_image(
    path: Path | str, image: ArrayLike, *, bits: int = 8, gamma: str | float = "srgb"
) -> None:
    """Write linear light as PNG, TIFF or JPEG, whole or not at all; it is clipped to 0..1.

    Parameters
    ----------
    path : path ending in .png, .tif, .tiff, .jpg or .jpeg
    image, bits, gamma
        As of :func:`encode_image`.

    Raises
    ------
    ValueError
        If the name has another suffix, or the samples are not finite.
    OSError
        If the folder cannot be written to.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_image(Path(folder) / "grey.png", np.full((16, 20), 0.5), bits=16)
    ...     print(f"{read_image(Path(folder) / 'grey.png').mean():.4f}")
    0.5000
    """
    target = Path(path)
    check_image_name(target)
    encoded = encode_image(image, target.suffix.lower(), bits=bits, gamma=gamma)
    with new_file(target) as temporary:
        temporary.write_bytes(encoded)


def encode_image(
    image: ArrayLike, suffix: str, *, bits: int = 8, gamma: str | float = "srgb"
) -> bytes:
    """Encode linear light as a PNG, TIFF or JPEG file; values outside 0..1 are clipped.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array_like, linear light 0..1
    suffix : {".png", ".tif", ".tiff", ".jpg", ".jpeg"}
    bits : {8, 16, 32}
        Bits per sample: PNG takes 8 or 16, TIFF also 32 (floating point, linear), JPEG always has
        8.
    gamma : {"srgb", "linear"} or float
        As :func:`read_photo`, which reads the same light back.

    Raises
    ------
    ValueError
        If the samples are not finite, or the array is no image.
    """
    import cv2

    exponent = _exponent(gamma)
    if bits not in (8, 16, 32):
        raise ValueError(f"bits: must be 8, 16 or 32, got {bits}")
    pixels = np.asarray(image, dtype=np.float64)
    if pixels.ndim not in (2, 3) or not np.isfinite(pixels).all():
        raise ValueError(f"image: must be finite, (H, W) or (H, W, 3), got shape {pixels.shape}")
    pixels = np.clip(pixels, 0, 1)
    if suffix in (".jpg", ".jpeg"):
        bits = 8  # all that baseline JPEG has
    elif suffix == ".png":
        bits = min(bits, 16)  # a PNG has no floating point
    samples: NDArray[Any]
    if bits == 32:
        samples = pixels.astype(np.float32)
    elif bits == 8 and exponent is None:
        samples = _srgb_bytes()[(pixels * 0xFFFF + 0.5).astype(np.uint16)]
    else:
        full_scale = 2**bits - 1
        codes = np.rint(to_display(pixels, gamma=exponent) * full_scale)
        samples = codes.astype({8: np.uint8, 16: np.uint16}[bits])
    if samples.ndim == 3:
        samples = np.ascontiguousarray(samples[:, :, ::-1])  # OpenCV's order is blue, green, red
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if suffix.startswith(".jp") else []
    encoded_well, encoded = cv2.imencode(suffix, samples, options)
    if not encoded_well:
        raise ValueError(f"an image of shape {samples.shape} cannot be written as {suffix}")
    return encoded.tobytes()


@cache
def _srgb_bytes() -> NDArray[np.uint8]:
    """8-bit sRGB of linear light in 16 bits: a table is quicker than the power.

    Near black, where sRGB is finest, 20 of its steps are one of sRGB's.
    """
    return np.rint(255 * to_display(np.arange(0x10000) / 0xFFFF)).astype(np.uint8)


def parse_gamma(text: str | float) -> str | float:
    """Check a response curve: ``"srgb"``, ``"linear"``, or a number in 1..4, also as text.

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
    """Exponent as :func:`motdiff.photo_values.to_linear` takes it: None is the sRGB curve."""
    checked = parse_gamma(gamma)
    if checked == "srgb":
        return None
    if checked == "linear":
        return 1.0
    return float(checked)


def _precision(decoded: NDArray[Any]) -> type:
    return np.float32 if decoded.shape[0] * decoded.shape[1] > SINGLE_PRECISION_PX else np.float64


def _checked_float(source: Path, decoded: NDArray[Any]) -> FloatArray:
    with np.errstate(invalid="ignore"):
        low = float(decoded.min())  # either is NaN where a sample is
        high = float(decoded.max())
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ValueError(
            f"{source}: {int((~np.isfinite(decoded)).sum())} samples are NaN or infinite"
        )
    if low < -1e-6 or high > 1 + 1e-6:  # rounding to single precision passes
        raise ValueError(f"{source}: samples run from {low:.4g} to {high:.4g}, scale them to 0..1")
    pixels: FloatArray = np.array(decoded, dtype=_precision(decoded), order="C")
    return np.clip(pixels, 0, 1, out=pixels)


def _read_mat(source: Path, variable: str) -> NDArray[Any]:
    samples = read_mat(source, [variable])[variable]
    if samples.ndim not in (2, 3) or samples.shape[2:] not in ((), (3,)) or not samples.size:
        raise ValueError(
            f"{source}: its variable {variable} has the shape {samples.shape}, wanted (H, W) or"
            " (H, W, 3)"
        )
    check_px(samples.shape[1], samples.shape[0], source)
    return samples
