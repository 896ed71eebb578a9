"""CSV of edges: `time_us,level` rows, exact to the nanosecond."""

from __future__ import annotations

import re

from hw.device import DeviceProfile
from hw.export.base import GENERIC, MOST_CHIPS, Exporter, integer, microseconds
from hw.program import Program

_COLUMNS = "time_us,level"
_HEADER = ("format", "chip_ns", "chips", "code_crc32")
_FORMAT = "hw.csv/1"
_ROW = re.compile(r"([0-9]+)\.([0-9]{3}),([01])")


class CsvEdges(Exporter):
    """Edges as rows of ``time_us,level``, closed at the end of the last chip."""

    name = "csv"
    suffix = ".csv"
    summary = "edges as time_us,level rows"
    needs = "scripts of users"
    manual = "hw.csv/1: its first lines"
    label = "CSV"

    def export(self, program: Program, _device: DeviceProfile = GENERIC, /) -> str:
        """Write the program as CSV.

        The shutter is closed before the first row. The last row closes it at ``chips * chip_ns`` even
        when the last chip is closed already, so that the file says how long the program lasts.
        """
        rows = list(program.edges)
        if rows[-1][0] != program.duration_ns:
            rows.append((program.duration_ns, 0))
        values = (_FORMAT, program.chip_ns, program.chips, f"0x{program.code_crc32:08x}")
        header = [f"# {key}: {value}" for key, value in zip(_HEADER, values, strict=True)]
        body = [f"{microseconds(time_ns)},{level}" for time_ns, level in rows]
        return "\n".join([*header, _COLUMNS, *body]) + "\n"

    def parse_back(self, text: str, /) -> Program:
        """Read the program back.

        Raises
        ------
        ValueError
            If a header line is missing, a row is malformed or out of order, or the CRC-32 does not
            fit.
        """
        header: dict[str, str] = {}
        rows: list[tuple[int, int]] = []
        columns_seen = False
        for number, line in enumerate(text.splitlines(), start=1):
            if not line.strip():
                continue
            if line.startswith("#") and not columns_seen:
                key, _, value = line[1:].partition(":")
                header[key.strip()] = value.strip()
            elif not columns_seen:
                if line != _COLUMNS:
                    raise ValueError(
                        f"CSV line {number} is {line[:40]!r}: the column line {_COLUMNS!r} is needed"
                        " there"
                    )
                columns_seen = True
            else:
                row = _ROW.fullmatch(line)
                if row is None:
                    raise ValueError(
                        f"CSV line {number} is {line[:40]!r}: a row like '200.000,1' is needed"
                    )
                # Read as two whole numbers: a float would round long times.
                micro, nano, level = row.groups()
                rows.append((1000 * integer(micro, f"CSV line {number}") + int(nano), int(level)))
        missing = [key for key in _HEADER if key not in header]
        if missing:
            raise ValueError(
                f"CSV has no '# {missing[0]}:' line: the header needs {', '.join(_HEADER)}"
            )
        if header["format"] != _FORMAT:
            raise ValueError(f"CSV has format {header['format'][:40]!r}: {_FORMAT!r} is needed")
        chip_ns = integer(header["chip_ns"], "CSV chip_ns")
        chips = integer(header["chips"], "CSV chips")
        if not rows or rows[-1] != (chip_ns * chips, 0):
            raise ValueError(
                f"CSV does not end with a closing row at {chips} x {chip_ns} ns: it was cut short or"
                " altered"
            )
        if len(rows) > chips + 1:
            raise ValueError(f"CSV has {len(rows)} rows: {chips} chips have at most {chips + 1}")
        if len(rows) % 2:  # an odd count: the last row only marks the end of trailing closed chips
            rows.pop()
        if chips > MOST_CHIPS or not chip_ns:
            raise ValueError(
                f"CSV has {chips} chips of {chip_ns} ns: at most {MOST_CHIPS} chips of at least 1 ns"
                " can be read"
            )
        return self.verified(
            Program.from_edges(rows, chip_ns=chip_ns, chips=chips),
            header["code_crc32"],
        )
