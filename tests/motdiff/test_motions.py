"""Random motions: what their recipes promise."""

from types import SimpleNamespace

import numpy as np
import pytest

from motdiff.gyro import GyroTrace
from motdiff.motions import (
    DEBLURGAN_EXPL,
    boracchi_foi,
    quadratic,
    random_gyro_motion,
    random_straight,
)
from motdiff.trajectory import Trajectory


def shaky_trace(seed: int = 0, count: int = 2000, rate_hz: float = 200.0) -> GyroTrace:
    rng = np.random.default_rng(seed)
    rate = np.cumsum(rng.standard_normal((count, 3)), axis=0)
    return GyroTrace(np.arange(count) / rate_hz, 0.01 * (rate - rate.mean(axis=0)))


def textbook_walk(
    rng: np.random.Generator, max_length: float, expl: float, iters: int
) -> np.ndarray:
    """The recipe step by step in px, as published, from the same draws."""
    c, p, g = (top * rng.random() for top in (0.7, 0.2, 10.0))
    angle = rng.uniform(0, 2 * np.pi)
    n = rng.standard_normal((2, iters - 1))
    shaken = np.flatnonzero(rng.random(iters - 1) < p * expl)
    turns = dict(zip(shaken, np.pi + 0.5 * rng.uniform(-1, 1, shaken.size), strict=True))
    s = max_length / (iters - 1)
    x = np.zeros(iters, complex)
    v = s * np.exp(1j * angle)
    for t in range(iters - 1):
        impulse = 2 * v * np.exp(1j * turns[t]) if t in turns else 0
        v = v + impulse + expl * (g * (n[0, t] + 1j * n[1, t]) - c * x[t]) * s
        v = v / abs(v) * s
        x[t + 1] = x[t] + v
    return np.column_stack([x.real, x.imag])


@pytest.mark.parametrize("seed", range(4))
def test_boracchi_foi_is_the_published_recursion(seed: int) -> None:
    walk = boracchi_foi(np.random.default_rng(seed), expl=0.02, samples=600, max_length_px=45.0)
    expected = Trajectory.from_samples(textbook_walk(np.random.default_rng(seed), 45.0, 0.02, 600))
    np.testing.assert_allclose(walk.xy, expected.xy, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_boracchi_foi_has_constant_speed_exact_length_and_fits_the_frame(seed: int) -> None:
    walk = boracchi_foi(np.random.default_rng(seed))
    assert walk.length_px == pytest.approx(60, rel=1e-12)
    steps = np.linalg.norm(np.diff(walk.xy, axis=0), axis=1)
    np.testing.assert_allclose(steps, 60 / 1999, rtol=1e-9)
    # at constant speed no point is farther than half the length from the time-mean
    assert np.linalg.norm(walk.xy, axis=1).max() <= 30
    assert walk.psf(64).sum() == pytest.approx(1)
    assert walk.hr_map().any()


def test_boracchi_foi_extents_match_the_measured_reference() -> None:
    extents = [
        boracchi_foi(np.random.default_rng(seed), expl=0.005).extent_px for seed in range(150)
    ]
    assert np.median(extents) == pytest.approx(17, abs=2.5)  # 16.8 measured on the original code
    assert np.percentile(extents, 5) == pytest.approx(11, abs=2)


def test_boracchi_foi_draws_its_anxiety_from_the_list_and_repeats_with_the_seed() -> None:
    one, two = (boracchi_foi(np.random.default_rng(9)) for _ in range(2))
    np.testing.assert_array_equal(one.xy, two.xy)
    rng = np.random.default_rng(9)
    drawn = float(rng.choice(DEBLURGAN_EXPL))
    np.testing.assert_array_equal(boracchi_foi(rng, expl=drawn).xy, one.xy)


def test_boracchi_foi_without_shakes_is_straight() -> None:
    walk = boracchi_foi(np.random.default_rng(0), inertia_max=0, big_shake_max=0, gaussian_max=0)
    assert np.linalg.norm(walk.xy[-1] - walk.xy[0]) == pytest.approx(60)


def test_big_shakes_turn_back() -> None:
    rng = np.random.default_rng(3)
    walk = boracchi_foi(
        rng, expl=1.0, inertia_max=0, gaussian_max=0, big_shake_max=0.2, samples=500
    )
    d = np.diff(walk.xy, axis=0)
    turn = np.arccos(np.clip((d[1:] * d[:-1]).sum(axis=1) / (60 / 499) ** 2, -1, 1))
    sharp = turn[turn > 1e-6]
    assert sharp.size > 5
    # v + 2 v exp(i (pi + u)) with |u| <= 0.5
    widest = np.angle(1 + 2 * np.exp(1j * (np.pi + 0.5)))
    assert sharp.min() >= abs(widest) - 1e-3


@pytest.mark.parametrize("seed", range(6))
def test_straight_and_quadratic(seed: int) -> None:
    rng = np.random.default_rng(seed)
    line = random_straight(rng, min_length_px=7, max_length_px=9)
    assert 7 <= line.length_px <= 9
    bent = quadratic(rng, min_length_px=7, max_length_px=9)
    assert 7 <= bent.length_px <= 9
    acceleration = np.diff(bent.xy, n=2, axis=0)
    np.testing.assert_allclose(
        acceleration, np.broadcast_to(acceleration[0], acceleration.shape), atol=1e-9
    )
    mean_velocity = bent.xy[-1] - bent.xy[0]
    assert np.linalg.norm(acceleration[0]) * 199**2 <= np.linalg.norm(mean_velocity) * (1 + 1e-9)
    straight = quadratic(rng, max_bend=0)
    assert np.linalg.norm(straight.xy[-1] - straight.xy[0]) == pytest.approx(straight.length_px)


def test_gyro_motion_has_the_extent_asked_for_and_known_direction() -> None:
    rng = np.random.default_rng(0)
    trace = shaky_trace()
    motions = [random_gyro_motion(trace, rng, exposure_s=0.2, extent_px=21.5) for _ in range(10)]
    for motion in motions:
        assert motion.extent_px == pytest.approx(21.5)
        assert motion.direction == "known"
    assert np.ptp([motion.length_px for motion in motions]) > 0.1  # other windows
    one = random_gyro_motion(trace, np.random.default_rng(5), exposure_s=0.2, extent_px=10)
    two = random_gyro_motion(trace, np.random.default_rng(5), exposure_s=0.2, extent_px=10)
    np.testing.assert_array_equal(one.xy, two.xy)


def test_gyro_motion_turns_the_window_only() -> None:
    trace = shaky_trace()
    unturned = SimpleNamespace(random=np.random.default_rng(5).random, uniform=lambda *_: 0.0)
    a = random_gyro_motion(trace, unturned, exposure_s=0.2, extent_px=10)  # type: ignore[arg-type]
    b = random_gyro_motion(trace, np.random.default_rng(5), exposure_s=0.2, extent_px=10)
    ra, rb = (np.linalg.norm(m.xy, axis=1) for m in (a, b))
    np.testing.assert_allclose(ra / ra.max(), rb / rb.max(), atol=1e-9)
    cross_a = a.x[:-1] * a.y[1:] - a.y[:-1] * a.x[1:]
    cross_b = b.x[:-1] * b.y[1:] - b.y[:-1] * b.x[1:]
    assert np.sign(cross_a.sum()) == np.sign(cross_b.sum())  # turned, not mirrored


def test_bad_arguments() -> None:
    rng = np.random.default_rng(0)
    still = GyroTrace(np.arange(100) / 100, np.zeros((100, 3)))
    for call, said in (
        (lambda: boracchi_foi(rng, max_length_px=-1), "max_length_px"),
        (lambda: boracchi_foi(rng, expl=0), "expl"),
        (lambda: boracchi_foi(rng, samples=1), "samples"),
        (lambda: quadratic(rng, max_bend=-1), "max_bend"),
        (lambda: random_straight(rng, min_length_px=5, max_length_px=4), "min_length_px"),
        (lambda: random_gyro_motion(still, rng, exposure_s=0.1, extent_px=10), "min_extent_rad"),
        (lambda: random_gyro_motion(still, rng, exposure_s=5, extent_px=10), "exposure_s"),
        (lambda: random_gyro_motion(still, rng, exposure_s=0.1, extent_px=0), "extent_px"),
    ):
        with pytest.raises(ValueError, match=said):
            call()
