"""A program in a device's ticks: the payload of LOAD and READ (``docs/cxp1.md``)."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from fractions import Fraction

from hw.cxp.framing import FrameError
from hw.cxp.protocol import Hello
from hw.program import Program

_STORED = struct.Struct("<IHH")


@dataclass(frozen=True, slots=True)
class Stored:
    """A program as a device stores it: `bits`, each for ``ticks + fraction / 65536`` ticks of the
    device.
    """

    bits: str
    ticks: int
    fraction: int

    @property
    def payload(self) -> bytes:
        """Payload of LOAD, and data of READ."""
        packed = Program(self.bits, 1).to_bytes()
        return _STORED.pack(self.ticks, self.fraction, len(self.bits)) + packed

    @property
    def crc32(self) -> int:
        """CRC-32 of `payload`, as the device computes it."""
        return zlib.crc32(self.payload)

    @property
    def chip_ticks(self) -> Fraction:
        """Exact chip time, ticks."""
        return self.ticks + Fraction(self.fraction, 65536)

    def difference(self, other: Stored) -> str:
        """Describe how `other` differs, in a few words; empty when they are equal."""
        if self.chip_ticks != other.chip_ticks:
            return f"chip of {float(other.chip_ticks):.7g} ticks, not {float(self.chip_ticks):.7g}"
        if len(self.bits) != len(other.bits):
            return f"{len(other.bits)} chips, not {len(self.bits)}"
        wrong = [k for k, (a, b) in enumerate(zip(self.bits, other.bits, strict=True)) if a != b]
        return (
            f"{len(wrong)} of {len(self.bits)} chips differ, the first is chip {wrong[0]}"
            if wrong
            else ""
        )


def stored_program(program: Program, hello: Hello, *, clock_ppm: float = 0.0) -> Stored:
    """Express a program in a device's ticks.

    Parameters
    ----------
    program : Program
    hello : Hello
        HELLO of the device.
    clock_ppm : float
        Error of the device's clock, parts per million, positive when fast: chips are stretched by
        as much, to the nearest fraction of a tick when the device takes fractions, or else to the
        nearest tick. With 0 the chip must be a whole number of ticks.

    Raises
    ------
    ValueError
        If the chip is not a whole number of ticks, or out of the device's range, or there are too
        many chips.
    """
    if not abs(clock_ppm) <= 100_000:
        raise ValueError(
            f"clock_ppm is {clock_ppm}: a clock is off by at most 100000 ppm, anything else is not"
            " its clock"
        )
    exact = Fraction(program.chip_ns, hello.tick_ns) * (1 + Fraction(clock_ppm) / 10**6)
    units = round(exact * 65536) if hello.fractions else round(exact) * 65536
    ticks, fraction = divmod(units, 65536)
    if not clock_ppm and program.chip_ns % hello.tick_ns:
        raise ValueError(
            f"chip of {program.chip_ns} ns is not a whole number of the device's {hello.tick_ns}"
            " ns ticks"
        )
    if not hello.min_ticks <= ticks <= hello.max_ticks - (fraction > 0):
        least = hello.min_ticks * hello.tick_ns
        most = hello.max_ticks * hello.tick_ns
        raise ValueError(
            f"chip of {program.chip_ns} ns cannot be played: the device takes {least} to {most} ns"
        )
    if program.chips > hello.max_chips:
        raise ValueError(
            f"code of {program.chips} chips is too long: the device plays at most"
            f" {hello.max_chips}"
        )
    return Stored(program.bits, ticks, fraction)


def unpack_stored(data: bytes) -> Stored:
    """Parse the data of READ.

    Raises
    ------
    FrameError
        If lengths disagree or it is no program.
    """
    if len(data) <= _STORED.size:
        raise FrameError(
            f"READ reply has {len(data)} bytes: at least {_STORED.size + 1} are needed"
        )
    ticks, fraction, chips = _STORED.unpack_from(data)
    try:
        return Stored(
            Program.from_bytes(data[_STORED.size :], chips=chips, chip_ns=1).bits, ticks, fraction
        )
    except ValueError as error:
        raise FrameError(f"READ reply holds no program: {error}") from None
