"""Pattern list for a digital micromirror device: exposure and dark time of each opening."""

from __future__ import annotations

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, value_in
from hw.program import Program

_COLUMNS = "exposure_us,dark_us"


class DmdPatterns(Exporter):
    """One pattern for each opening."""

    name = "dmd"
    suffix = ".dmd.csv"
    summary = "pattern list of a micromirror device: exposure and dark time in us per opening"
    needs = "a micromirror device"
    manual = "Texas Instruments DLPC900 Programmer's Guide"
    tick_ns = 1000

    def export(self, program: Program, _device: DeviceProfile = GENERIC, /) -> str:
        """Write the list: mirrors on for ``exposure_us``, then off for ``dark_us``, line by line.

        They stay off for ``leading_dark_us`` after the trigger; the last dark time completes the
        code.
        """
        if program.chip_ns % self.tick_ns:
            nearest_ns = max(program.chip_ns // 1000, 1) * 1000
            raise ValueError(
                f"chip of {program.chip_ns} ns cannot be written for a DMD: it must be a multiple"
                f" of 1000 ns; {nearest_ns} ns would do"
            )
        # edges alternate, and the end of the code ends the last dark time
        times = [time_ns for time_ns, _ in program.edges] + [program.duration_ns]
        openings = times[:-1:2]
        closings = times[1::2]
        next_openings = times[2::2]
        rows = "".join(
            f"{(end - start) // 1000},{(after - end) // 1000}\n"
            for start, end, after in zip(openings, closings, next_openings, strict=True)
        )
        return f"""\
# format: hw.dmd/1
# chip_ns: {program.chip_ns}
# chips: {program.chips}
# code_crc32: 0x{program.code_crc32:08x}
# patterns: {program.pulses}
# leading_dark_us: {openings[0] // 1000}
{_COLUMNS}
{rows}"""

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the exposures and dark times."""
        chip_ns = int(value_in(text, r"^# chip_ns: (\d+)$"))
        chips = int(value_in(text, r"^# chips: (\d+)$"))
        # the list has lengths, not times: they add up to the edges
        time_ns = int(value_in(text, r"^# leading_dark_us: (\d+)$")) * 1000
        edges: list[tuple[int, int]] = []
        for line in text.partition(f"\n{_COLUMNS}\n")[2].splitlines():
            exposure_us, dark_us = map(int, line.split(","))
            end_ns = time_ns + exposure_us * 1000
            edges += [(time_ns, 1), (end_ns, 0)]
            time_ns = end_ns + dark_us * 1000
        return Program.from_edges(edges, chip_ns=chip_ns, chips=chips)
