"""Exporters: a shutter program as a text file, each with a `parse_back` to the identical program."""

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
from hw.program import Program

__all__ = ["EXPORTERS", "Exporter"]


class Exporter(Protocol):
    """Protocol of the export modules; one module per format."""

    @property
    def suffix(self) -> str:
        """File suffix with its dot."""

    @property
    def summary(self) -> str:
        """Description of the file, in a few words."""

    def export(self, program: Program, device: DeviceProfile = ..., /) -> str:
        """Write the program as text; ValueError when the format cannot represent it."""

    def parse_back(self, text: str, /) -> Program:
        """Read the text back to the identical program; ValueError in one line when it was altered."""


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
