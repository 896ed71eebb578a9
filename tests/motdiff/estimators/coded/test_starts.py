"""Starts: orders that draw the same PSF, paths decoded from exact kernels, and crossing that keeps
what both share."""

import numpy as np
import pytest

from motdiff.estimators.coded.starts import (
    crossed,
    decoded_paths,
    loop_reversals,
    loops_reordered,
    orders,
    random_sweeps,
)
from motdiff.metrics import mnc_subpixel
from motdiff.trajectory import Trajectory

KNOTS = 53


def eight(samples: int = 600) -> np.ndarray:
    """A figure of eight that is open at one end: it meets itself once."""
    turn = np.linspace(-0.3 * np.pi, 1.3 * np.pi, samples)
    return np.stack([14 * np.sin(turn), 9 * np.sin(2 * turn)], axis=1)


def curls(loops: int, samples: int = 600) -> np.ndarray:
    """Loops one after the other, the first and last of them open: one crossing less."""
    turn = np.linspace(0, 2 * np.pi * loops, samples)
    return np.stack([14 / (2 * np.pi) * turn - 9 * np.sin(turn), -9 * np.cos(turn)], axis=1)


def apart_px(a: np.ndarray, b: np.ndarray) -> float:
    """Rms distance at equal times, after centring."""
    difference = (a - a.mean(axis=0)) - (b - b.mean(axis=0))
    return float(np.sqrt((difference**2).sum(axis=1).mean()))


@pytest.mark.parametrize(
    ("points", "count"),
    [(eight(), 4), (curls(2), 4), (curls(3), 8), (np.linspace((0, 0), (20, 5), 60), 2)],
    ids=["eight", "two curls", "three curls", "line"],
)
def test_orders_are_all_that_draw_the_same_psf(points: np.ndarray, count: int) -> None:
    path = Trajectory.from_samples(points)
    psf = path.psf()
    found = orders(path, knots=401, count=48)
    assert found.shape == (count, 401, 2)
    for order in found:
        assert mnc_subpixel(Trajectory.from_samples(order).psf(), psf) > 0.999
    distances = [apart_px(a, b) for i, a in enumerate(found) for b in found[:i]]
    assert min(distances) > 3  # none comes twice
    np.testing.assert_allclose(found[0], path.at(np.linspace(0, 1, 401)), atol=1e-9)
    np.testing.assert_allclose(found[1], found[0][::-1], atol=1e-9)


@pytest.mark.parametrize("most", [1, 2, 5])
def test_orders_are_no_more_than_asked_for(most: int) -> None:
    path = Trajectory.from_samples(curls(3))
    found = orders(path, knots=KNOTS, count=most)
    assert 1 <= len(found) <= most
    np.testing.assert_allclose(found[0], path.at(np.linspace(0, 1, KNOTS)), atol=1e-9)


def clover(leaves: int, knots: int) -> np.ndarray:
    """Path (K, 2) of loops that all begin and end at the origin, each larger than the last."""
    t = np.linspace(0, 1, (knots - 1) // leaves + 1)[:-1]
    rise = np.stack([np.sin(np.pi * t) * np.cos(t - 0.5), np.sin(np.pi * t) * np.sin(t - 0.5)], 1)
    loops = []
    for leaf in range(leaves):
        angle = 2 * np.pi * leaf / leaves
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        loops.append((12 + 3 * leaf) * rise @ turn)
    return np.concatenate([*loops, [[0.0, 0.0]]])


def test_loop_reversals_turn_one_loop_round() -> None:
    points = curls(3, samples=401)
    rng = np.random.default_rng(0)
    found = loop_reversals(points, count=9, rng=rng)
    assert len(found) == 2
    psf = Trajectory.from_samples(points).psf()
    for turned in found:
        assert turned.shape == points.shape
        assert apart_px(turned, points) > 3
        np.testing.assert_allclose(turned[[0, -1]], points[[0, -1]])
        np.testing.assert_allclose(
            np.sort(turned, axis=0), np.sort(points, axis=0)
        )  # the same places
        assert mnc_subpixel(Trajectory.from_samples(turned).psf(), psf) > 0.99
    assert len(loop_reversals(points, count=1, rng=rng)) == 1


def test_where_there_is_no_loop_the_whole_is_reversed() -> None:
    line = np.linspace((0, 0), (20, 5), KNOTS)
    (turned,) = loop_reversals(line, count=4, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(turned, line[::-1])


def test_loops_at_one_place_come_in_any_order_and_direction() -> None:
    points = clover(3, 91)
    rng = np.random.default_rng(0)
    tips = points[15::30]
    orders_of_leaves = set()
    for _ in range(300):
        child = loops_reordered(points, rng=rng)
        if child is None:
            continue
        assert child.shape == points.shape
        assert np.linalg.norm(np.diff(child, axis=0), axis=1).max() < 3  # it never jumps
        distance = np.linalg.norm(child[15::30, None] - tips, axis=-1)
        if distance.min(axis=1).max() < 2.5:  # else strands that pass elsewhere were exchanged
            orders_of_leaves.add(tuple(distance.argmin(axis=1)))
    assert len(orders_of_leaves) >= 4


def test_a_path_that_meets_itself_nowhere_has_no_loops() -> None:
    line = np.linspace((0, 0), (20, 5), KNOTS)
    assert loops_reordered(line, rng=np.random.default_rng(0)) is None


def test_crossing_takes_a_stretch_of_the_other_path() -> None:
    t = np.linspace(0, 1, KNOTS)
    path = np.stack([20 * t, 0 * t], axis=1)
    other = path + np.stack(
        [0 * t, 6 * np.sin(2 * np.pi * t) * np.where(t < 0.5, 1, -0.8)], axis=1
    )
    children = [crossed(path, other, rng=np.random.default_rng(seed)) for seed in range(12)]
    for child in children:
        assert child is not None
        assert child.shape == path.shape
        # at every moment it goes with one of the two, and it never jumps
        nearest = np.minimum(
            np.linalg.norm(child - path, axis=1), np.linalg.norm(child - other, axis=1)
        )
        assert nearest.max() < 1.5
        steps = [
            np.linalg.norm(np.diff(walk, axis=0), axis=1).max() for walk in (child, path, other)
        ]
        assert steps[0] < max(steps[1:]) + 0.5
    assert len({round(apart_px(child, path), 6) for child in children}) > 1
    np.testing.assert_array_equal(path[:, 1], 0 * t)  # the parents stay as they are


def test_equal_paths_have_no_child() -> None:
    points = eight(KNOTS)
    assert crossed(points, points + 0.1, rng=np.random.default_rng(0)) is None


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("shift_px", [(0, 0), (2.0, -1.0)])
def test_an_l_is_decoded_from_exact_kernels(
    backwards: bool, shift_px: tuple[int, int], gray_codes, coded_psf
) -> None:
    corner = np.interp(np.linspace(0, 2, 201)[:, None], [0, 1, 2], [0, 0, 1])
    legs = 12 * np.concatenate(
        [np.interp(np.linspace(0, 2, 201)[:, None], [0, 1, 2], [0, 1, 1]), corner], axis=1
    )
    path = Trajectory.from_samples(legs[::-1] if backwards else legs)
    codes = ("1" * 52, *gray_codes(52, 3))
    shifts = np.array([(0, 0), shift_px, (0, 0), shift_px])
    kernels = [
        coded_psf(path, code, shift_px=shift) for code, shift in zip(codes, shifts, strict=True)
    ]
    truth = path.at(np.linspace(0, 1, KNOTS))
    for known in (shifts, None) if shift_px == (0, 0) else (shifts,):
        rng = np.random.default_rng(0)
        found = decoded_paths(
            kernels, codes, knots=KNOTS, count=24, length_px=path.length_px, rng=rng, shifts=known
        )
        assert found.shape == (24, KNOTS, 2)
        errors = [apart_px(drawn, truth) for drawn in found]
        assert np.median(errors) < 1.5
        assert max(errors) < 3
        assert min(apart_px(drawn[::-1], truth) for drawn in found) > 5


def test_decoded_paths_lie_on_the_first_kernel(coded_psf, gray_codes) -> None:
    path = Trajectory.from_samples(np.linspace((0, 0), (16, 8), 60))
    codes = ("1" * 52, *gray_codes(52, 3))
    place = np.array([4.0, -3.0])
    kernels = [coded_psf(path, code, shift_px=place) for code in codes]
    found = decoded_paths(
        kernels, codes, knots=KNOTS, count=24, length_px=18, rng=np.random.default_rng(1)
    )
    np.testing.assert_allclose(found.mean(axis=(0, 1)), place, atol=0.7)


def test_draws_depend_on_the_generator_alone(coded_psf, gray_codes) -> None:
    path = Trajectory.from_samples(eight())
    codes = ("1" * 52, *gray_codes(52, 2))
    kernels = [coded_psf(path, code) for code in codes]
    draws = [
        decoded_paths(
            kernels, codes, knots=KNOTS, count=4, length_px=60, rng=np.random.default_rng(seed)
        )
        for seed in (0, 0, 1)
    ]
    np.testing.assert_array_equal(draws[0], draws[1])
    assert np.abs(draws[0] - draws[2]).max() > 0.1


def test_sweeps_are_cubic_in_time_and_of_the_extents_asked_for() -> None:
    extents_px = np.array([5.0, 20.0, 50.0])
    paths = random_sweeps(np.random.default_rng(0), 27, extents_px)
    assert np.ptp(paths, axis=1).max(axis=1) == pytest.approx(extents_px)
    assert np.diff(paths, n=4, axis=1) == pytest.approx(0, abs=1e-9)
