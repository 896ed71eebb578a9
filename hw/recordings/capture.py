"""Reader of logic-analyser files of any supported format, recognised by content."""

from __future__ import annotations

from pathlib import Path

from hw._files import content, decoded
from hw.recordings.saleae import is_saleae, parse_saleae
from hw.recordings.trace import Recording
from hw.recordings.vcd import parse_vcd


def read_capture(path: str | Path) -> Recording:
    """Read a VCD file, or a digital CSV export of Saleae Logic, in any usual encoding.

    All that matters in them is ASCII but the signals' names: those in an 8-bit alphabet are read
    as Windows-1252.

    Raises
    ------
    ValueError
        If the file cannot be read or is neither.
    """
    try:
        text = decoded(content(path))
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
