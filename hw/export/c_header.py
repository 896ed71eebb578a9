"""C header: the code as MSB-first bytes, for firmware of one's own (C99, AVR included)."""

from __future__ import annotations

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, hex_rows, packed_bytes, value_in
from hw.program import Program


class CHeader(Exporter):
    """The code as the array ``shutter_code`` of a C99 header."""

    name = "c"
    suffix = ".h"
    summary = "C99 header with the code as bytes, for firmware of one's own"
    needs = "firmware in C99"
    manual = "ISO/IEC 9899:1999"

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
        """Read the program back from the macros and the array."""
        chips = int(value_in(text, r"^#define SHUTTER_CODE_CHIPS (\d+)u$"))
        chip_ns = int(value_in(text, r"^#define SHUTTER_CODE_CHIP_NS (\d+)ULL$"))
        packed = packed_bytes(
            value_in(text, r"shutter_code\[SHUTTER_CODE_BYTES\] = \{([^{}]*)\};$")
        )
        return Program.from_bytes(packed, chips=chips, chip_ns=chip_ns)
