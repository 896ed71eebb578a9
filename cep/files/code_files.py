"""Code files, ``code.json``: bits and chip time, with figures, problem and certificate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.scene import PHOTO, Scene
from hw.device import DeviceProfile, load_profile
from motdiff.files.inputs import one_line
from motdiff.files.json_files import fault, json_text, load_schema, read_versioned
from motdiff.files.outputs import write_text

CODE_SCHEMA = "cep.code/1"


@dataclass(frozen=True)
class StoredCode:
    """Content of a code file.

    Attributes
    ----------
    code : ShutterCode
    metrics : mapping
        Figures of :func:`cep.proofs.measure.measure`.
    problem : mapping
        Search problem: trajectory, limits, objective, seed.
    certificate : mapping
        Proof of the minimum, where there is one.
    """

    code: ShutterCode
    metrics: Mapping[str, Any] = field(default_factory=dict)
    problem: Mapping[str, Any] = field(default_factory=dict)
    certificate: Mapping[str, Any] = field(default_factory=dict)


def write_code(path: Path | str, stored: StoredCode) -> None:
    """Write ``stored`` as JSON (schema ``cep.code/1``), whole or not at all."""
    write_text(path, json_text(code_document(stored)))


def code_document(stored: StoredCode) -> dict[str, Any]:
    """Return the content of a code file."""
    return {
        "schema": CODE_SCHEMA,
        "bits": stored.code.bits,
        "chip_ns": stored.code.chip_ns,
        "metrics": stored.metrics,
        "problem": stored.problem,
        "certificate": stored.certificate,
    }


def read_code(path: Path | str) -> StoredCode:
    """Read a code file; a ValueError names the file where it is none."""
    document = read_versioned(path, CODE_SCHEMA)
    bits: Any = document.get("bits")
    chip_ns: Any = document.get("chip_ns")
    if isinstance(chip_ns, float) and chip_ns.is_integer():
        chip_ns = int(chip_ns)  # as some programs write whole numbers
    try:
        if isinstance(bits, str) and "chip_ns" in document:
            ShutterCode(bits, chip_ns)
    except (TypeError, ValueError) as error:  # says which chip is wrong, as a schema cannot
        raise ValueError(f"{path}: {one_line(error)}") from None
    if (wrong := fault(document, load_schema("cep.files", "code"))) is not None:
        raise ValueError(f"{path}: {wrong}")
    about = (document.get(name) or {} for name in ("metrics", "problem", "certificate"))
    return StoredCode(ShutterCode(bits, chip_ns), *about)


def stored_device(stored: StoredCode, *, source: str) -> DeviceProfile | None:
    """Return the profile of the shutter that a code was searched for, None where there is none.

    Parameters
    ----------
    source : str
        Its file, for messages.
    """
    device = stored.problem.get("device")
    if device is None:
        return None
    try:
        if isinstance(device, str):
            return load_profile(device)
        return DeviceProfile.from_dict(device, source="its device")
    except ValueError as error:
        raise ValueError(
            f"{source}: {error}; --device NAME|FILE says which shutter it is for"
        ) from None


def stored_camera(stored: StoredCode, *, source: str) -> Camera | None:
    """Return the camera that a code was searched for, None where its file has none.

    Parameters
    ----------
    source : str
        Its file, for messages.
    """
    document = stored.problem.get("camera")
    if document is None:
        return None
    try:
        if not isinstance(document, dict):
            raise ValueError(f"must be an object, got {type(document).__name__}")
        return Camera.from_dict(document)
    except ValueError as error:
        raise ValueError(f"{source}: problem.camera: {error}; --camera names another") from None


def stored_scene(stored: StoredCode) -> Scene:
    """Return the scene that a code was searched for; photographs where its file has none."""
    document = stored.problem.get("scene")
    return PHOTO if document is None else Scene(**document)  # checked where the file was read
