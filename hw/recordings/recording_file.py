"""A logic analyser's file, whose format is recognised by its content."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from hw.files import content
from hw.recordings.saleae import is_saleae, parse_saleae
from hw.recordings.traces import Recording
from hw.recordings.vcd import parse_vcd

_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF32_LE: "utf-32-le",  # begins like the mark of UTF-16
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}
_BINARY = re.compile(r"[\0-\x08\x0e-\x1a\x1c-\x1f]")


def read_recording(path: str | Path) -> Recording:
    """Read a VCD file, or a digital CSV export of Saleae Logic, in any usual encoding.

    All that matters in them is ASCII but the signals' names: those in an 8-bit alphabet are read
    as Windows-1252.

    Raises
    ------
    ValueError
        If the file cannot be read or is neither.
    """
    try:
        text = _decoded(content(path))
    except UnicodeDecodeError:
        raise ValueError(
            f"{path} is no text: save or export the capture as VCD (value change dump), or from"
            " Saleae Logic as CSV"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(
            f"{path} cannot be read: {reason}; name a VCD file, or a CSV export of Saleae Logic"
        ) from None
    # By content too: an export saved as .txt is read, and a damaged .csv is named as a CSV.
    if Path(path).suffix.lower() == ".csv" or is_saleae(text):
        return parse_saleae(text, source=str(path))
    return parse_vcd(text, source=str(path))


def _decoded(data: bytes) -> str:
    """Decode UTF-8, -16 or -32, with a mark or without, else Windows-1252.

    Raises
    ------
    UnicodeDecodeError
        If it is neither UTF-8 nor text at all.
    """
    mark = next((mark for mark in _MARKS if data.startswith(mark)), b"")
    if mark:
        # a cut end is the parser's to tell
        text = data.removeprefix(mark).decode(_MARKS[mark], errors="replace")
    # ASCII in UTF-16 has a zero in every second byte.
    elif len(data) > 1 and 0 in data[:2]:
        text = data.decode("utf-16-le" if data[0] else "utf-16-be", errors="replace")
    else:
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            text = data.decode("cp1252", errors="replace")
            if _BINARY.search(text):
                raise
    return text.replace("\r\n", "\n").replace("\r", "\n")
