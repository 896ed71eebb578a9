"""Base class and registry of the exporters, with the strict readers that they share."""

from __future__ import annotations

import re
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from decimal import Decimal
from itertools import zip_longest
from typing import Any, ClassVar

from hw.device import DeviceProfile
from hw.program import Program

GENERIC = DeviceProfile(name="generic")
"""The device when none is named: closed at level 0, nothing added to an opening."""

MOST_CHIPS = 10**7
"""Most chips that are read back: an altered count must not allocate gigabytes."""

# Python's int() takes spaces, underscores and the digits of every script, and quadratic time on
# long ones.
_INTEGER = re.compile(r"0|[1-9][0-9]{0,18}")


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
    label : str
        Such a file, in error messages.
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
    label: ClassVar[str]
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
        """Read the identical program back; ValueError in one line when the text was altered."""

    def file_name(self, stem: str) -> str:
        """Name the file of a code.

        Examples
        --------
        >>> from hw.export import find_exporter
        >>> find_exporter("csv").file_name("code"), find_exporter("json").file_name("code")
        ('code.csv', 'code.program.json')
        """
        return stem + self.stem_suffix + self.suffix

    def only(self, pattern: re.Pattern[str], text: str, item: str) -> str:
        """Return the one group of the one match of a pattern; `item` names it in the message."""
        matches = pattern.findall(text)
        if len(matches) != 1:
            raise ValueError(
                f"{self.label} has {len(matches)} of {item}: exactly one is needed, as export"
                " writes it"
            )
        return str(matches[0])

    def only_integer(self, pattern: re.Pattern[str], text: str, item: str) -> int:
        """Read the whole number that is the one match of a pattern."""
        return integer(self.only(pattern, text, item), self.label + " " + item.strip("'#: "))

    def toml_table(self, text: str, *, form: str) -> dict[str, Any]:
        """Read TOML whose field ``format`` must be `form`; its decimals stay exact."""
        try:
            table = tomllib.loads(text, parse_float=Decimal)
        except (ValueError, RecursionError) as error:
            raise ValueError(
                f"{self.label} is not TOML: {' '.join(str(error).split())[:120]}"
            ) from None
        if table.get("format") != form:
            raise ValueError(
                f"{self.label} has format {str(table.get('format'))[:40]!r}: {form!r} is needed"
            )
        return table

    def whole(self, table: dict[str, Any], key: str) -> int:
        """Take a whole number below 2^63 out of a TOML table."""
        value = table.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
            raise ValueError(
                f"{self.label} {key} is {str(value)[:40]!r}: a whole number is needed"
            )
        return value

    def verified(self, program: Program, crc: str) -> Program:
        """Return the program if its CRC-32, ``0x`` and 8 hexadecimal digits, is the text's."""
        right = f"0x{program.code_crc32:08x}"
        if crc != right:
            raise ValueError(
                f"{self.label} says CRC32 {crc[:20]!r} but its code has {right}: the text was"
                " altered, export again"
            )
        return program

    def unaltered(self, program: Program, text: str, device: DeviceProfile = GENERIC) -> Program:
        """Return the program if the text equals its export, line for line.

        A file that plays has more in it than the code: a changed pin, clock or voltage is another
        program.
        """
        written = self.export(program, device)
        # Line by line rather than as a whole, so that the message can name the line.
        pairs = zip_longest(text.rstrip().split("\n"), written.rstrip().split("\n"), fillvalue="")
        for number, (line, right) in enumerate(pairs, start=1):
            if line != right:
                raise ValueError(
                    f"{self.label} line {number} is {line[:40]!r} where export writes"
                    f" {right[:40]!r}: it was altered, export again"
                )
        return program

    def ticks(self, program: Program, player: str, *, min_ticks: int, max_ticks: int) -> int:
        """Return the chip time in the format's ticks; ValueError where `player` cannot play it."""
        ticks, remainder = divmod(program.chip_ns, self.tick_ns)
        if remainder or not min_ticks <= ticks <= max_ticks:
            nearest_ns = min(max(ticks, min_ticks), max_ticks) * self.tick_ns
            raise ValueError(
                f"chip of {program.chip_ns} ns cannot be played by {player}: it must be a multiple"
                f" of {self.tick_ns} ns in {min_ticks * self.tick_ns}..{max_ticks * self.tick_ns} ns;"
                f" {nearest_ns} ns would do"
            )
        return ticks

    def few_chips(self, chips: int) -> int:
        """Return a number of chips that is at most :data:`MOST_CHIPS`."""
        if chips > MOST_CHIPS:
            raise ValueError(f"{self.label} has {chips} chips: at most {MOST_CHIPS} can be read")
        return chips


EXPORTERS: dict[str, Exporter] = {}
"""Format name to exporter."""


def integer(text: str, item: str) -> int:
    """Read a plain ASCII decimal of at most 19 digits; `item` names it in the message."""
    if not _INTEGER.fullmatch(text):
        raise ValueError(f"{item} is {text[:40]!r}: a whole number is needed")
    return int(text)


def microseconds(time_ns: int) -> str:
    """Microseconds with three digits: decimal text keeps each nanosecond, a float would not."""
    return f"{time_ns // 1000}.{time_ns % 1000:03d}"


def closed_at(level: int, *, on_bias_ns: int = 0) -> DeviceProfile:
    """Return the device whose output rests at a level, for a text that is read back."""
    return DeviceProfile(name="generic", closed_level=level, on_bias_ns=on_bias_ns)


def item_rows(items: Sequence[object], *, per_line: int, indent: str = "    ") -> str:
    """Lay the items of an array out in lines, with commas between."""
    texts = [str(item) for item in items]
    rows = [", ".join(texts[k : k + per_line]) for k in range(0, len(texts), per_line)]
    return ",\n".join(f"{indent}{row}" for row in rows)


def hex_rows(packed: bytes, *, per_line: int, indent: str) -> str:
    """Lay bytes out as an array."""
    items = [f"0x{byte:02x}" for byte in packed]
    return item_rows(items, per_line=per_line, indent=indent)


def packed_bytes(items: str, *, item: str) -> bytes:
    """Read ``0x0f, 0xa5, ...`` as bytes."""
    numbers = [number.strip() for number in items.split(",")]
    for number in numbers:
        if not re.fullmatch(r"0x[0-9a-f]{2}", number):
            raise ValueError(f"{item} has {number[:20]!r}: bytes like 0xa5 are needed")
    return bytes(int(number, 16) for number in numbers)
