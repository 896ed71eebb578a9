"""VCD waveform of the shutter, for logic-analyser software and simulators."""

from __future__ import annotations

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, value_in
from hw.program import Program


class VcdWaveform(Exporter):
    """Waveform of shutter and gate, in ns."""

    name = "vcd"
    suffix = ".vcd"
    summary = "waveform of shutter and gate in ns, for logic-analyser software"
    needs = "logic-analyser software or a simulator"
    manual = "IEEE 1364-2005, clause 18: value change dump"

    def export(self, program: Program, _device: DeviceProfile = GENERIC, /) -> str:
        """Write the signals ``shutter`` (1 open) and ``gate`` (1 during all chips), 1 ns a step.

        The program begins one chip after time 0 and the record ends one chip after it, so that opening
        and closing are edges in the file whatever the first and last chips are.
        """
        start = program.chip_ns
        end = program.chip_ns + program.duration_ns
        changes: dict[int, list[str]] = {0: ["$dumpvars", "0s", "0g", "$end"], start: ["1g"]}
        for time_ns, level in program.edges:
            changes.setdefault(start + time_ns, []).append(f"{level}s")
        changes.setdefault(end, []).append("0g")
        changes[end + program.chip_ns] = []
        body = [line for time_ns, lines in changes.items() for line in (f"#{time_ns}", *lines)]
        head = f"""\
$comment Shutter program written by coded-exposure: shutter 1 is open, gate 1 is the whole code. $end
$comment chip_ns {program.chip_ns} chips {program.chips} code_crc32 0x{program.code_crc32:08x} $end
$timescale 1 ns $end
$scope module program $end
$var wire 1 s shutter $end
$var wire 1 g gate $end
$upscope $end
$enddefinitions $end
"""
        return head + "\n".join(body) + "\n"

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the changes of ``shutter``."""
        chip_ns = int(value_in(text, r"^\$comment chip_ns (\d+) "))
        chips = int(value_in(text, r"^\$comment chip_ns \d+ chips (\d+) "))
        edges: list[tuple[int, int]] = []
        time_ns = 0
        for line in text.splitlines():
            if line.startswith("#"):
                time_ns = int(line[1:])
            # the level at time 0 is the recording's first, no edge
            elif line in {"0s", "1s"} and time_ns:
                edges.append((time_ns - chip_ns, int(line[0])))
        return Program.from_edges(edges, chip_ns=chip_ns, chips=chips)
