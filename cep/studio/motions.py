"""Motions of the page: read from what it sends, as fields that it keeps, and examples."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Literal

import numpy as np

from cep.studio.fields import FieldError, is_number, read_number
from motdiff.motions import boracchi_foi, quadratic
from motdiff.trajectory import Trajectory

EXAMPLES = {
    "shake": "a hand that accelerates: a bent path of 26 px",
    "turn": "a turntable: an arc of 40 px at constant speed, of known direction",
    "start": "a conveyor that starts: straight, 32 px, ever faster, of known direction",
    "walk": "a random walk with reversals, 60 px",
}
"""What each example motion is, by its name."""

_MOST_SAMPLES = 512  # of a path in the address
_KEPT_SAMPLES = 160  # to which the page thins one
_TIME_STEPS = 65_535  # of a path in the address: 16 bits
_FARTHEST_PX = 500.0  # of a bent path: the work grows with its area, to some seconds of a picture
_THIN_PX = 0.05  # of paths of 2,000 samples, far below what a photo shows


def page_motion(motion: object) -> tuple[Mapping[str, Any], Trajectory]:
    """Read the motion that the page sends: its fields, as they are kept, and its path."""
    if not isinstance(motion, dict):
        raise FieldError("motion", "the motion must be an object with its kind")
    kind = motion.get("kind")
    if kind == "straight":
        length = read_number(motion, "length", 1.0, 1_000.0, "px")
        angle = read_number(motion, "angle", -360.0, 360.0, "degrees") or 0.0
        if length is None:
            raise FieldError("length", "a straight motion needs its length in px")
        return {"kind": kind, "length": length, "angle": angle}, Trajectory.straight(
            length, angle_rad=math.radians(angle)
        )
    if kind == "example":
        name = motion.get("name")
        if not isinstance(name, str):
            name = ""
        return {"kind": kind, "name": name}, example_motion(name)
    if kind != "path":
        raise FieldError("motion", "the kind of a motion is straight, example or path")
    columns = [motion.get(name) for name in "txy"]
    sizes = {len(column) for column in columns if isinstance(column, list)}
    are_lists = all(isinstance(column, list) for column in columns)
    if not are_lists or len(sizes) != 1 or not 2 <= sizes.pop() <= _MOST_SAMPLES:
        raise FieldError(
            "motion", f"a path has 2 to {_MOST_SAMPLES} samples, as many of t as of x and y"
        )
    if not all(is_number(value) for column in columns for value in column or ()):
        raise FieldError("motion", "t, x and y of a path are finite numbers")
    t, x, y = (np.array(column, dtype=np.float64) for column in columns)
    if max(np.abs(x).max(), np.abs(y).max()) > _FARTHEST_PX:
        raise FieldError("motion", f"a path lies within {_FARTHEST_PX:g} px")
    direction: Literal["known", "unknown"] = "unknown"
    if motion.get("direction") == "known":
        direction = "known"
    try:
        path = Trajectory.from_samples(np.column_stack([x, y]), t=t, direction=direction)
    except ValueError as error:
        raise FieldError("motion", str(error).removeprefix("trajectory: ")) from None
    if path.extent_px < 1e-3:
        raise FieldError("motion", "the path stays in place; a motion is needed")
    return {
        "kind": kind,
        "t": t.tolist(),
        "x": x.tolist(),
        "y": y.tolist(),
        "direction": direction,
    }, path


def path_fields(trajectory: Trajectory) -> dict[str, Any]:
    """Return a motion as the page keeps it in its address: thinned, with times in 16 bits.

    Samples of a fast jump that fall on the same time are moved to the next ones.
    """
    path = trajectory
    tolerance_px = 0.005
    while path.t.size > _KEPT_SAMPLES:
        path = trajectory.thinned(tolerance_px)
        tolerance_px = 1.4 * tolerance_px
    order = np.arange(path.t.size)
    # strictly rising whole numbers: from the left each at least one above the one before ...
    steps = np.maximum.accumulate(np.rint(_TIME_STEPS * path.t) - order) + order
    # ... and none so high that the samples after it have no room below the end
    t = np.minimum(steps, _TIME_STEPS - order[::-1]) / _TIME_STEPS
    samples = {
        name: np.round(values, 5).tolist() for name, values in (("x", path.x), ("y", path.y))
    }
    return {"kind": "path", "direction": path.direction, "t": t.tolist(), **samples}


def described_paths(weights: Sequence[float], paths: Sequence[Trajectory]) -> list[dict[str, Any]]:
    """Return motions with their probabilities and sizes, as the page lists them."""
    return [
        {
            "weight": weight,
            "length_px": path.length_px,
            "extent_px": path.extent_px,
            **path_fields(path),
        }
        for weight, path in zip(weights, paths, strict=True)
    ]


@cache
def example_motion(name: str) -> Trajectory:
    """Return an example motion; FieldError where there is none of that name.

    Examples
    --------
    >>> round(example_motion("walk").length_px)
    60
    """
    if name not in EXAMPLES:
        raise FieldError(
            "motion", f"there is no example {name[:40]!r}; there are {', '.join(EXAMPLES)}"
        )
    t = np.linspace(0, 1, 33)
    if name == "shake":
        # a fixed draw: pages and files store no more than the example's name
        shake = quadratic(
            np.random.default_rng(0), min_length_px=24, max_length_px=28, max_bend=1.5
        )
        return shake.thinned(_THIN_PX)
    if name == "turn":
        angle = np.pi / 2 * (t - 0.5)
        radius = 40 / (np.pi / 2)
        return Trajectory.from_samples(
            radius * np.stack([np.sin(angle), np.cos(angle)], axis=1), direction="known"
        )
    if name == "start":
        return Trajectory.from_samples(32 * np.stack([t**2, 0 * t], axis=1), direction="known")
    return boracchi_foi(np.random.default_rng(7)).thinned(_THIN_PX)
