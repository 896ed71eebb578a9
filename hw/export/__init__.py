"""Exporters: a shutter program as a text file, and read back from it to the identical program."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module

from hw.device import DeviceProfile
from hw.export.base import EXPORTERS, GENERIC, Exporter
from hw.program import Program

__all__ = ["EXPORTERS", "Exporter", "export_program", "find_exporter"]

_MODULES = (
    "csv_edges",
    "json_manifest",
    "vcd",
    "c_header",
    "arduino",
    "rp2_script",
    "pulse_pal",
    "scpi",
    "camera",
    "dmd",
)
"""One line a format: its module, in the order of every list. The class enters itself."""

for _module in _MODULES:
    import_module(f"hw.export.{_module}")


def find_exporter(file_format: str) -> Exporter:
    """Return the exporter of a format; ValueError when :data:`EXPORTERS` has none of that name."""
    if file_format not in EXPORTERS:
        raise ValueError(
            f"file_format: must be one of {', '.join(EXPORTERS)}, got {file_format[:40]!r}"
        )
    return EXPORTERS[file_format]


def export_program(
    program: Program, file_format: str, *, device: DeviceProfile | None = None
) -> str:
    """Write a program as text, and read the text back to prove its edges.

    Parameters
    ----------
    file_format : str
        A name of :data:`EXPORTERS`.
    device : DeviceProfile, optional
        Shutter that the text is for; :data:`hw.export.base.GENERIC` when omitted.

    Raises
    ------
    ValueError
        If the format is not known, or cannot represent the program.
    RuntimeError
        If the text read back has other edges, which is an error of the exporter.

    Examples
    --------
    >>> print(export_program(Program("101", chip_ns=1000), "csv").rstrip())
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
    # A wrong edge must stop here, not at the shutter.
    same = False
    with suppress(ValueError):  # no edges of any program
        same = exporter.parse_back(text) == program
    if not same:
        raise RuntimeError(f"{file_format}: reading the text back gave other edges")
    return text
