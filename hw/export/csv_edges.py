"""CSV of edges: `time_us,level` rows, exact to the nanosecond."""

from __future__ import annotations

from decimal import Decimal

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter, microseconds, value_in
from hw.program import Program

_COLUMNS = "time_us,level"


class CsvEdges(Exporter):
    """Edges as rows of ``time_us,level``, closed at the end of the last chip."""

    name = "csv"
    suffix = ".csv"
    summary = "edges as time_us,level rows"
    needs = "scripts of users"
    manual = "hw.csv/1: its first lines"

    def export(self, program: Program, _device: DeviceProfile = GENERIC, /) -> str:
        """Write the program as CSV.

        The shutter is closed before the first row. The last row closes it at ``chips * chip_ns`` even
        when the last chip is closed already, so that the file says how long the program lasts.
        """
        rows = list(program.edges)
        if rows[-1][0] != program.duration_ns:
            rows.append((program.duration_ns, 0))
        body = "".join(f"{microseconds(time_ns)},{level}\n" for time_ns, level in rows)
        return f"""\
# format: hw.csv/1
# chip_ns: {program.chip_ns}
# chips: {program.chips}
# code_crc32: 0x{program.code_crc32:08x}
{_COLUMNS}
{body}"""

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the rows."""
        chip_ns = int(value_in(text, r"^# chip_ns: (\d+)$"))
        chips = int(value_in(text, r"^# chips: (\d+)$"))
        rows = [line.split(",") for line in text.partition(f"\n{_COLUMNS}\n")[2].splitlines()]
        # decimals: a float would round long times
        edges = [(int(Decimal(time_us) * 1000), int(level)) for time_us, level in rows]
        # an odd count: the last row only marks the end of trailing closed chips
        if len(edges) % 2:
            edges.pop()
        return Program.from_edges(edges, chip_ns=chip_ns, chips=chips)
