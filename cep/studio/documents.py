"""Documents that a page opens: motions, codes, studio files and gyroscope recordings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import cep
from cep.files.code_files import StoredCode, read_code, stored_device
from cep.files.formatting import seconds_of
from cep.studio.fields import FieldError, nameless
from cep.studio.motions import described_paths
from cep.studio.state import read_state, saved_setting
from cep.studio.views import STUDIO_SCHEMA, Views
from hw.device import load_profile, profile_names
from motdiff.files.json_files import fault, json_text, load_schema, read_versioned, stated_schema
from motdiff.files.outputs import claim_folder, new_folder, write_text
from motdiff.files.trajectories import read_motion, stated_uncertainty_px
from motdiff.gyro import DEFAULT_AXES, trajectory_from_gyro
from motdiff.trajectory import check_length

EXTRACTED = ("trajectory.json", "code.json", "commands.sh")  # by extract
_PATH_PX = 0.01  # by which a motion may differ that another version of the library drew


def read_document(path: Path | str) -> dict[str, Any]:
    """Read a document that a page has saved, and check it against its schema."""
    document = read_versioned(path, STUDIO_SCHEMA)
    if (wrong := fault(document, load_schema("cep.files", "studio"))) is not None:
        raise ValueError(f"{path}: {wrong}")
    return document


def opened_document(file: Path) -> dict[str, Any]:
    """Return the fields of a document: ``paths`` of a motion, ``bits`` of a code, or a ``state``.

    With the bits comes ``device``, the name of the shutter they were searched for, or a
    ``warning`` where it has none.
    """
    schema = stated_schema(file)
    try:
        if schema == "cep.trajectory/1":
            stored = read_motion(file)
            weights, paths = zip(
                (stored.weight, stored.trajectory), *stored.alternatives, strict=True
            )
            return {
                "paths": described_paths(weights, paths),
                "path_error": stated_uncertainty_px(stored, file),
            }
        if schema == "cep.code/1":
            return _opened_code(read_code(file))
        if schema == STUDIO_SCHEMA:
            return {"state": stored_state(file)}
    except (ValueError, OSError) as error:
        raise FieldError("open_file", nameless(error, file)) from None
    raise FieldError("open_file", "the file is no trajectory.json, code.json or studio.json")


def opened_gyro(file: Path, query: Mapping[str, str]) -> dict[str, Any]:
    """Return the motion of one exposure of a gyroscope recording.

    Parameters
    ----------
    query : mapping
        ``focal`` px, ``start`` s, ``exposure`` s and ``axes``, the directions of the recording's
        axes.
    """
    numbers = {}
    for name, parse in (("focal", float), ("start", float), ("exposure", seconds_of)):
        try:
            numbers[name] = parse(query.get(name, ""))
        except ValueError as error:
            reason = "a number is needed"
            if parse is seconds_of:
                reason = str(error).removeprefix("exposure: ")
            raise FieldError(f"gyro_{name}", reason) from None
    axes = query.get("axes", DEFAULT_AXES)
    try:
        trace = cep.read_gyro(file)
        path = trajectory_from_gyro(
            trace,
            focal_px=numbers["focal"],
            start_s=numbers["start"],
            exposure_s=numbers["exposure"],
            axes=axes,
        )
        check_length(path)
    except ValueError as error:
        field = "gyro_axes" if str(error).startswith("axes: ") else "gyro"
        raise FieldError(field, nameless(error, file).removeprefix("axes: ")) from None
    read = f"{trace.columns}; axes: {axes}"
    warnings = [read, *(line.removeprefix(f"{file}: ") for line in trace.warnings)]
    return {"paths": described_paths([1.0], [path]), "warnings": warnings}


def extract(file: Path, folder: Path, *, force: bool = False) -> list[Path]:
    """Write the motion, the code and the command lines of a studio file, all or none.

    All three are made from the file's state: whoever sent the file wrote its command lines, which
    a shell would run.

    ValueError if the file is no studio file, its trajectory or code is not the one of its state,
    or the folder holds such files and ``force`` is not given.
    """
    document = read_document(file)
    state = _checked(document["state"], file)
    claim_folder(folder, EXTRACTED, force=force)
    try:
        saved = Views().saved(saved_setting(state), state)
    except FieldError as error:
        raise ValueError(f"{file}: state.{error.field}: {error}") from None
    if (wrong := _difference(document, saved)) is not None:
        raise ValueError(f"{file}: {wrong}")
    with new_folder(folder, EXTRACTED, force=force) as temporary:
        write_text(temporary / "trajectory.json", json_text(saved["trajectory"]))
        write_text(temporary / "code.json", json_text(saved["code"]))
        commands = "".join(f"{line}\n" for line in saved["commands"])
        write_text(temporary / "commands.sh", commands)
    return [folder / name for name in EXTRACTED]


def _opened_code(stored: StoredCode) -> dict[str, Any]:
    # whole ns, which no rounding changes on the way
    fields = {"bits": stored.code.bits, "exposure": f"{stored.code.duration_ns:d}ns"}
    profile = stored_device(stored, source="the file")
    if profile is None:
        return fields
    name = next((name for name in profile_names() if load_profile(name) == profile), None)
    if name is not None:
        return {**fields, "device": name}
    warning = (
        f"its code was searched for the shutter {profile.name}, whose limits the studio cannot"
        " check: use cep export"
    )
    return {**fields, "device": "", "warning": warning}


def stored_state(file: Path) -> dict[str, Any]:
    """Read the state of a page out of a studio file; ValueError where it is none."""
    return _checked(read_document(file)["state"], file)


def _checked(state: object, file: Path) -> dict[str, Any]:
    try:
        return read_state(state)
    except FieldError as error:
        raise ValueError(f"{file}: state.{error.field}: {error}") from None


def _difference(document: Mapping[str, Any], saved: Mapping[str, Any]) -> str | None:
    """Say where the trajectory or the code of a studio file is not the one of its state."""
    advice = "save it in the studio again"
    path = document.get("trajectory", saved["trajectory"])
    code = document.get("code", saved["code"])
    for name in "txy":
        samples = np.array(path.get(name, []), dtype=np.float64)
        own_samples = np.array(saved["trajectory"][name])
        if samples.shape != own_samples.shape or np.abs(samples - own_samples).max() > _PATH_PX:
            return f"trajectory.{name}: is not that of the state's motion; {advice}"
    if path.get("direction", "unknown") != saved["trajectory"]["direction"]:
        return f"trajectory.direction: is not that of the state's motion; {advice}"
    for name in ("bits", "chip_ns"):
        if code.get(name) != saved["code"][name]:
            return f"code.{name}: is not that of the state's code; {advice}"
    problem = code.get("problem")
    if isinstance(problem, dict) and problem.get("device") not in (
        None,
        saved["code"]["problem"].get("device"),
    ):
        return f"code.problem.device: is not the state's shutter; {advice}"
    return None
