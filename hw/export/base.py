"""Base class and registry of the exporters, and what their texts share."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from hw.device import DeviceProfile
from hw.program import Program

GENERIC = DeviceProfile(name="generic")
"""The device when none is named: closed at level 0, nothing added to an opening."""


class Exporter(ABC):
    """A format of timed programs: written as text, and read back to prove its edges.

    A class with a name enters :data:`EXPORTERS` when it is defined.

    Attributes
    ----------
    name, suffix : str
        Of the format, and of its files, with the dot.
    summary : str
        Help in one line.
    needs : str
        What plays or reads the file.
    manual : str
        Document that states the format or the device's limits.
    tick_ns : int
        Unit of the chip times that the format can represent, ns.
    stem_suffix : str
        Added to the code's name, where the suffix alone could replace or hide another file.
    """

    name: ClassVar[str]
    suffix: ClassVar[str]
    summary: ClassVar[str]
    needs: ClassVar[str]
    manual: ClassVar[str]
    tick_ns: ClassVar[int] = 1
    stem_suffix: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        EXPORTERS[cls.name] = cls()  # in the order in which the modules are imported

    @abstractmethod
    def export(self, program: Program, device: DeviceProfile = GENERIC, /) -> str:
        """Write the program as text; ValueError when the format cannot represent it."""

    @abstractmethod
    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the edges in a text of :meth:`export`, to prove them.

        Texts of others are not read, and so the rest of it is not checked.

        ValueError if the edges are no program's.
        """

    def file_name(self, stem: str) -> str:
        """Name the file of a code.

        Examples
        --------
        >>> from hw.export import find_exporter
        >>> find_exporter("csv").file_name("code"), find_exporter("json").file_name("code")
        ('code.csv', 'code.program.json')
        """
        return stem + self.stem_suffix + self.suffix

    def ticks(self, program: Program, player: str, *, min_ticks: int, max_ticks: int) -> int:
        """Return the chip time in the format's ticks; ValueError where `player` cannot play it."""
        ticks, remainder = divmod(program.chip_ns, self.tick_ns)
        if remainder or not min_ticks <= ticks <= max_ticks:
            # what the message proposes
            nearest_ns = min(max(ticks, min_ticks), max_ticks) * self.tick_ns
            raise ValueError(
                f"chip of {program.chip_ns} ns cannot be played by {player}: it must be a multiple"
                f" of {self.tick_ns} ns in {min_ticks * self.tick_ns}..{max_ticks * self.tick_ns} ns;"
                f" {nearest_ns} ns would do"
            )
        return ticks


EXPORTERS: dict[str, Exporter] = {}
"""Format name to exporter."""


def value_in(text: str, pattern: str) -> str:
    """Return what the one group of a pattern has in an exported text."""
    match = re.search(pattern, text, re.MULTILINE)
    if match is None:
        raise ValueError(f"the text has nothing like {pattern}")
    return match[1]


def microseconds(time_ns: int) -> str:
    """Microseconds with three digits: decimal text keeps each nanosecond, a float would not."""
    return f"{time_ns // 1000}.{time_ns % 1000:03d}"


def item_rows(items: Sequence[object], *, per_line: int, indent: str = "    ") -> str:
    """Lay the items of an array out in lines, with commas between."""
    texts = [str(item) for item in items]
    rows = [", ".join(texts[k : k + per_line]) for k in range(0, len(texts), per_line)]
    return ",\n".join(f"{indent}{row}" for row in rows)


def hex_rows(packed: bytes, *, per_line: int, indent: str) -> str:
    """Lay bytes out as an array."""
    items = [f"0x{byte:02x}" for byte in packed]
    return item_rows(items, per_line=per_line, indent=indent)


def packed_bytes(items: str) -> bytes:
    """Read ``0x0f, 0xa5, ...`` as bytes."""
    return bytes(int(number, 16) for number in items.split(","))
