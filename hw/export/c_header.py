"""C header: the code as MSB-first bytes, for firmware of one's own (C99, AVR included)."""

from __future__ import annotations

import re

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, hex_rows, packed_bytes
from hw.program import Program

_CHIPS = re.compile(r"^#define SHUTTER_CODE_CHIPS (\S+)u$", re.MULTILINE)
_CHIP_NS = re.compile(r"^#define SHUTTER_CODE_CHIP_NS (\S+?)U?LL$", re.MULTILINE)
_SIZE = re.compile(r"^#define SHUTTER_CODE_BYTES (\S+)u$", re.MULTILINE)
_CRC = re.compile(r"^ \* CRC32 (\S+) ", re.MULTILINE)
_ARRAY = re.compile(
    r"^static const uint8_t shutter_code\[SHUTTER_CODE_BYTES\] = \{([^{}]*)\};$", re.MULTILINE
)


class CHeader(Exporter):
    """The code as the array ``shutter_code`` of a C99 header."""

    name = "c"
    suffix = ".h"
    summary = "C99 header with the code as bytes, for firmware of one's own"
    needs = "firmware in C99"
    manual = "ISO/IEC 9899:1999"
    label = "C header"

    def export(self, program: Program, _device: DeviceProfile = GENERIC, /) -> str:
        """Write the header, with chips, chip time and size as macros."""
        packed = program.to_bytes()
        array = hex_rows(packed, per_line=12, indent="    ")
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

    def parse_back(self, text: str, /) -> Program:
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
        chips = self.only_integer(_CHIPS, text, "SHUTTER_CODE_CHIPS")
        chip_ns = self.only_integer(_CHIP_NS, text, "SHUTTER_CODE_CHIP_NS")
        size = self.only_integer(_SIZE, text, "SHUTTER_CODE_BYTES")
        crc = self.only(_CRC, text, "CRC32 comment")
        packed = packed_bytes(
            self.only(_ARRAY, text, "shutter_code array"), item="C header shutter_code"
        )
        # The size is stated twice in the header: in a macro, and by the array.
        if len(packed) != size:
            raise ValueError(
                f"C header shutter_code has {len(packed)} bytes: SHUTTER_CODE_BYTES says {size}"
            )
        return self.verified(Program.from_bytes(packed, chips=chips, chip_ns=chip_ns), crc)
