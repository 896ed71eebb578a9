"""C header: the code as MSB-first bytes, for firmware of one's own (C99, AVR included)."""

from __future__ import annotations

import re

from hw.export._text import integer, verified
from hw.program import Program

__all__ = ["export", "parse_back", "suffix"]

suffix = ".h"

_BYTES_PER_LINE = 12
_CHIPS = re.compile(r"^#define SHUTTER_CODE_CHIPS (\S+)u$", re.MULTILINE)
_CHIP_NS = re.compile(r"^#define SHUTTER_CODE_CHIP_NS (\S+?)U?LL$", re.MULTILINE)
_SIZE = re.compile(r"^#define SHUTTER_CODE_BYTES (\S+)u$", re.MULTILINE)
_CRC = re.compile(r"^ \* CRC32 (\S+) ", re.MULTILINE)
_ARRAY = re.compile(r"^static const uint8_t shutter_code\[SHUTTER_CODE_BYTES\] = \{([^{}]*)\};$", re.MULTILINE)
_BYTE = re.compile(r"0x[0-9a-f]{2}")


def export(program: Program) -> str:
    """Write the program as a C99 header with the array ``shutter_code``."""
    packed = [f"0x{byte:02x}" for byte in program.to_bytes()]
    lines = [", ".join(packed[k : k + _BYTES_PER_LINE]) for k in range(0, len(packed), _BYTES_PER_LINE)]
    array = ",\n".join(f"    {line}" for line in lines)
    return f"""\
/* Shutter program written by coded-exposure: {program.chips} chips of {program.chip_ns} ns, {program.pulses} openings.
 * Play SHUTTER_CODE_CHIPS bits of shutter_code, most significant bit of the first byte first, 1 = open.
 * CRC32 0x{program.code_crc32:08x} (zlib) over chip_ns as u64, chips as u32, both little endian, and the bytes.
 */
#ifndef SHUTTER_CODE_H
#define SHUTTER_CODE_H

#include <stdint.h>

#define SHUTTER_CODE_CHIPS {program.chips}u
#define SHUTTER_CODE_CHIP_NS {program.chip_ns}ULL
#define SHUTTER_CODE_BYTES {len(packed)}u

static const uint8_t shutter_code[SHUTTER_CODE_BYTES] = {{
{array}
}};

#endif
"""


def parse_back(text: str) -> Program:
    """Read the program back.

    Raises
    ------
    ValueError
        If a definition is missing or malformed, or the CRC-32 does not fit.
    """
    if not text.rstrip().endswith("#endif"):
        raise ValueError("C header does not end with #endif: it was cut short or altered, export again")
    chips = integer(_only(_CHIPS, text, "SHUTTER_CODE_CHIPS"), "C header SHUTTER_CODE_CHIPS")
    chip_ns = integer(_only(_CHIP_NS, text, "SHUTTER_CODE_CHIP_NS"), "C header SHUTTER_CODE_CHIP_NS")
    size = integer(_only(_SIZE, text, "SHUTTER_CODE_BYTES"), "C header SHUTTER_CODE_BYTES")
    crc = _only(_CRC, text, "CRC32 comment")
    items = [item.strip() for item in _only(_ARRAY, text, "shutter_code array").split(",")]
    for item in items:
        if not _BYTE.fullmatch(item):
            raise ValueError(f"C header shutter_code has {item[:20]!r}: bytes like 0xa5 are needed")
    if len(items) != size:
        raise ValueError(f"C header shutter_code has {len(items)} bytes: SHUTTER_CODE_BYTES says {size}")
    packed = bytes(int(item, 16) for item in items)
    return verified(Program.from_bytes(packed, chips=chips, chip_ns=chip_ns), crc, source="C header")


def _only(pattern: re.Pattern[str], text: str, what: str) -> str:
    found = pattern.findall(text)
    if len(found) != 1:
        raise ValueError(f"C header has {len(found)} of {what}: exactly one is needed, as export writes it")
    return str(found[0])
