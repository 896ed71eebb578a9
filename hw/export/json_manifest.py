"""JSON manifest: the code, its timing and its edges, for scripts of users."""

from __future__ import annotations

import json

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter
from hw.program import Program


class JsonManifest(Exporter):
    """The code, its timing, runs and edges as one JSON object."""

    name = "json"
    suffix = ".json"
    stem_suffix = ".program"  # a code is JSON too
    summary = "code, timing, runs and edges for one's own scripts"
    needs = "scripts of users"
    manual = "hw.program/1: cep/files/schemas/program.json"

    def export(self, program: Program, _device: DeviceProfile = GENERIC, /) -> str:
        """Write the program as one JSON object of schema ``hw.program/1``."""
        manifest = {
            "schema": "hw.program/1",
            "bits": program.bits,
            "chip_ns": program.chip_ns,
            "chips": program.chips,
            "duration_ns": program.duration_ns,
            "open_ns": program.open_ns,
            "pulses": program.pulses,
            "code_crc32": f"0x{program.code_crc32:08x}",
            "runs": [list(run) for run in program.runs],
            "edges": [list(edge) for edge in program.edges],
        }
        return json.dumps(manifest, indent=1) + "\n"

    def parse_back(self, text: str, /) -> Program:
        """Read the program back from the edges."""
        manifest = json.loads(text)
        return Program.from_edges(
            manifest["edges"], chip_ns=manifest["chip_ns"], chips=manifest["chips"]
        )
