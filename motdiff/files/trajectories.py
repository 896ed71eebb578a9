"""``trajectory.json``: a motion, its alternatives and their source (``cep.trajectory/1``)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from motdiff.files.inputs import one_line
from motdiff.files.json_files import fault, load_schema, read_versioned
from motdiff.files.outputs import write_text
from motdiff.trajectory import Direction, Trajectory, check_length

SCHEMA = "cep.trajectory/1"
_FARTHEST_PX = 1e5
_DENSE = 2000  # samples; work on a path grows with their number
_THINNED_PX = 1e-4  # changes an OTF by at most 3e-4, at 0.5 cycles/px


@dataclass(frozen=True)
class StoredMotion:
    """Content of a trajectory file.

    Attributes
    ----------
    trajectory : Trajectory
        The most likely motion.
    weight : float
        Its probability.
    alternatives : tuple of (weight, Trajectory)
        Other motions that explain the photo.
    source : mapping
        ``method``, ``image``, ``seed`` of the estimate.
    """

    trajectory: Trajectory
    weight: float = 1.0
    alternatives: tuple[tuple[float, Trajectory], ...] = ()
    source: Mapping[str, object] = field(default_factory=dict)


def write_motion(path: Path | str, motion: StoredMotion) -> None:
    """Write ``motion`` as JSON, whole or not at all."""
    document = {
        **_document(motion.trajectory),
        "weight": motion.weight,
        "alternatives": [
            {"weight": weight, **_samples(path)} for weight, path in motion.alternatives
        ],
        "source": dict(motion.source),
    }
    write_text(path, json.dumps(document, indent=1) + "\n")


def trajectory_text(trajectory: Trajectory) -> str:
    """Write a path as one line of JSON, which is a trajectory file by itself."""
    return json.dumps(_document(trajectory), separators=(",", ":"))


def read_motion(path: Path | str) -> StoredMotion:
    """Read a trajectory file; long paths are thinned to within 1e-4 px at any time.

    Raises
    ------
    ValueError
        If the file is not JSON, not of this schema, or its samples are not a trajectory, or one
        longer than :data:`motdiff.trajectory.LONGEST_PX`; the line names the file.
    OSError
        If the file cannot be read.
    """
    document = read_versioned(path, SCHEMA)
    try:
        return parse_motion(document)
    except ValueError as error:
        raise ValueError(f"{path}: {one_line(error)}") from None


def parse_motion(document: Mapping[str, Any]) -> StoredMotion:
    """Make a motion of its file's content; a ValueError says what is wrong."""
    if (wrong := fault(document, load_schema("motdiff.files", "trajectory"))) is not None:
        raise ValueError(wrong)
    direction = cast(Direction, document.get("direction", "unknown"))
    alternatives = tuple(
        (float(fields.get("weight", 1.0)), _trajectory(fields, direction))
        for fields in document.get("alternatives", [])
    )
    main = _trajectory(document, direction)
    weight = float(document.get("weight", 1.0))
    return StoredMotion(main, weight, alternatives, document.get("source", {}))


def stated_uncertainty_px(motion: StoredMotion, path: Path | str) -> float | None:
    """Return the expected error of a stored motion, px rms over time; None if not stated.

    Parameters
    ----------
    path : path
        Its file, for the error.

    Raises
    ------
    ValueError
        If it is no number above 0.
    """
    uncertainty_px = motion.source.get("path_uncertainty_px")
    if uncertainty_px is None:
        return None
    if (
        not isinstance(uncertainty_px, int | float)
        or isinstance(uncertainty_px, bool)
        or not 0 < uncertainty_px < _FARTHEST_PX
    ):
        raise ValueError(
            f"{path}: source path_uncertainty_px must be a number of px above 0, got"
            f" {one_line(repr(uncertainty_px))}"
        )
    return float(uncertainty_px)


def _document(trajectory: Trajectory) -> dict[str, object]:
    about = {"schema": SCHEMA, "units": "px", "direction": trajectory.direction}
    return {**about, **_samples(trajectory)}


def _samples(trajectory: Trajectory) -> dict[str, list[float]]:
    return {"t": trajectory.t.tolist(), "x": trajectory.x.tolist(), "y": trajectory.y.tolist()}


def _trajectory(fields: Mapping[str, Any], direction: Direction) -> Trajectory:
    columns: list[Sequence[float]] = [fields["t"], fields["x"], fields["y"]]
    if len({len(column) for column in columns}) != 1:
        raise ValueError(
            f"t, x and y must be equally long, got {[len(column) for column in columns]}"
        )
    t, x, y = (np.array(column, dtype=np.float64) for column in columns)
    exact = Trajectory.from_samples(np.column_stack([x, y]), t=t, direction=direction)
    if t[0] != 0 or t[-1] != 1:
        raise ValueError(f"t must run from 0 to 1, got {t[0]:g} to {t[-1]:g}")
    check_length(exact)
    # a recording at 1 kHz has more samples than its path needs
    if len(t) > _DENSE:
        return exact.thinned(_THINNED_PX)
    return exact
