"""Decoding of image files by OpenCV; messages of the decoders are captured as reports of damage."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motdiff.io.inputs import one_line
from motdiff.io.photo_files import JPEG

__all__ = ["decode", "decoder_output"]

_STDERR = 2
_TURN = threading.Lock()  # there is one standard error for all threads


def decode(data: bytes, name: object, *, colour: bool = False) -> tuple[NDArray[Any], tuple[str, ...]]:
    """Decode an image of :func:`motdiff.io.photo_files.photo_bytes`, upright as the camera was held.

    Parameters
    ----------
    data : bytes
    name : path
        For the error.
    colour : bool
        Whether to convert to three channels of 8 bit.

    Returns
    -------
    image : (H, W) or (H, W, C) array
        Blue green red, or with a fourth channel for transparency.
    damage : tuple of str
        Messages of the JPEG decoder about damage that it skipped.

    Raises
    ------
    ValueError
        If the image cannot be decoded.
    """
    import cv2

    # A JPEG may hold an orientation; OpenCV turns it upright unless asked for "unchanged".
    turned = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
    flags = cv2.IMREAD_COLOR if colour else turned if data.startswith(JPEG) else cv2.IMREAD_UNCHANGED
    with decoder_output() as printed:
        try:
            decoded = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        except cv2.error:
            decoded = None
    if decoded is None:
        raise ValueError(f"{name}: the image is damaged or cut short and cannot be decoded")
    return np.asarray(decoded), tuple(one_line(line) for line in printed if line.startswith("Corrupt JPEG data"))


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
