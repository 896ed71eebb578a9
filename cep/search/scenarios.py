"""Scenarios of a search: motions that may occur."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cep.optics.band import uniform_length_px
from motdiff.trajectory import Trajectory

MOST_SCENARIOS = 256
"""Most scenarios of a problem: a search looks at each of them in every move."""


@dataclass(frozen=True)
class Scenario:
    """A possible motion with its weight.

    Parameters
    ----------
    trajectory : Trajectory
    weight : float
        Above 0; the weights of a problem's scenarios are relative to their sum.
    """

    trajectory: Trajectory
    weight: float = 1.0

    def path(self, *, reversed_path: bool) -> Trajectory:
        """Return the motion or its reverse; the chips are played in their order either way."""
        if reversed_path:
            return self.trajectory.reversed()
        return self.trajectory


def class_scenarios(motions: Iterable[Trajectory]) -> tuple[Scenario, ...]:
    """Make a class of motions of equal weight; an unknown direction is in it both ways.

    For a problem of the rule "mean" and the direction "forward": over a class the ways of a motion
    are averaged as its motions are, while the other problems count the worse one.

    Raises
    ------
    ValueError
        If there are no motions, or the scenarios are too many.

    Examples
    --------
    >>> bent = Trajectory.from_samples([[0, 0], [9, 3], [14, 12]])
    >>> straight = Trajectory.straight(20.0)
    >>> [one.weight for one in class_scenarios([bent, straight])]
    [0.5, 0.5, 1.0]
    """
    scenarios: list[Scenario] = []
    for path in motions:
        # the reverse of a uniform straight motion blurs as the motion does
        if path.direction == "unknown" and uniform_length_px(path) is None:
            scenarios += [Scenario(path, 0.5), Scenario(path.reversed(), 0.5)]
        else:
            scenarios.append(Scenario(path))
    if not scenarios:
        raise ValueError("motions: a class needs at least one")
    if len(scenarios) > MOST_SCENARIOS:
        raise ValueError(
            f"scenarios: {len(scenarios)} are too many, at most {MOST_SCENARIOS}; take fewer"
            " motions"
        )
    return tuple(scenarios)


def speed_range(motion: Trajectory, low: float, high: float, count: int) -> tuple[Scenario, ...]:
    """Scale a path by ``count`` factors, evenly spaced from ``low`` to ``high``.

    Raises
    ------
    ValueError
        If the factors are not positive and in order, or one alone is to span a range.
    """
    if not (np.isfinite(high) and 0 < low <= high):
        raise ValueError(f"speed: factors must be above 0 and in order, got {low:g}..{high:g}")
    if count < 1 or (count == 1 and low < high):
        raise ValueError(f"count: a range of speeds needs at least 2 of them, got {count}")
    return tuple(
        Scenario(motion.scaled(factor), 1 / count)
        for factor in np.linspace(low, high, count).tolist()
    )
