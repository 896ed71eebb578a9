"""``trajectory.json``: a motion with its alternatives and where it came from (schema ``cep.trajectory/1``)."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from motdiff.trajectory import Direction, Trajectory

__all__ = ["SCHEMA", "StoredMotion", "read_motion", "write_motion", "write_text_atomically"]

SCHEMA = "cep.trajectory/1"


@dataclass(frozen=True)
class StoredMotion:
    """What a trajectory file holds.

    Attributes
    ----------
    trajectory : Trajectory
        The most likely motion.
    weight : float
        Its probability.
    alternatives : tuple of (weight, Trajectory)
        Other motions that explain the photo.
    source : mapping
        ``method``, ``image``, ``seed``: how it was found.
    """

    trajectory: Trajectory
    weight: float = 1.0
    alternatives: tuple[tuple[float, Trajectory], ...] = ()
    source: Mapping[str, object] = field(default_factory=dict)


def write_motion(path: Path | str, motion: StoredMotion) -> None:
    """Write ``motion`` as JSON, whole or not at all.

    Parameters
    ----------
    path : path of the file
    motion : StoredMotion
    """
    document = {
        "schema": SCHEMA,
        "units": "px",
        "direction": motion.trajectory.direction,
        **_samples(motion.trajectory),
        "weight": motion.weight,
        "alternatives": [{"weight": weight, **_samples(other)} for weight, other in motion.alternatives],
        "source": dict(motion.source),
    }
    write_text_atomically(path, json.dumps(document, indent=1) + "\n")


def read_motion(path: Path | str) -> StoredMotion:
    """Read a trajectory file.

    Parameters
    ----------
    path : path of the file

    Raises
    ------
    ValueError
        If the file is not JSON, not of this schema, or its samples are not a trajectory; the line names the file.
    OSError
        If the file cannot be read.
    """
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a JSON file ({error})") from None
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        found = document.get("schema") if isinstance(document, dict) else type(document).__name__
        raise ValueError(f'{path}: wanted schema "{SCHEMA}", found {found!r}')
    if document.get("units", "px") != "px":
        raise ValueError(f'{path}: wanted units "px", found {document["units"]!r}')
    direction = cast(Direction, document.get("direction", "unknown"))
    try:
        main = _trajectory(document, direction)
        alternatives = tuple(
            (_weight(other), _trajectory(other, direction)) for other in document.get("alternatives", [])
        )
        return StoredMotion(main, _weight(document), alternatives, dict(document.get("source", {})))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        reason = f"field {error} is missing" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{path}: {reason}") from None


def write_text_atomically(path: Path | str, text: str) -> None:
    """Write ``text`` under a temporary name, then rename: readers never see half a file.

    Parameters
    ----------
    path : path of the file
    text : str, written as UTF-8
    """
    target = Path(path)
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        umask = os.umask(0)
        os.umask(umask)
        Path(temporary).chmod(0o666 & ~umask)
        Path(temporary).replace(target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _samples(trajectory: Trajectory) -> dict[str, list[float]]:
    return {"t": trajectory.t.tolist(), "x": trajectory.x.tolist(), "y": trajectory.y.tolist()}


def _trajectory(fields: Mapping[str, Any], direction: Direction) -> Trajectory:
    columns: list[Sequence[float]] = [fields["t"], fields["x"], fields["y"]]
    if len({len(column) for column in columns}) != 1:
        raise ValueError(f"t, x and y must be equally long, got {[len(column) for column in columns]}")
    t, x, y = (np.array(column, dtype=np.float64) for column in columns)
    exact = Trajectory.from_samples(np.column_stack([x, y]), t=t, direction=direction)
    if t[0] != 0 or t[-1] != 1:
        raise ValueError(f"t must run from 0 to 1, got {t[0]:g} to {t[-1]:g}")
    return exact


def _weight(fields: Mapping[str, Any]) -> float:
    weight = float(fields.get("weight", 1.0))
    if not 0 <= weight <= 1:
        raise ValueError(f"weight must lie within 0..1, got {weight}")
    return weight
