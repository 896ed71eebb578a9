"""Timing of a played code: shifted chip edges, and the motion extrapolated beyond the exposure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cep.optics.code import ShutterCode
from cep.optics.response import ShutterResponse
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray


@dataclass(frozen=True)
class Timeline:
    """A played exposure cut at every path sample, chip edge, and step of the shutter's ramps.

    Attributes
    ----------
    t, xy : (T,), (T, 2) float
        The path, extended as far as the code is played.
    u : (S + 1,) float
        Cuts, as a fraction of the exposure.
    dt, a, b : (S,), (S, 2), (S, 2) float
        Durations, starts and ends of the pieces.
    chip : (S,) int
        Chip that each piece belongs to; n follows the last one.
    opening, closing : (S,) float
        Transmission if the shutter began to open, and to close, as the chip began.
    """

    t: FloatArray
    xy: FloatArray
    u: FloatArray
    dt: FloatArray
    a: FloatArray
    b: FloatArray
    chip: NDArray[np.intp]
    opening: FloatArray
    closing: FloatArray

    def transmission(self, code: ShutterCode) -> FloatArray:
        """Transmission (S,) of the shutter under a code, closed before and after it."""
        chips = np.concatenate([[0.0], code.array, [0.0]])  # closed before and after
        previous = chips[self.chip]
        current = chips[self.chip + 1]
        return np.where(
            current > 0,
            np.where(previous > 0, 1.0, self.opening),
            np.where(previous > 0, self.closing, 0.0),
        )

    def frame_size(self) -> int:
        """Smallest PSF frame, px, that holds the played path."""
        points = np.concatenate([self.a, self.b[-1:]])
        low = np.floor(points.min())
        high = np.floor(points.max()) + 1
        return int(max(-2 * low, 2 * high + 1))


def even_edges(chips: int) -> FloatArray:
    """Chip edges (n + 1,) of a code on time, as fractions of the exposure."""
    if chips < 1:
        raise ValueError(f"chips: must be at least 1, got {chips}")
    return np.linspace(0, 1, chips + 1)


def check_lengths(edges: FloatArray, response: ShutterResponse) -> None:
    """Refuse edges (n + 1,) that leave a chip no time to open or close, with a ValueError."""
    # a transition must end within its chip: it depends on two neighbouring chips alone
    slowest = max(response.opening_ns, response.closing_ns)
    shortest_ns = float(np.diff(edges).min()) * (len(edges) - 1) * response.chip_ns
    if slowest > shortest_ns * (1 + 1e-9):  # but for rounding
        raise ValueError(
            f"response: opening or closing takes {slowest:g} ns, "
            f"but the shortest chip of these edges lasts {shortest_ns:g} ns"
        )


def extended(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Continue a path by one exposure either way: (T',) times and (T', 2) px.

    The last stretch of the motion is repeated, turned by 180 degrees: velocity and speed go on
    without a jump, a uniform straight motion simply goes on, and one noisy last sample cannot
    throw the path far away as its velocity alone could. The camera counts as open for as long as
    the code is played.
    """
    t = trajectory.t
    xy = trajectory.xy
    times = np.concatenate([-t[:0:-1], t, 2 - t[-2::-1]])
    return times, np.concatenate([2 * xy[0] - xy[:0:-1], xy, 2 * xy[-1] - xy[-2::-1]])


def timeline(
    trajectory: Trajectory,
    edges: FloatArray,
    response: ShutterResponse | None,
    *,
    code: ShutterCode | None = None,
) -> Timeline:
    """Cut a played exposure into pieces of constant velocity and transmission.

    The edges (n + 1,) are those of the chips, as fractions of the exposure: :func:`even_edges` of
    a code on time. With a code only its own transitions are cut, else every possible one.
    ValueError if a chip is shorter than the shutter takes to open or close.
    """
    chips = len(edges) - 1
    shutter = response or ShutterResponse(chip_ns=1.0)
    check_lengths(edges, shutter)
    # without a code every edge is cut for both ramps: it may open or close at each
    opens = closes = np.ones(chips + 1, dtype=bool)
    if code is not None:
        steps = np.diff(np.concatenate([[0.0], code.array, [0.0]]))
        opens = steps > 0
        closes = steps < 0
    ramps = [
        (edges[opens, None] + shutter.opening_cuts / chips).ravel(),
        (edges[closes, None] + shutter.closing_cuts / chips).ravel(),
    ]
    # between cuts the transmission is constant, so each piece keeps its closed-form transform
    cuts = np.unique(np.concatenate([edges, *ramps]))
    # a last edge cut for an opening ramp as well opens nothing: no chip follows
    cuts = cuts[cuts <= (edges[-1] + shutter.closing_cuts / chips).max()]
    t, xy = extended(trajectory)
    u = np.union1d(t[(t > cuts[0]) & (t < cuts[-1])], cuts)
    points = np.stack([np.interp(u, t, xy[:, axis]) for axis in (0, 1)], axis=-1)
    middle = 0.5 * (u[1:] + u[:-1])
    chip = np.searchsorted(edges, middle, side="right") - 1
    after = (middle - edges[chip]) * chips
    return Timeline(
        t,
        xy,
        u,
        np.diff(u),
        points[:-1],
        points[1:],
        chip,
        shutter.opening(after),
        shutter.closing(after),
    )
