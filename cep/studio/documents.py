"""Documents that a page opens: motions, codes and studio files, and gyroscope recordings, as the page keeps them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cep
from cep.io.files import StoredCode, json_text, read_code, read_json, stored_device
from cep.io.outputs import claim_folder, new_folder
from cep.studio.state import FieldError, path_fields
from cep.workflows.catalogue import shutter_name
from cep.workflows.motions import gyro_motion, stored_paths

__all__ = ["EXTRACTED", "extract", "opened_document", "opened_gyro"]

EXTRACTED = ("trajectory.json", "code.json", "commands.sh")
"""Files of :func:`extract`."""


def opened_document(file: Path) -> dict[str, Any]:
    """Return what of a document the page takes over: ``paths`` of a motion, ``bits`` of a code, or a whole ``state``.

    With the bits comes ``device``, the name of the shutter they were searched for, or a ``warning`` where it has none.

    Raises
    ------
    FieldError
        If it is none of these documents.
    """
    try:
        document = json.loads(file.read_bytes())
        schema = document.get("schema") if isinstance(document, dict) else None
    except (ValueError, RecursionError):
        schema = None
    try:
        if schema == "cep.trajectory/1":
            paths, error_px = stored_paths(file)
            described = [{"weight": weight, **_described(path)} for weight, path in paths]
            return {"paths": described, "path_error": error_px}
        if schema == "cep.code/1":
            return _opened_code(read_code(file))
        if schema == "cep.studio/1":
            state = read_json(file, schema="cep.studio/1").get("state")
            if isinstance(state, dict):
                return {"state": state}
    except (ValueError, OSError) as error:  # its name is the server's, and says nothing
        raise FieldError("open_file", str(error).replace(f"{file}: ", "").replace(str(file), "the file")) from None
    raise FieldError("open_file", "the file is no trajectory.json, code.json or studio.json")


def opened_gyro(file: Path, given: Mapping[str, str]) -> dict[str, Any]:
    """Return the motion of one exposure of a gyroscope recording.

    Parameters
    ----------
    file : Path
    given : mapping
        ``focal`` px, ``start`` s and ``exposure`` s.

    Raises
    ------
    FieldError
        If a number or the recording is wrong.
    """
    numbers = {}
    for name in ("focal", "start", "exposure"):
        try:
            numbers[name] = float(given.get(name, ""))
        except ValueError:
            raise FieldError(f"gyro_{name}", "a number is needed") from None
    try:
        path = gyro_motion(file, focal_px=numbers["focal"], start_s=numbers["start"], exposure_s=numbers["exposure"])
    except ValueError as error:
        raise FieldError("gyro", str(error).replace(f"{file}: ", "").replace(str(file), "the file")) from None
    return {"paths": [{"weight": 1.0, **_described(path)}]}


def extract(file: Path, folder: Path, *, force: bool = False) -> list[Path]:
    """Write the motion, the code and the command lines of a studio file, all or none.

    Raises
    ------
    ValueError
        If the file is no studio file, or the folder holds such files and ``force`` is not given.
    """
    document = read_json(file, schema="cep.studio/1")
    parts = {name: document.get(name.removesuffix(".json")) for name in EXTRACTED[:2]}
    commands = document.get("commands")
    if not all(isinstance(part, dict) for part in parts.values()) or not isinstance(commands, list):
        raise ValueError(f"{file}: needs trajectory, code and commands, as the studio saves them")
    claim_folder(folder, EXTRACTED, force=force)
    with new_folder(folder, EXTRACTED, force=force) as made:
        for name, part in parts.items():
            (made / name).write_text(json_text(part), encoding="utf-8")
        (made / EXTRACTED[2]).write_text("".join(f"{line}\n" for line in commands), encoding="utf-8")
    return [folder / name for name in EXTRACTED]


def _opened_code(stored: StoredCode) -> dict[str, Any]:
    found = {"bits": stored.code.bits, "exposure": f"{stored.code.duration_ns:d}ns"}
    profile = stored_device(stored, source="the file")
    if profile is None:
        return found
    name = shutter_name(profile)
    if name is not None:
        return {**found, "device": name}
    warning = (
        f"its code was searched for the shutter {profile.name}, whose limits the studio cannot check: use cep export"
    )
    return {**found, "device": "", "warning": warning}


def _described(path: cep.Trajectory) -> dict[str, Any]:
    return {"length_px": path.length_px, "extent_px": path.extent_px, **path_fields(path)}
