"""Small strict readers shared by the exporters."""

from __future__ import annotations

import re
import tomllib
from decimal import Decimal
from itertools import zip_longest
from typing import Any

from hw.device import DeviceProfile
from hw.program import Program

GENERIC = DeviceProfile(name="generic")
"""The device when none is named: closed at level 0, nothing added to an opening."""

# Python's int() takes spaces, underscores and the digits of every script, and quadratic time on
# long ones.
_INTEGER = re.compile(r"0|[1-9][0-9]{0,18}")


def integer(text: str, what: str) -> int:
    """Read a plain ASCII decimal of at most 19 digits; `what` names it in the message."""
    if not _INTEGER.fullmatch(text):
        raise ValueError(f"{what} is {text[:40]!r}: a whole number is needed")
    return int(text)


def only(pattern: re.Pattern[str], text: str, what: str, *, source: str) -> str:
    """Return the one group of the one match of a pattern; `what` names it in the message."""
    found = pattern.findall(text)
    if len(found) != 1:
        raise ValueError(
            f"{source} has {len(found)} of {what}: exactly one is needed, as export writes it"
        )
    return str(found[0])


def packed_bytes(items: str, *, what: str) -> bytes:
    """Read ``0x0f, 0xa5, ...`` as bytes."""
    pieces = [item.strip() for item in items.split(",")]
    for piece in pieces:
        if not re.fullmatch(r"0x[0-9a-f]{2}", piece):
            raise ValueError(f"{what} has {piece[:20]!r}: bytes like 0xa5 are needed")
    return bytes(int(piece, 16) for piece in pieces)


def toml_table(text: str, *, form: str, source: str) -> dict[str, Any]:
    """Read TOML whose field ``format`` must be `form`; its decimals stay exact."""
    try:
        table = tomllib.loads(text, parse_float=Decimal)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{source} is not TOML: {' '.join(str(error).split())[:120]}") from None
    if table.get("format") != form:
        raise ValueError(
            f"{source} has format {str(table.get('format'))[:40]!r}: {form!r} is needed"
        )
    return table


def whole(table: dict[str, Any], key: str, *, source: str) -> int:
    """Take a whole number below 2^63 out of a TOML table."""
    value = table.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise ValueError(f"{source} {key} is {str(value)[:40]!r}: a whole number is needed")
    return value


def verified(program: Program, crc: str, *, source: str) -> Program:
    """Return the program if its CRC-32, as ``0x`` and 8 hexadecimal digits, is the one stated in
    the text.
    """
    right = f"0x{program.code_crc32:08x}"
    if crc != right:
        raise ValueError(
            f"{source} says CRC32 {crc[:20]!r} but its code has {right}: the text was altered,"
            " export again"
        )
    return program


def unaltered(program: Program, text: str, again: str, *, source: str) -> Program:
    """Return the program if the text equals its export, line for line.

    A file that plays has more in it than the code: a changed pin, clock or voltage is another
    program.
    """
    pairs = zip_longest(text.rstrip().split("\n"), again.rstrip().split("\n"), fillvalue="")
    for number, (found, right) in enumerate(pairs, start=1):
        if found != right:
            raise ValueError(
                f"{source} line {number} is {found[:40]!r} where export writes {right[:40]!r}: it"
                " was altered, export again"
            )
    return program
