"""Paths drawn from kernels seen through codes, and stretches led through the light left."""

from __future__ import annotations

import numpy as np
import pytest

from motdiff.estimators.coded.path_measure import PathMeasure
from motdiff.metrics import timed_distance_px
from motdiff.trajectory import Trajectory

OPEN = "1" * 52
HALF = "1" * 26 + "0" * 26
RASKAR = "1010000111000001010000110011110111010111001001100111"
KNOTS = 27
TIMES = np.linspace(0, 1, 401)
BENT = Trajectory.from_samples(
    np.stack([24 * TIMES - 12, 9 * np.sin(2 * np.pi * TIMES)], axis=1), direction="known"
)


def kernels_of(path: Trajectory, codes: tuple[str, ...]) -> list[np.ndarray]:
    """PSF of each code, by brute force: the light of 20 moments of each chip on the pixels."""
    kernels = []
    for code in codes:
        moments = (np.arange(20 * len(code)) + 0.5) / (20 * len(code))
        is_open = np.repeat(np.array(list(code)) == "1", 20)
        column, row = np.rint(path.at(moments)[is_open].T).astype(int) + 20
        kernel = np.zeros((41, 41))
        np.add.at(kernel, (row, column), 1.0)
        kernels.append(kernel / kernel.sum())
    return kernels


def distances(paths: np.ndarray, truth: Trajectory) -> np.ndarray:
    return np.array(
        [timed_distance_px(Trajectory.from_samples(p, direction="known"), truth) for p in paths]
    )


def test_the_light_of_the_draws_is_that_of_the_kernel() -> None:
    (kernel,) = kernels_of(BENT, (OPEN,))
    draws = PathMeasure([kernel], [OPEN]).draw(300, knots=105, rng=np.random.default_rng(0))
    column, row = np.rint(draws.reshape(-1, 2).T).astype(int) + 20
    light = np.zeros_like(kernel)
    np.add.at(light, (row, column), 1 / (300 * 105))
    # by columns of 4 px, as draws are smooth and the kernel is not
    assert np.abs(light.sum(axis=0) - kernel.sum(axis=0))[:40].reshape(-1, 4).sum(
        axis=1
    ).max() == pytest.approx(0, abs=0.08)


def test_an_open_photo_leaves_both_directions_and_a_coded_one_does_not():
    rng = np.random.default_rng(1)
    opened = PathMeasure(kernels_of(BENT, (OPEN,)), [OPEN]).draw(60, knots=KNOTS, rng=rng)
    coded = PathMeasure(kernels_of(BENT, (OPEN, HALF)), [OPEN, HALF]).draw(
        60, knots=KNOTS, rng=rng
    )
    ahead_open = distances(opened, BENT) < distances(opened, BENT.reversed())
    ahead_coded = distances(coded, BENT) < distances(coded, BENT.reversed())
    assert 0.2 < ahead_open.mean() < 0.8
    assert ahead_coded.mean() > 0.95


@pytest.mark.parametrize("chips", [4, 8, 20])
def test_few_chips_draw_paths_as_long(chips):
    """A step is a share of a chip that is short enough for the path."""
    codes = ("1" * chips, "1" * (chips // 2) + "0" * (chips - chips // 2))
    draws = PathMeasure(kernels_of(BENT, codes), codes).draw(
        20, knots=KNOTS, rng=np.random.default_rng(5)
    )
    assert np.median(np.ptp(draws, axis=1)[:, 0]) > 0.65 * np.ptp(BENT.xy[:, 0])
    assert np.median(distances(draws, BENT)) < 5


def test_a_stretch_that_left_the_light_is_led_back():
    codes = (OPEN, RASKAR)
    measure = PathMeasure(kernels_of(BENT, codes), codes)
    truth = BENT.at(np.linspace(0, 1, KNOTS))
    wrong = truth.copy()
    wrong[8:20] = np.linspace(truth[8], truth[19], 12)  # straight across the bend
    rng = np.random.default_rng(2)
    rerouted = np.stack([measure.rerouted(wrong, rng=rng) for _ in range(40)])
    before = distances(wrong[None], BENT)[0]
    assert distances(rerouted, BENT).min() < 0.6 * before


def test_a_rerouted_path_keeps_the_rest_and_its_joints():
    codes = (OPEN, HALF)
    measure = PathMeasure(kernels_of(BENT, codes), codes)
    truth = BENT.at(np.linspace(0, 1, KNOTS))
    given = truth.copy()
    rng = np.random.default_rng(3)
    for _ in range(20):
        child = measure.rerouted(given, rng=rng)
        changed = np.flatnonzero(np.abs(child - given).max(axis=1) > 0)
        assert len(changed) <= 0.65 * KNOTS
        assert (np.diff(changed) == 1).all()
        # 52 steps of at most 3 px between 27 knots
        assert np.linalg.norm(np.diff(child, axis=0), axis=1).max() < 3 * 52 / 26 + 2
    assert (given == truth).all()


def test_two_stretches_that_hold_each_others_light_exchange_it():
    codes = (OPEN, RASKAR)
    there = 24 * np.linspace(0, 1, 201) - 12
    bulge = 2 * np.exp(-((there / 3) ** 2))
    points = np.concatenate([np.stack([there, bulge], 1), np.stack([there[::-1], -bulge], 1)])
    truth = Trajectory.from_samples(points, direction="known")
    measure = PathMeasure(kernels_of(truth, codes), codes)
    wrong = truth.at(np.linspace(0, 1, KNOTS)) * [1, -1]  # out below and back above
    before = distances(wrong[None], truth)[0]
    rng = np.random.default_rng(5)
    exchanged = [measure.exchanged(wrong, rng=rng) for _ in range(200)]
    rerouted = [measure.rerouted(wrong, rng=rng) for _ in range(200)]
    assert distances(np.stack(exchanged), truth).min() < 0.6 * before
    # one alone finds no light but its own
    assert distances(np.stack(rerouted), truth).min() > 0.6 * before


def test_exchanged_stretches_are_apart_and_keep_the_rest(monkeypatch):
    codes = (OPEN, HALF)
    measure = PathMeasure(kernels_of(BENT, codes), codes)
    given = BENT.at(np.linspace(0, 1, KNOTS))
    rng = np.random.default_rng(6)
    pairs = []
    redrawn = measure._redrawn

    def noted(path, stretches, rng):
        pairs.append(sorted(stretches))
        return redrawn(path, stretches, rng)

    monkeypatch.setattr(measure, "_redrawn", noted)
    for _ in range(60):
        child = measure.exchanged(given, rng=rng)
        (_, first_stop), (second_start, _) = pairs[-1]
        assert first_stop <= second_start
        assert (np.abs(child - given).max(axis=1) > 0).sum() <= 0.5 * KNOTS
        assert np.linalg.norm(np.diff(child, axis=0), axis=1).max() < 3 * 52 / 26 + 2


def test_a_path_that_leaves_the_kernels_frame_is_led_back():
    codes = (OPEN, HALF)
    measure = PathMeasure(kernels_of(BENT, codes), codes)
    line = np.linspace((-90, -90), (90, 90), KNOTS)
    for seed in range(8):
        led = measure.rerouted(line, rng=np.random.default_rng(seed))
        changed = np.abs(led - line).max(axis=1) > 1
        assert changed.any()
        assert np.abs(led[changed]).max() < np.abs(line).max()


def test_times_of_which_no_photo_tells_are_led_anywhere():
    first, second = "1" * 40 + "0" * 12, "0" * 12 + "1" * 28 + "0" * 12
    measure = PathMeasure(kernels_of(BENT, (first, second)), (first, second))
    path = BENT.at(np.linspace(0, 1, KNOTS))
    rng = np.random.default_rng(4)
    assert all(np.isfinite(measure.rerouted(path, rng=rng)).all() for _ in range(10))
