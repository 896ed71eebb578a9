"""Decoding of image files to upright samples: TIFF by tifffile, others by OpenCV."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motdiff.files.inputs import one_line
from motdiff.files.photo_files import is_animated, orientation
from motdiff.files.tiff_files import (
    TIFF,
    channels,
    full_scale,
    photo_page,
    refusal,
    tiff_orientation,
)

Samples = NDArray[Any]

_STDERR = 2
_TURN = threading.Lock()  # there is one standard error for all threads


def decode(data: bytes, name: object) -> tuple[Samples, tuple[str, ...]]:
    """Decode an image, read by ``photo_files.photo_bytes``, upright as the camera was held.

    Of a TIFF file with several pages the largest is decoded, the first of equals; previews and
    masks do not count.

    Parameters
    ----------
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
        If the image cannot be decoded, or its samples or colours are none that are read; the line
        names it.
    """
    if data.startswith(TIFF):
        return _decoded_tiff(data, name)
    samples, warnings = _decoded_by_opencv(data, name)
    if is_animated(data):
        warnings += (f"{name}: is animated, its first picture was read",)
    return _turned(samples, orientation(data)), warnings


def _turned(samples: Samples, orientation: int) -> Samples:
    """Turn upright by an orientation of EXIF, 1 to 8."""
    if orientation >= 5:
        samples = samples.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        samples = samples[:, ::-1]
    if orientation in (3, 4, 7, 8):
        samples = samples[::-1]
    return samples


def _damaged(name: object) -> ValueError:
    return ValueError(f"{name}: the image is damaged or cut short and cannot be decoded")


# -- OpenCV ---------------------------------------------------------------------------------------


def _decoded_by_opencv(data: bytes, name: object) -> tuple[Samples, tuple[str, ...]]:
    import cv2

    samples: Samples | None = None
    with decoder_output() as printed, suppress(cv2.error):
        samples = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if samples is None:
        raise _damaged(name)
    warnings = tuple(
        f"{name}: the image is damaged in places ({one_line(line)})"
        for line in printed
        if line.startswith("Corrupt JPEG data")
    )
    if samples.ndim == 2:
        return samples, warnings
    colours = samples[:, :, :3][:, :, ::-1]  # OpenCV has blue first
    if colours.shape[2] != 3:
        colours = colours[:, :, 0]
    return colours, warnings + _dropped(samples[:, :, 3:], name)


def _dropped(extra: Samples, name: object, *, alpha: bool = True) -> tuple[str, ...]:
    """Warnings of channels (H, W, C) beside the colours, which are left out."""
    # an alpha channel that is opaque everywhere says nothing
    if not extra.size or (alpha and extra.min() >= full_scale(extra.dtype)):
        return ()
    if alpha:
        return (f"{name}: the transparency (alpha channel) was dropped",)
    return (f"{name}: its channels beside the colours were dropped",)


# -- TIFF -----------------------------------------------------------------------------------------


def _decoded_tiff(data: bytes, name: object) -> tuple[Samples, tuple[str, ...]]:
    try:
        page, number, pages = photo_page(data)
        reason = refusal(page)
        if not reason:
            colours, extra = channels(page)
    except Exception:  # of the many kinds that tifffile and its decoders raise
        raise _damaged(name) from None
    if reason:
        raise ValueError(f"{name}: {reason}")
    warnings = _dropped(extra, name, alpha=page.extrasamples[:1] in ((), (1,), (2,)))
    if pages > 1:
        which = "the first" if number == 1 else f"the largest, number {number},"
        warnings += (
            f"{name}: holds {pages} pages, {which} was read; save the others as files of their"
            " own",
        )
    return _turned(colours, tiff_orientation(page)), warnings


# -- messages of decoders -------------------------------------------------------------------------


@contextmanager
def decoder_output() -> Iterator[list[str]]:
    """Capture standard error of C libraries, to which OpenCV's and LibRaw's decoders write.

    The list afterwards holds the lines that were printed, as far as a pipe takes them.
    """
    lines: list[str] = []
    with _TURN:
        try:
            stderr = os.dup(_STDERR)
        except OSError:  # a service may run without one
            yield lines
            return
        reading, writing = os.pipe()
        # a full pipe drops what is printed; blocking, it would stop the decoder for ever
        for end in (reading, writing):
            os.set_blocking(end, False)
        os.dup2(writing, _STDERR)
        os.close(writing)
        try:
            yield lines
        finally:
            os.dup2(stderr, _STDERR)
            os.close(stderr)
            with os.fdopen(reading, "rb") as stream:
                lines += (stream.read() or b"").decode(errors="replace").splitlines()
