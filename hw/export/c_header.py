"""C header: the code as MSB-first bytes, for firmware of one's own (C99, AVR included)."""

from __future__ import annotations

import re

from hw.device import DeviceProfile
from hw.export._text import GENERIC, integer, only, packed_bytes, verified
from hw.program import Program

suffix = ".h"
summary = "C99 header with the code as bytes, for firmware of one's own"
tick_ns = 1

_BYTES_PER_LINE = 12
_CHIPS = re.compile(r"^#define SHUTTER_CODE_CHIPS (\S+)u$", re.MULTILINE)
_CHIP_NS = re.compile(r"^#define SHUTTER_CODE_CHIP_NS (\S+?)U?LL$", re.MULTILINE)
_SIZE = re.compile(r"^#define SHUTTER_CODE_BYTES (\S+)u$", re.MULTILINE)
_CRC = re.compile(r"^ \* CRC32 (\S+) ", re.MULTILINE)
_ARRAY = re.compile(
    r"^static const uint8_t shutter_code\[SHUTTER_CODE_BYTES\] = \{([^{}]*)\};$", re.MULTILINE
)


def export(program: Program, _device: DeviceProfile = GENERIC, /) -> str:
    """Write the program as a C99 header with the array ``shutter_code``."""
    packed = [f"0x{byte:02x}" for byte in program.to_bytes()]
    lines = [
        ", ".join(packed[k : k + _BYTES_PER_LINE]) for k in range(0, len(packed), _BYTES_PER_LINE)
    ]
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


def parse_back(text: str, /) -> Program:
    """Read the program back.

    Raises
    ------
    ValueError
        If a definition is missing or malformed, or the CRC-32 does not fit.
    """
    if not text.rstrip().endswith("#endif"):
        raise ValueError(
            "C header does not end with #endif: it was cut short or altered, export again"
        )
    source = "C header"
    chips = integer(
        only(_CHIPS, text, "SHUTTER_CODE_CHIPS", source=source), "C header SHUTTER_CODE_CHIPS"
    )
    chip_ns = integer(
        only(_CHIP_NS, text, "SHUTTER_CODE_CHIP_NS", source=source),
        "C header SHUTTER_CODE_CHIP_NS",
    )
    size = integer(
        only(_SIZE, text, "SHUTTER_CODE_BYTES", source=source), "C header SHUTTER_CODE_BYTES"
    )
    crc = only(_CRC, text, "CRC32 comment", source=source)
    packed = packed_bytes(
        only(_ARRAY, text, "shutter_code array", source=source), what="C header shutter_code"
    )
    if len(packed) != size:
        raise ValueError(
            f"C header shutter_code has {len(packed)} bytes: SHUTTER_CODE_BYTES says {size}"
        )
    return verified(Program.from_bytes(packed, chips=chips, chip_ns=chip_ns), crc, source=source)
