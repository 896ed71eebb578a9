"""Pattern list for a digital micromirror device: one pattern per opening, with its exposure and
dark time.
"""

from __future__ import annotations

import re

from hw.device import DeviceProfile
from hw.export._text import GENERIC, integer, only, unaltered, verified
from hw.program import Program

suffix = ".dmd.csv"
summary = "pattern list of a micromirror device: exposure and dark time in us per opening"
tick_ns = 1000

_COLUMNS = "exposure_us,dark_us"
_LINE = re.compile(r"([0-9]{1,19}),([0-9]{1,19})")
_MOST_CHIPS = 10**7
_HEAD = ("chip_ns", "chips", "code_crc32", "patterns", "leading_dark_us")
_FACTS = {key: re.compile(rf"^# {key}: (\S+)$", re.MULTILINE) for key in _HEAD}


def export(program: Program, _device: DeviceProfile = GENERIC, /) -> str:
    """Write the list: mirrors on for ``exposure_us``, then off for ``dark_us``, line after line.

    The mirrors stay off for ``leading_dark_us`` after the trigger; the last dark time completes
    the code.

    Raises
    ------
    ValueError
        If the chip is no whole number of microseconds, the unit of these devices.
    """
    if program.chip_ns % tick_ns:
        near = max(program.chip_ns // 1000, 1) * 1000
        raise ValueError(
            f"chip of {program.chip_ns} ns cannot be written for a DMD: it must be a multiple of"
            f" 1000 ns; {near} ns would do"
        )
    times = [time_ns for time_ns, _ in program.edges] + [program.duration_ns]
    starts = times[:-1:2]
    ends = times[1::2]
    following = times[2::2]
    rows = [
        f"{(end - start) // 1000},{(after - end) // 1000}"
        for start, end, after in zip(starts, ends, following, strict=True)
    ]
    values = (
        program.chip_ns,
        program.chips,
        f"0x{program.code_crc32:08x}",
        program.pulses,
        starts[0] // 1000,
    )
    head = [f"# {key}: {value}" for key, value in zip(_HEAD, values, strict=True)]
    return "\n".join(["# format: hw.dmd/1", *head, _COLUMNS, *rows]) + "\n"


def parse_back(text: str, /) -> Program:
    """Read the program back from the exposures and dark times.

    Raises
    ------
    ValueError
        If the text is no file of `export`.
    """
    source = "DMD list"
    facts = {
        key: only(pattern, text, f"'# {key}:'", source=source) for key, pattern in _FACTS.items()
    }
    numbers = {key: integer(facts[key], f"{source} {key}") for key in _HEAD if key != "code_crc32"}
    chips = numbers["chips"]
    if chips > _MOST_CHIPS:
        raise ValueError(f"{source} has {chips} chips: at most {_MOST_CHIPS} can be read")
    time_ns = numbers["leading_dark_us"] * 1000
    edges: list[tuple[int, int]] = []
    for line in text.partition(f"\n{_COLUMNS}\n")[2].splitlines():
        row = _LINE.fullmatch(line)
        if row is None:
            raise ValueError(f"{source} has row {line[:40]!r}: a row like '200,400' is needed")
        end = time_ns + int(row[1]) * 1000
        edges += [(time_ns, 1), (end, 0)]
        time_ns = end + int(row[2]) * 1000
    program = Program.from_edges(edges, chip_ns=numbers["chip_ns"], chips=chips)
    return unaltered(
        verified(program, facts["code_crc32"], source=source), text, export(program), source=source
    )
