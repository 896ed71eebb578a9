"""Small strict readers shared by the exporters."""

from __future__ import annotations

import re

from hw.program import Program

# Python's int() takes spaces, underscores and the digits of every script, and quadratic time on long ones.
_INTEGER = re.compile(r"0|[1-9][0-9]{0,18}")


def integer(text: str, what: str) -> int:
    """Read a plain ASCII decimal of at most 19 digits; `what` names it in the message."""
    if not _INTEGER.fullmatch(text):
        raise ValueError(f"{what} is {text[:40]!r}: a whole number is needed")
    return int(text)


def verified(program: Program, crc: str, *, source: str) -> Program:
    """Return the program if its CRC-32, as ``0x`` and 8 hexadecimal digits, is the one stated in the text."""
    right = f"0x{program.code_crc32:08x}"
    if crc != right:
        raise ValueError(
            f"{source} says CRC32 {crc[:20]!r} but its code has {right}: the text was altered, export again"
        )
    return program
