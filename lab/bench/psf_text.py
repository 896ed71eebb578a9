"""A PSF as one short line of text, for the figures of a cell."""

from __future__ import annotations

import base64
import binascii
import zlib

import numpy as np

from motdiff.types import FloatArray


def psf_to_text(psf: FloatArray) -> str:
    """Write a PSF (S, S) as one short line, to 16-bit floats."""
    data = np.ascontiguousarray(psf, dtype="<f2").tobytes()
    return f"{len(psf)}:{base64.b64encode(zlib.compress(data, 9)).decode()}"


def psf_from_text(text: str) -> FloatArray:
    """Read a text of :func:`psf_to_text` as a PSF of sum 1.

    Raises
    ------
    ValueError
        If it is something else.
    """
    size, _, digits = text.partition(":")
    try:
        data = np.frombuffer(zlib.decompress(base64.b64decode(digits, validate=True)), dtype="<f2")
        psf = data.reshape(int(size), int(size)).astype(np.float64)
    except (ValueError, binascii.Error, zlib.error):
        raise ValueError(f"psf: must be a text of psf_to_text, got {text[:20]!r}") from None
    return np.asarray(psf / psf.sum(), dtype=np.float64)
