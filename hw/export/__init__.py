"""Exporters: a shutter program as a text file, each with a `parse_back` to the identical program."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

from hw.export import c_header, csv_edges, json_manifest
from hw.program import Program

__all__ = ["EXPORTERS", "Exporter", "exporter"]


class Exporter(Protocol):
    """What an export module offers; one module per format."""

    @property
    def suffix(self) -> str:
        """File suffix with its dot."""

    def export(self, program: Program, /) -> str:
        """Write the program as text."""

    def parse_back(self, text: str, /) -> Program:
        """Read the text back to the identical program; ValueError in one line when it was altered."""


EXPORTERS: Mapping[str, Exporter] = MappingProxyType({"c": c_header, "csv": csv_edges, "json": json_manifest})
"""Format name to exporter."""


def exporter(name: str) -> Exporter:
    """Find the exporter of a format.

    Raises
    ------
    ValueError
        If the format is unknown.
    """
    try:
        return EXPORTERS[name]
    except KeyError:
        raise ValueError(f"export format {name!r} is unknown: known are {', '.join(EXPORTERS)}") from None
