"""Pattern list for a digital micromirror device: exposure and dark time of each opening."""

from __future__ import annotations

import re

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, integer
from hw.program import Program

_COLUMNS = "exposure_us,dark_us"
_LINE = re.compile(r"([0-9]{1,19}),([0-9]{1,19})")
_HEAD = ("chip_ns", "chips", "code_crc32", "patterns", "leading_dark_us")
_FACTS = {key: re.compile(rf"^# {key}: (\S+)$", re.MULTILINE) for key in _HEAD}


class DmdPatterns(Exporter):
    """One pattern for each opening."""

    name = "dmd"
    suffix = ".dmd.csv"
    summary = "pattern list of a micromirror device: exposure and dark time in us per opening"
    needs = "a micromirror device"
    manual = "Texas Instruments DLPC900 Programmer's Guide"
    label = "DMD list"
    tick_ns = 1000

    def export(self, program: Program, _device: DeviceProfile = GENERIC, /) -> str:
        """Write the list: mirrors on for ``exposure_us``, then off for ``dark_us``, line by line.

        They stay off for ``leading_dark_us`` after the trigger; the last dark time completes the
        code.

        Raises
        ------
        ValueError
            If the chip is no whole number of microseconds, the unit of these devices.
        """
        if program.chip_ns % self.tick_ns:
            nearest_ns = max(program.chip_ns // 1000, 1) * 1000
            raise ValueError(
                f"chip of {program.chip_ns} ns cannot be written for a DMD: it must be a multiple"
                f" of 1000 ns; {nearest_ns} ns would do"
            )
        times = [time_ns for time_ns, _ in program.edges] + [program.duration_ns]
        openings = times[:-1:2]
        closings = times[1::2]
        next_openings = times[2::2]
        rows = [
            f"{(end - start) // 1000},{(after - end) // 1000}"
            for start, end, after in zip(openings, closings, next_openings, strict=True)
        ]
        values = (
            program.chip_ns,
            program.chips,
            f"0x{program.code_crc32:08x}",
            program.pulses,
            openings[0] // 1000,
        )
        head = [f"# {key}: {value}" for key, value in zip(_HEAD, values, strict=True)]
        return "\n".join(["# format: hw.dmd/1", *head, _COLUMNS, *rows]) + "\n"

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the exposures and dark times."""
        facts = {key: self.only(pattern, text, f"'# {key}:'") for key, pattern in _FACTS.items()}
        numbers = {
            key: integer(facts[key], f"{self.label} {key}") for key in _HEAD if key != "code_crc32"
        }
        chips = self.few_chips(numbers["chips"])
        # The list has lengths, not times: they add up to the edges.
        time_ns = numbers["leading_dark_us"] * 1000
        edges: list[tuple[int, int]] = []
        for line in text.partition(f"\n{_COLUMNS}\n")[2].splitlines():
            row = _LINE.fullmatch(line)
            if row is None:
                raise ValueError(
                    f"{self.label} has row {line[:40]!r}: a row like '200,400' is needed"
                )
            end = time_ns + int(row[1]) * 1000
            edges += [(time_ns, 1), (end, 0)]
            time_ns = end + int(row[2]) * 1000
        program = Program.from_edges(edges, chip_ns=numbers["chip_ns"], chips=chips)
        return self.unaltered(self.verified(program, facts["code_crc32"]), text)
