"""A timed shutter program: chips of equal length on an integer-nanosecond clock."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby

MAX_CHIP_NS = 2**63 - 1
"""Longest chip, ns."""


@dataclass(frozen=True, slots=True)
class Program:
    """A binary shutter code with its chip time, as a shutter plays it.

    All times are integer nanoseconds, so that no exporter and no device ever rounds an edge. The
    shutter is closed before time 0 and after the last chip.

    Parameters
    ----------
    bits : str
        One character per chip, ``"1"`` open and ``"0"`` closed, in playing order; at least one
        chip is open.
    chip_ns : int
        Duration of one chip in nanoseconds, 1..2^63 - 1.

    Raises
    ------
    ValueError
        If `bits` is empty, has other characters or no open chip, or if `chip_ns` is not a positive
        integer.

    Examples
    --------
    >>> program = Program("1101", chip_ns=200_000)
    >>> program.edges
    ((0, 1), (400000, 0), (600000, 1), (800000, 0))
    >>> program.runs
    ((1, 400000), (0, 200000), (1, 200000))
    """

    bits: str
    chip_ns: int

    def __post_init__(self) -> None:
        if not isinstance(self.bits, str):
            raise ValueError(f"bits is a {type(self.bits).__name__}: pass a str of 0 and 1")
        if not self.bits:
            raise ValueError("bits is empty: a shutter code needs at least one chip")
        for index, character in enumerate(self.bits):
            if character not in "01":
                raise ValueError(
                    f"bits has {character!r} at chip {index}: only 0 (closed) and 1 (open) can be"
                    " played"
                )
        if "1" not in self.bits:
            raise ValueError(
                f"bits has no open chip among {len(self.bits)}: at least one must be 1"
            )
        # True is an int in Python, and would be a chip of 1 ns.
        if isinstance(self.chip_ns, bool) or not isinstance(self.chip_ns, int):
            raise ValueError(
                f"chip_ns is {self.chip_ns!r}: it must be a whole number of nanoseconds (an int)"
            )
        if not 0 < self.chip_ns <= MAX_CHIP_NS:
            raise ValueError(
                f"chip_ns is {self.chip_ns:.6g} ns: it must be at least 1 and below 2^63"
            )

    @classmethod
    def from_edges(cls, edges: Iterable[tuple[int, int]], *, chip_ns: int, chips: int) -> Program:
        """Make a program from its edges, the inverse of `edges`.

        Parameters
        ----------
        edges : iterable of (time_ns, level)
            Strictly increasing times on the chip grid; levels alternate and begin with an opening.
            The shutter is closed again at ``chips * chip_ns`` at the latest.
        chip_ns : int
            Chip time in nanoseconds.
        chips : int
            Number of chips; trailing closed chips are in no edge, hence it is a parameter.

        Raises
        ------
        ValueError
            If a time is off the grid, out of order or out of range, a level repeats, or the
            shutter stays open.
        """
        if chip_ns < 1 or chips < 1:
            raise ValueError(f"chip_ns is {chip_ns} and chips is {chips}: both must be at least 1")
        runs: list[str] = []
        chips_done = 0
        level = 0
        for index, (time_ns, new_level) in enumerate(edges):
            chip, remainder = divmod(time_ns, chip_ns)
            if remainder:
                raise ValueError(
                    f"edge {index} at {time_ns} ns is off the grid: times must be multiples of"
                    f" {chip_ns} ns"
                )
            if new_level != 1 - level:
                raise ValueError(
                    f"edge {index} has level {new_level}: {1 - level} must follow {level}"
                )
            # An opening at time 0 is the only edge on a chip already reached.
            if chip < chips_done or (index and chip == chips_done):
                raise ValueError(
                    f"edge {index} at {time_ns} ns is out of order: times must increase from 0"
                )
            if chip > chips or (new_level and chip == chips):
                raise ValueError(
                    f"edge {index} at {time_ns} ns is past the end: {chips} chips last"
                    f" {chips * chip_ns} ns"
                )
            runs.append(str(level) * (chip - chips_done))
            chips_done = chip
            level = new_level
        if level:
            raise ValueError(
                f"edges leave the shutter open: the last one must close it by {chips * chip_ns} ns"
            )
        runs.append("0" * (chips - chips_done))
        return cls("".join(runs), chip_ns)

    @classmethod
    def from_bytes(cls, packed: bytes, *, chips: int, chip_ns: int) -> Program:
        """Make a program from MSB-first bytes, the inverse of `to_bytes`; padding is 0."""
        if chips < 1 or len(packed) != (chips + 7) // 8:
            raise ValueError(
                f"packed has {len(packed)} bytes: {chips} chips take {max(chips + 7, 0) // 8}, and"
                " at least 1"
            )
        bits = "".join(f"{byte:08b}" for byte in packed)
        if "1" in bits[chips:]:
            raise ValueError(f"packed has open padding: the bits after chip {chips - 1} must be 0")
        return cls(bits[:chips], chip_ns)

    def to_bytes(self) -> bytes:
        """Chips packed eight to a byte, first chip in the highest bit, padded with 0."""
        size = (self.chips + 7) // 8
        return bytes(int(self.bits[8 * k : 8 * k + 8].ljust(8, "0"), 2) for k in range(size))

    @property
    def chips(self) -> int:
        """Number of chips."""
        return len(self.bits)

    @property
    def runs(self) -> tuple[tuple[int, int], ...]:
        """Stretches of equal level as (level, duration_ns); durations sum to `duration_ns`."""
        return tuple(
            (int(level), self.chip_ns * sum(1 for _ in same)) for level, same in groupby(self.bits)
        )

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """Changes of level as (time_ns, level), starting from closed and ending closed."""
        edges: list[tuple[int, int]] = []
        time_ns = 0
        level = 0
        for new_level, length_ns in self.runs:
            if new_level != level:
                edges.append((time_ns, new_level))
            time_ns = time_ns + length_ns
            level = new_level
        if level:
            edges.append((time_ns, 0))
        return tuple(edges)

    @property
    def duration_ns(self) -> int:
        """Length of the whole program, trailing closed chips included."""
        return self.chips * self.chip_ns

    @property
    def open_ns(self) -> int:
        """Time the shutter is open."""
        return self.bits.count("1") * self.chip_ns

    @property
    def duty(self) -> float:
        """Open fraction of the time, 0..1."""
        return self.bits.count("1") / self.chips

    @property
    def pulses(self) -> int:
        """Number of openings: runs of open chips."""
        return len(self.edges) // 2

    @property
    def code_crc32(self) -> int:
        """CRC-32 (zlib) over chip_ns (u64) and chips (u32), little endian, and `to_bytes`."""
        return zlib.crc32(struct.pack("<QI", self.chip_ns, self.chips) + self.to_bytes())
