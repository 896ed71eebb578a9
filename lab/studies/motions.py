"""Motions that several studies draw. Each study keeps its own order of draws: its figures stand in
docs/decisions.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from lab.bench.blind.protocol import synthetic_trace
from motdiff.files.gyro_tables import read_gyro
from motdiff.gyro import GyroTrace
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.trajectory import Direction, Trajectory

MOTIONS = ("walks", "arcs", "gyro")
"""Kinds of motions photographed through known codes, see :func:`motion_for_codes`."""

KINDS = ("walk", "arc", "shake")
"""Kinds of motions in single photos, see :func:`motion_in_photo`."""

EXPOSURES_S = (0.05, 0.1, 0.25, 0.5)


def circular_arc(
    turn_rad: float,
    *,
    start_rad: float = 0.0,
    length_px: float,
    samples: int = 200,
    direction: Direction = "unknown",
) -> Trajectory:
    """Arc of a circle at constant speed, that turns by an angle of either sign."""
    angle = np.linspace(0, turn_rad, samples) + start_rad
    radius_px = length_px / np.ptp(angle)
    return Trajectory.from_samples(
        radius_px * np.stack([np.cos(angle), np.sin(angle)], axis=1), direction=direction
    )


def accelerated_arc(rng: np.random.Generator) -> Trajectory:
    """Draw a motion of constant curvature and constant acceleration, 18 to 40 px long."""
    t = np.linspace(0, 1, 401)
    bend_rad = rng.choice([0.0, 1.0]) * rng.uniform(0.3, 1.6) * rng.choice([-1, 1])
    heading = rng.uniform(0, 2 * np.pi) + bend_rad * t
    speed = 1 + rng.choice([0.0, 1.0]) * rng.uniform(-0.5, 0.8) * t
    velocity = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * speed[:, None]
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(velocity[1:] + velocity[:-1], axis=0)])
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    return Trajectory.from_samples(path * (rng.uniform(18, 40) / length), t=t)


def motion_in_photo(
    kind: str, trace: GyroTrace, rng: np.random.Generator, *, widest_px: float = 36.0
) -> Trajectory:
    """Draw a motion of one of :data:`KINDS`; a shake of the trace is 12 px to ``widest_px``."""
    if kind == "walk":
        return boracchi_foi(rng)
    if kind == "arc":
        return accelerated_arc(rng)
    exposure_s = np.exp(rng.uniform(np.log(0.05), np.log(0.5)))
    extent_px = rng.uniform(12, widest_px)
    return random_gyro_motion(trace, rng, exposure_s=exposure_s, extent_px=extent_px)


def motion_for_codes(motions: str, gyro: str, rng: np.random.Generator) -> Trajectory:
    """Draw a motion of one of :data:`MOTIONS`; shakes are synthetic without a recording."""
    if motions == "walks":
        return boracchi_foi(rng)
    if motions == "gyro":
        exposure_s = float(rng.choice(EXPOSURES_S))
        extent_px = float(rng.uniform(8, 30))
        return random_gyro_motion(_trace(gyro), rng, exposure_s=exposure_s, extent_px=extent_px)
    turn_rad = rng.choice((-1, 1)) * rng.uniform(0.5, 3.0)
    start_rad = rng.uniform(0, 2 * np.pi)
    length_px = rng.uniform(20, 60)
    return circular_arc(turn_rad, start_rad=start_rad, length_px=length_px, direction="known")


def known_motion(
    motions: str, index: int, *, seed: int, gyro: str
) -> tuple[Trajectory, np.random.Generator]:
    """Motion of a number and seed, its direction known, and the generator of what follows it."""
    rng = np.random.default_rng([seed, MOTIONS.index(motions), index])
    path = motion_for_codes(motions, gyro, rng)
    return Trajectory(path.t, path.xy, direction="known"), rng


@cache
def _trace(gyro: str) -> GyroTrace:
    return read_gyro(gyro) if gyro else synthetic_trace(0, duration_s=120.0, rate_hz=200.0)
