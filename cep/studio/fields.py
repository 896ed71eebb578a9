"""Checks of the fields that a page sends.

Every function here raises :class:`FieldError`, one line that the page shows beside the field.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

MOST_CHIPS = 512  # of a code on the page
# of a code's runs, chips, as RunLimits and the page's fields name them
LIMITS = ("min_open", "min_closed")
# fields of the page that set what an error of the library begins with
_FIELD_OF = {
    "bits": "bits",
    "camera": "camera",
    "chip_ns": "exposure",
    "chips": "bits",
    "code": "bits",
    "device": "device",
    "exposure": "exposure",
    "exposure_s": "exposure",
    "open_range": "open",
    "photons": "photons",
    "photons_full_scale": "photons",
    "read_noise_e": "read_noise",
    "scenarios": "motion",
    "trajectory": "motion",
}


class FieldError(ValueError):
    """Wrong input, and the ``field`` of the page beside which it is shown."""

    def __init__(self, field: str, message: str) -> None:
        super().__init__(message)
        self.field = field

    @classmethod
    def of(cls, error: ValueError, *, fallback: str = "page") -> FieldError:
        """Return the error of a field that an error of the library names in its first words."""
        if isinstance(error, cls):
            return error
        head, colon, fault = str(error).partition(": ")
        first = head.split(" ")[0].rstrip(",")
        field = _FIELD_OF.get(first)
        if field is not None and colon and " " not in head:
            return cls(field, fault)
        if first in LIMITS:
            field = first
        return cls(field or fallback, str(error))

    def to_dict(self) -> dict[str, str]:
        """Return the error as the page reads it."""
        return {"field": self.field, "message": str(self)}


def nameless(error: Exception, file: Path, kind: str = "the file") -> str:
    """Return a message without the name of an uploaded file, which the server made up."""
    return str(error).replace(f"{file}: ", "").replace(str(file), kind)


@contextmanager
def writing(field: str) -> Iterator[None]:
    """Say beside a field where the studio's own folder cannot be written."""
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FieldError(
            field,
            f"the studio's folder cannot be written ({reason}); free space there, or set TMPDIR"
            " and start it again",
        ) from None


def read_bits(bits: object, field: str) -> str:
    """Read a code with an open chip."""
    if not isinstance(bits, str) or not bits or set(bits) - {"0", "1"}:
        raise FieldError(field, "a code is a row of 1 (open) and 0 (closed), as 11010001")
    if len(bits) > MOST_CHIPS:
        raise FieldError(
            field, f"the studio takes codes of up to {MOST_CHIPS} chips, this one has {len(bits)}"
        )
    if "1" not in bits:
        raise FieldError(field, "all chips are closed; at least one must be open")
    return bits


def is_text(value: object, longest: int) -> TypeGuard[str]:
    """Whether a value is a short text without line feeds and other control characters."""
    return isinstance(value, str) and len(value) <= longest and value.isprintable()


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value is a number that a double holds."""
    if not isinstance(value, int | float) or isinstance(value, bool):  # True is an int too
        return False
    # JSON has integers of any size, and Python's reader takes NaN, which compares as False
    return abs(value) <= sys.float_info.max


def read_number(
    document: Mapping[str, Any], name: str, low: float, high: float, unit: str
) -> float | None:
    """Read a number within a range, None where there is none, or an empty text."""
    value = document.get(name)
    if value is None or value == "":  # an input that was emptied
        return None
    if not is_number(value) or not low <= value <= high:
        raise FieldError(name, f"must be a number within {low:,.10g} to {high:,.10g} {unit}")
    return float(value) + 0.0  # -0.0 becomes 0.0


def read_whole(
    document: Mapping[str, Any], name: str, low: int, high: int, unit: str
) -> int | None:
    """Read a whole number within a range, as :func:`read_number` does."""
    value = read_number(document, name, low, high, unit)
    if value is None:
        return None
    if not value.is_integer():
        raise FieldError(name, "must be a whole number")
    return int(value)


def read_choice(
    document: Mapping[str, Any], field: str, choices: Sequence[str], *, default: str
) -> str:
    """Read one of the server's choices; the default where there is none, or an empty text."""
    value = document.get(field)
    if value is None or value == "":
        return default
    if value not in choices:
        raise FieldError(field, f"must be one of {', '.join(choices)}")
    return str(value)
