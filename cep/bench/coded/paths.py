"""Weighted paths as one line of text: what cells of the coded-exposure table hand to each other."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from motdiff.trajectory import Trajectory

__all__ = ["paths_from", "paths_to"]


def paths_to(paths: Sequence[Trajectory], weights: Sequence[float]) -> str:
    """Write weighted paths as one line of text, for a table's cell."""
    rows = [
        {"t": path.t.tolist(), "xy": path.xy.tolist(), "direction": path.direction, "weight": float(weight)}
        for path, weight in zip(paths, weights, strict=True)
    ]
    return json.dumps(rows)


def paths_from(text: str) -> tuple[tuple[Trajectory, ...], tuple[float, ...]]:
    """Read what :func:`paths_to` has written: paths and weights."""
    rows = json.loads(text)
    paths = tuple(Trajectory(np.array(row["t"]), np.array(row["xy"]), row["direction"]) for row in rows)
    return paths, tuple(float(row["weight"]) for row in rows)
