"""Example motions of the page: a hand, a turntable, a conveyor, a random walk."""

from __future__ import annotations

from functools import cache

import numpy as np

from motdiff.motions import boracchi_foi, quadratic
from motdiff.trajectory import Trajectory

EXAMPLES = {
    "shake": "a hand that accelerates: a bent path of 26 px",
    "turn": "a turntable: an arc of 40 px at constant speed, of known direction",
    "start": "a conveyor that starts: straight, 32 px, ever faster, of known direction",
    "walk": "a random walk with reversals, 60 px",
}
"""What each example motion is, by its name."""

_THIN_PX = 0.05  # of paths of 2,000 samples, far below what a photo shows


@cache
def example_motion(name: str) -> Trajectory:
    """Return an example motion; ValueError where there is none of that name.

    Examples
    --------
    >>> round(example_motion("walk").length_px)
    60
    """
    if name not in EXAMPLES:
        raise ValueError(
            f"motion: there is no example {name[:40]!r}; there are {', '.join(EXAMPLES)}"
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
