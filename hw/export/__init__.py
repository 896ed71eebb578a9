"""Exporters: a shutter program as a text file, and read back from it to the identical program."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

from hw.device import DeviceProfile
from hw.export import (
    arduino,
    c_header,
    camera,
    csv_edges,
    dmd,
    json_manifest,
    pulsepal,
    rp2_script,
    scpi,
    vcd,
)
from hw.export._text import GENERIC
from hw.program import Program

__all__ = ["EXPORTERS", "Exporter", "export_program", "file_name", "find_exporter"]


class Exporter(Protocol):
    """Protocol of the export modules; one module per format."""

    @property
    def suffix(self) -> str:
        """File suffix with its dot."""

    @property
    def summary(self) -> str:
        """Description of the file, in a few words."""

    @property
    def tick_ns(self) -> int:
        """Unit of the chip times that the format can represent, ns."""

    def export(self, program: Program, device: DeviceProfile = ..., /) -> str:
        """Write the program as text; ValueError when the format cannot represent it."""

    def parse_back(self, text: str, /) -> Program:
        """Read the text back to the identical program; ValueError in one line when it was
        altered.
        """


EXPORTERS: Mapping[str, Exporter] = MappingProxyType(
    {
        "csv": csv_edges,
        "json": json_manifest,
        "vcd": vcd,
        "c": c_header,
        "arduino": arduino,
        "rp2": rp2_script,
        "pulsepal": pulsepal,
        "scpi": scpi,
        "camera": camera,
        "dmd": dmd,
    }
)
"""Format name to exporter."""


def find_exporter(file_format: str) -> Exporter:
    """Return the exporter of a format; ValueError when :data:`EXPORTERS` has none of that name."""
    if file_format not in EXPORTERS:
        raise ValueError(
            f"file_format: must be one of {', '.join(EXPORTERS)}, got {file_format[:40]!r}"
        )
    return EXPORTERS[file_format]


def file_name(stem: str, file_format: str) -> str:
    """Name the file of a code in a format.

    Examples
    --------
    >>> file_name("code", "csv"), file_name("code", "json")
    ('code.csv', 'code.program.json')
    """
    suffix = find_exporter(file_format).suffix
    # a code is JSON too, and a code.py would hide Python's own module from whatever runs beside it
    return stem + {".json": ".program", ".py": "_rp2"}.get(suffix, "") + suffix


def export_program(
    program: Program, file_format: str, *, device: DeviceProfile | None = None
) -> str:
    """Write a program as text, and read the text back to prove its edges.

    Parameters
    ----------
    program : Program
    file_format : str
        A name of :data:`EXPORTERS`.
    device : DeviceProfile, optional
        Shutter that the text is for; one that is closed at level 0 and adds nothing to an opening
        when omitted.

    Returns
    -------
    str, the content of the file

    Raises
    ------
    ValueError
        If the format is not known, or cannot represent the program.
    RuntimeError
        If the text read back has other edges, which is an error of the exporter.

    Examples
    --------
    >>> print(export_program(Program.from_bits("101", chip_ns=1000), "csv").rstrip())
    # format: hw.csv/1
    # chip_ns: 1000
    # chips: 3
    # code_crc32: 0x1d06616e
    time_us,level
    0.000,1
    1.000,0
    2.000,1
    3.000,0
    """
    exporter = find_exporter(file_format)
    text = exporter.export(program, device or GENERIC)
    if exporter.parse_back(text) != program:
        raise RuntimeError(f"{file_format}: reading the text back gave other edges")
    return text
