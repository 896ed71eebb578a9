"""JSON manifest: the code, its timing and its edges, for scripts of users."""

from __future__ import annotations

import json
from typing import Any

from hw.device import DeviceProfile
from hw.export.base import GENERIC, Exporter
from hw.program import Program

_SCHEMA = "hw.program/1"


class JsonManifest(Exporter):
    """The code, its timing, runs and edges as one JSON object."""

    name = "json"
    suffix = ".json"
    stem_suffix = ".program"  # a code is JSON too
    summary = "code, timing, runs and edges for one's own scripts"
    needs = "scripts of users"
    manual = "hw.program/1: cep/files/schemas/program.json"
    label = "JSON"

    def export(self, program: Program, _device: DeviceProfile = GENERIC, /) -> str:
        """Write the program as one JSON object of schema ``hw.program/1``."""
        return json.dumps(_manifest(program), indent=1) + "\n"

    def parse_back(self, text: str, /) -> Program:
        """Read the program back; every derived field must agree with the code.

        Raises
        ------
        ValueError
            If the text is not JSON, has another schema, lacks a field, or contradicts itself.
        """
        try:
            manifest = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ValueError(
                f"JSON cannot be read: {' '.join(str(error).split())[:120]}"
            ) from None
        if not isinstance(manifest, dict):
            raise ValueError(
                f"JSON holds a {type(manifest).__name__}: an object of schema {_SCHEMA!r} is needed"
            )
        if manifest.get("schema") != _SCHEMA:
            raise ValueError(
                f"JSON has schema {str(manifest.get('schema'))[:40]!r}: {_SCHEMA!r} is needed"
            )
        for key in ("bits", "chip_ns", "code_crc32"):
            if key not in manifest:
                raise ValueError(
                    f"JSON has no field {key!r}: bits, chip_ns and code_crc32 are needed"
                )
        if not isinstance(manifest["bits"], str):
            raise ValueError(
                f"JSON bits is a {type(manifest['bits']).__name__}: a string of 0 and 1 is needed"
            )
        program = Program(manifest["bits"], manifest["chip_ns"])
        self.verified(program, str(manifest["code_crc32"]))
        # Scripts may use any of the derived fields: none may contradict the code.
        for key, value in _manifest(program).items():
            # Compared as text: in Python True == 1 == 1.0, in the file they differ.
            if key in manifest and json.dumps(manifest[key]) != json.dumps(value):
                raise ValueError(
                    f"JSON field {key!r} disagrees with its bits and chip_ns: it was altered, export"
                    " again"
                )
            if key not in manifest:
                raise ValueError(f"JSON has no field {key!r}: schema {_SCHEMA!r} needs it")
        return program


def _manifest(program: Program) -> dict[str, Any]:
    return {
        "schema": _SCHEMA,
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
