"""Scenarios of a search: alternative motions, other speeds, drifting and jittering chip edges.

Each function varies all given scenarios and divides their weight, so nested calls combine the
variations: ``jittered(speed_range(alternatives(motion), 0.9, 1.1, 3), chips, 0.05, 4, rng=rng)``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.optics.band import uniform_length_px
from cep.optics.exposure import chip_rows
from cep.optics.response import ShutterResponse
from cep.optics.timeline import checked_edges
from motdiff.files.trajectories import StoredMotion
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

MOST_SCENARIOS = 256
"""Most scenarios of a problem: a search looks at each of them in every move."""

LARGEST_JITTER = 0.15  # chips: three standard deviations of two neighbouring edges do not meet
_FARTHEST_EDGE = 0.45  # of the shorter chip beside it: below half, so that edges stay in order


@dataclass(frozen=True)
class Scenario:
    """A possible motion with its weight and the timing of the chips along it.

    Parameters
    ----------
    trajectory : Trajectory
    weight : float
        Above 0; the weights of a problem's scenarios are relative to their sum.
    edges : (n + 1,) array_like, optional
        Chip boundaries as fractions of the exposure; evenly spread over it when omitted.

    Raises
    ------
    ValueError
        If the edges are not increasing, or too far outside the exposure.
    """

    trajectory: Trajectory
    weight: float = 1.0
    edges: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.edges is not None:
            edges = np.array(self.edges, dtype=np.float64)
            checked_edges(edges, max(1, edges.size - 1)).setflags(write=False)
            object.__setattr__(self, "edges", edges)

    def path(self, *, reversed_path: bool) -> Trajectory:
        """Return the motion or its reverse; the chips are played in their order either way."""
        if reversed_path:
            return self.trajectory.reversed()
        return self.trajectory


Base = Trajectory | Scenario | Iterable[Scenario]
"""What is varied: one motion, or scenarios that other functions of this module made."""


def alternatives(motion: StoredMotion) -> tuple[Scenario, ...]:
    """Motions that may explain a photo, with their probabilities as weights.

    Those without any probability are left out.
    """
    weighted = [(motion.weight, motion.trajectory), *motion.alternatives]
    scenarios = tuple(
        Scenario(trajectory, weight) for weight, trajectory in weighted if weight > 0
    )
    _check_count(len(scenarios))
    return scenarios or (Scenario(motion.trajectory),)


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
        if path.direction == "unknown" and uniform_length_px(path) is None:
            scenarios += [Scenario(path, 0.5), Scenario(path.reversed(), 0.5)]
        else:
            scenarios.append(Scenario(path))
    if not scenarios:
        raise ValueError("motions: a class needs at least one")
    _check_count(len(scenarios))
    return tuple(scenarios)


def speed_range(base: Base, low: float, high: float, count: int) -> tuple[Scenario, ...]:
    """Scale every path by ``count`` factors, evenly spaced from ``low`` to ``high``.

    Raises
    ------
    ValueError
        If the factors are not positive and in order, one alone is to span a range, or scenarios
        are too many.
    """
    if not (np.isfinite(high) and 0 < low <= high):
        raise ValueError(f"speed: factors must be above 0 and in order, got {low:g}..{high:g}")
    if count < 1 or (count == 1 and low < high):
        raise ValueError(f"count: a range of speeds needs at least 2 of them, got {count}")
    factors = np.linspace(low, high, count).tolist()
    return _varied(
        base,
        count,
        lambda scenario: [
            replace(scenario, trajectory=scenario.trajectory.scaled(f)) for f in factors
        ],
    )


def drifted(base: Base, chips: int, amounts: float | Sequence[float]) -> tuple[Scenario, ...]:
    """Play the code ``1 + amount`` times as slowly as meant, for each amount.

    Code and exposure begin together. A slow code (amount above 0) outlasts the exposure, see
    :func:`cep.optics.timeline.extended`; a fast one leaves its end unused. Give 0 as well to keep
    the code played on time.

    Raises
    ------
    ValueError
        If an amount is outside -0.5..0.5, or scenarios are too many.
    """
    drifts = [float(amount) for amount in np.atleast_1d(amounts)]
    if not drifts or not all(-0.5 <= amount <= 0.5 for amount in drifts):
        raise ValueError(
            "amounts: must lie within -0.5..0.5, got"
            f" {', '.join(f'{a:g}' for a in drifts) or 'none'}"
        )
    return _varied(
        base,
        len(drifts),
        lambda scenario: [
            replace(scenario, edges=checked_edges(scenario.edges, chips) * (1 + amount))
            for amount in drifts
        ],
    )


def jittered(
    base: Base, chips: int, sigma_chips: float, count: int, *, rng: np.random.Generator
) -> tuple[Scenario, ...]:
    """Move every edge by a normal draw of ``sigma_chips``, ``count`` times.

    An edge moves by less than half of the shorter chip beside it, so that the edges stay in order.

    Raises
    ------
    ValueError
        If ``sigma_chips`` is outside 0..0.15, ``count`` below 1, or scenarios are too many.
    """
    if not 0 <= sigma_chips <= LARGEST_JITTER:
        raise ValueError(
            f"sigma_chips: must lie within 0..{LARGEST_JITTER:g} chips, got {sigma_chips:g}"
        )
    if count < 1:
        raise ValueError(f"count: must be at least 1, got {count}")

    def drawn(scenario: Scenario) -> list[Scenario]:
        edges = checked_edges(scenario.edges, chips)
        lengths = np.diff(edges)
        # the first and the last edge have a chip on one side only
        room = _FARTHEST_EDGE * np.minimum(
            np.append(lengths, lengths[-1]), np.insert(lengths, 0, lengths[0])
        )
        shifts = rng.normal(0.0, sigma_chips / chips, (count, chips + 1))
        jittered_edges = edges + np.clip(shifts, -room, room)
        return [replace(scenario, edges=shifted) for shifted in jittered_edges]

    return _varied(base, count, drawn)


def scenario_rows(
    scenario: Scenario,
    chips: int,
    fx_cy_px: ArrayLike,
    fy_cy_px: ArrayLike,
    *,
    response: ShutterResponse | None = None,
    reversed_path: bool = False,
) -> NDArray[np.complex128]:
    """Rows (n, 2, 2, ...) of :func:`cep.optics.exposure.chip_rows` along a scenario.

    The code is played in its own order either way. Only for chips of equal length and an instant
    shutter are the rows of the reversed path those of the path in the opposite order.
    """
    path = scenario.path(reversed_path=reversed_path)
    return chip_rows(path, chips, fx_cy_px, fy_cy_px, response=response, edges=scenario.edges)


def distinct_rows(rows: NDArray[Any], response: ShutterResponse | None) -> NDArray[Any]:
    """Rows (n, V, ...) of those (n, 2, 2, ...) of :func:`scenario_rows`.

    V is 4 where the shutter's response makes neighbours matter (2 left + right, 1 for open), else
    1.
    """
    if response is None:
        return rows[:, 0, :1]  # all four are the same
    return rows.reshape(len(rows), 4, *rows.shape[3:])


def coded_sum(rows: NDArray[Any], codes: NDArray[Any]) -> NDArray[Any]:
    """OTFs (R, ...) of (R, n) codes from rows (n, V, ...), as :func:`distinct_rows` gives them."""
    on = codes.astype(rows.real.dtype)
    flat = rows.reshape(*rows.shape[:2], -1)
    if rows.shape[1] == 1:
        total = on @ flat[:, 0]
    else:
        # chips open one after the other from the first: the left neighbour stands, the right one
        # is closed yet
        open_before = np.pad(on, ((0, 0), (1, 0)))[:, :-1]
        total = (on * (1 - open_before)) @ flat[:, 0]
        total += (on * open_before) @ flat[:, 2]
    return np.asarray(total.reshape(len(codes), *rows.shape[2:]))


def _varied(
    base: Base, count: int, vary: Callable[[Scenario], list[Scenario]]
) -> tuple[Scenario, ...]:
    if isinstance(base, Trajectory):
        base = (Scenario(base),)
    elif isinstance(base, Scenario):
        base = (base,)
    scenarios = tuple(base)
    _check_count(len(scenarios) * count)  # before they are made
    return tuple(
        replace(variation, weight=scenario.weight / count)
        for scenario in scenarios
        for variation in vary(scenario)
    )


def _check_count(count: int) -> None:
    if count > MOST_SCENARIOS:
        raise ValueError(
            f"scenarios: {count} are too many, at most {MOST_SCENARIOS}; take fewer speeds, draws"
            " or motions"
        )
