"""Random camera motions: Boracchi-Foi, straight, accelerated, and windows of gyro traces."""

from __future__ import annotations

import math

import numpy as np

from motdiff.gyro import GyroTrace, trajectory_from_gyro
from motdiff.path_psfs import interpolated
from motdiff.trajectory import Trajectory, check_positive

DEBLURGAN_EXPL = (0.01, 0.009, 0.008, 0.007, 0.005, 0.003)
# a big shake adds the velocity turned by 180 degrees +- the spread, times the strength
_SHAKE_STRENGTH = 2.0
_SHAKE_SPREAD_RAD = 0.5
_MIN_EXTENT_RAD = 2e-4  # enlarged, windows stiller than this would show the sensor's noise
_SMOOTH_OVER = 0.12  # of the exposure: an error of a path changes over such times
_WINDOW_TRIES = 200  # until the recording is called still
# a phone's; other axes would draw the mirror images of the published tables' motions
_RECORDED_AXES = "right,up,back"
_PARABOLA_POINTS = 200
_ERROR_KNOTS = 101  # well within the 0.12 of the exposure over which errors change


def boracchi_foi(
    rng: np.random.Generator,
    *,
    max_length_px: float = 60.0,
    expl: float | None = None,
    samples: int = 2000,
    inertia_max: float = 0.7,
    big_shake_max: float = 0.2,
    gaussian_max: float = 10.0,
) -> Trajectory:
    """Draw DeblurGAN's random walk: constant speed, inertia and sudden reversals.

    Arc length is exactly ``max_length_px``; the path is centred on its time-mean (the original is
    not centred). ValueError if the length or ``expl`` is not positive, or there are fewer than 2
    samples.

    Parameters
    ----------
    expl : float, optional
        "Anxiety": scales every random change of the velocity; drawn from :data:`DEBLURGAN_EXPL`
        when omitted.
    samples : int
        Points on the path, evenly spaced in time.
    inertia_max, big_shake_max, gaussian_max : float
        Upper ends of the uniform laws of the pull to the start, the probability of a big shake
        (times ``expl`` per step) and the strength of the Gaussian changes.

    References
    ----------
    Boracchi and Foi, "Modeling the performance of image restoration from motion blur", IEEE TIP
    21(8), 2012. Kupyn et al., "DeblurGAN", CVPR 2018, Algorithm 1, with the constants of its
    released code.
    """
    check_positive("max_length_px", max_length_px)
    if samples < 2:
        raise ValueError(f"samples: needs at least 2, got {samples}")
    if expl is None:
        expl = float(rng.choice(DEBLURGAN_EXPL))
    check_positive("expl", expl)
    inertia, big_shake, gaussian = (
        top * rng.random() for top in (inertia_max, big_shake_max, gaussian_max)
    )
    angle_rad = rng.uniform(0, 2 * np.pi)
    steps = samples - 1
    # all in units of one step, so that the velocity has modulus 1
    normal = rng.standard_normal((2, steps))
    shakes: list[complex] = (expl * gaussian * (normal[0] + 1j * normal[1])).tolist()
    when = np.flatnonzero(rng.random(steps) < big_shake * expl)
    turns = np.pi + _SHAKE_SPREAD_RAD * rng.uniform(-1, 1, when.size)
    kicks = dict(zip(when.tolist(), (_SHAKE_STRENGTH * np.exp(1j * turns)).tolist(), strict=True))
    pull = expl * inertia * max_length_px / steps
    velocity = complex(math.cos(angle_rad), math.sin(angle_rad))
    position = 0j
    path = [position]
    for i, shake in enumerate(shakes):
        velocity += shake - pull * position + (kicks[i] * velocity if i in kicks else 0)
        velocity /= abs(velocity)  # constant speed: the arc length stays exact
        position += velocity
        path.append(position)
    points = np.array(path) * (max_length_px / steps)
    return Trajectory.from_samples(np.column_stack([points.real, points.imag]), direction="known")


def random_straight(
    rng: np.random.Generator, *, min_length_px: float = 5.0, max_length_px: float = 40.0
) -> Trajectory:
    """Draw a uniform straight motion, length and angle uniform."""
    length_px = _drawn_length(rng, min_length_px, max_length_px)
    return Trajectory.straight(length_px, angle_rad=rng.uniform(0, 2 * np.pi), direction="known")


def quadratic(
    rng: np.random.Generator,
    *,
    min_length_px: float = 5.0,
    max_length_px: float = 40.0,
    max_bend: float = 1.0,
) -> Trajectory:
    """Draw a motion of constant acceleration: a piece of a parabola at its own pace.

    ``max_bend`` is the largest change of velocity during the exposure over the mean velocity;
    below 2 the motion never turns back. ValueError if it is negative, or the lengths are not
    positive and ordered.
    """
    if not (math.isfinite(max_bend) and max_bend >= 0):
        raise ValueError(f"max_bend: must be a non-negative number, got {max_bend}")
    length_px = _drawn_length(rng, min_length_px, max_length_px)
    mean_rad, change_rad = rng.uniform(0, 2 * np.pi, 2)
    change = max_bend * math.sqrt(rng.random())  # uniform over the disc
    t = np.linspace(0, 1, _PARABOLA_POINTS) - 0.5
    points = t * np.exp(1j * mean_rad) + 0.5 * t**2 * change * np.exp(1j * change_rad)
    points *= length_px / np.abs(np.diff(points)).sum()
    return Trajectory.from_samples(np.column_stack([points.real, points.imag]), direction="known")


def random_gyro_motion(
    trace: GyroTrace,
    rng: np.random.Generator,
    *,
    exposure_s: float,
    extent_px: float,
) -> Trajectory:
    """Draw a hand shake: a window of ``trace``, turned, its focal length for ``extent_px``.

    That is the larger side of the path's bounding box. ValueError if the trace is shorter than the
    exposure, or too still.
    """
    check_positive("exposure_s", exposure_s)
    check_positive("extent_px", extent_px)
    spare_s = trace.duration_s - exposure_s
    if spare_s < 0:
        raise ValueError(
            f"exposure_s: {exposure_s} s does not fit the trace of {trace.duration_s:.3g} s"
        )
    for _ in range(_WINDOW_TRIES):
        start_s = float(trace.t_s[0]) + spare_s * rng.random()
        motion = trajectory_from_gyro(
            trace, focal_px=1.0, start_s=start_s, exposure_s=exposure_s, axes=_RECORDED_AXES
        )
        if motion.extent_px < _MIN_EXTENT_RAD:
            continue
        # turned at random: a recording may have a preferred direction
        turn = rng.uniform(0, 2 * np.pi)
        c = math.cos(turn)
        s = math.sin(turn)
        xy = motion.xy @ np.array([[c, s], [-s, c]])
        motion = Trajectory.from_samples(xy, t=motion.t, direction="known")
        return motion.scaled(extent_px / motion.extent_px)
    raise ValueError(
        f"trace: {_WINDOW_TRIES} windows of {exposure_s} s turned by less than min_extent_rad ="
        f" {_MIN_EXTENT_RAD}"
    )


def with_smooth_error(
    trajectory: Trajectory,
    error_px: float,
    *,
    rng: np.random.Generator,
    sign: float = 1.0,
) -> Trajectory:
    """Draw a path near another one, as an estimate is near the truth: a Gaussian process is added.

    Parameters
    ----------
    error_px : float, px
        Expected rms distance over time, both axes together; a ValueError if it is negative.
    sign : float
        Factor of the error: -1 gives the opposite draw.
    """
    if not (math.isfinite(error_px) and error_px >= 0):
        raise ValueError(f"error_px: must be 0 px or more, got {error_px}")
    knots = np.linspace(0, 1, _ERROR_KNOTS)
    alike = np.exp(-0.5 * ((knots[:, None] - knots) / _SMOOTH_OVER) ** 2)
    # 1e-8: a smooth covariance is singular to within rounding, and Cholesky needs it definite
    knot_errors = np.linalg.cholesky(alike + 1e-8 * np.eye(knots.size)) @ rng.standard_normal(
        (knots.size, 2)
    )
    t = np.union1d(trajectory.t, knots)
    # error_px is an rms length, so each axis has 1 / sqrt(2) of it
    error = interpolated(t, knots, knot_errors) * (sign * error_px / 2**0.5)
    return Trajectory.from_samples(trajectory.at(t) + error, t=t, direction=trajectory.direction)


def _drawn_length(rng: np.random.Generator, low_px: float, high_px: float) -> float:
    if not (math.isfinite(high_px) and 0 < low_px <= high_px):
        raise ValueError(
            f"min_length_px: must be positive and at most max_length_px, got {low_px} and"
            f" {high_px}"
        )
    return float(rng.uniform(low_px, high_px))
