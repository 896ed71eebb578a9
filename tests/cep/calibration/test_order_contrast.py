"""The contrast of orders, and the next code that it chooses, beside physics and brute force."""

import itertools

import numpy as np
import pytest

from cep.calibration.next_code import (
    NextCode,
    next_code,
    open_orders,
    search_next,
    survivors,
)
from cep.calibration.order_codes import longest_rest
from cep.calibration.order_contrast import OrderContrast, SceneLight
from cep.files.code_files import read_code, stored_device
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.search.limits import Limits, RunLimits
from hw.device import load_profile
from motdiff.estimators.base import MotionEstimate
from motdiff.estimators.coded.starts import orders
from motdiff.trajectory import Trajectory

CHIPS = 8
TIMES = np.linspace(0, 1, 53)
OPEN = np.ones(CHIPS)
# a straight run, a loop, and a run on
ANGLE = 2 * np.pi * np.clip((TIMES - 0.25) / 0.5, 0, 1)
LOOP = np.stack(
    [40 * TIMES - 8 * np.sin(ANGLE) - 20 * np.clip(TIMES - 0.25, 0, 0.5), 8 - 8 * np.cos(ANGLE)],
    axis=1,
)


def estimate_of(*paths, confidence=0.5):
    count = len(paths)
    return MotionEstimate(
        method="coded",
        trajectories=paths,
        weights=(1 / count,) * count,
        psf=paths[0].psf(129),
        confidence=confidence,
        details={"order_confidence": confidence},
    )


def test_orders_that_an_open_shutter_cannot_tell_are_told_by_the_designed_code():
    paths = open_orders([Trajectory.from_samples(LOOP)])
    assert len(paths) >= 2
    contrast = OrderContrast(paths, [OPEN], chips=CHIPS)
    code, least = search_next(contrast, Limits(CHIPS, (1, CHIPS)), rng=np.random.default_rng(0))
    opened = contrast.of([OPEN])[0]
    assert opened.max() < 1 < 1000 < least
    assert contrast.of([code]).min() == pytest.approx(least, rel=1e-3)


def test_a_small_smooth_deformation_and_a_shift_cost_next_to_nothing():
    bend = np.stack([0.3 * np.sin(2 * np.pi * TIMES), 0.3 * TIMES**2], axis=1)
    moved = LOOP + bend + [0.4, -0.2]
    reversed_loop = orders(Trajectory.from_samples(LOOP), knots=53, count=8)[-1]
    contrast = OrderContrast(np.stack([LOOP, moved, reversed_loop]), [OPEN], chips=CHIPS)
    deformed, order, _ = contrast.of([[1, 1, 0, 1, 0, 0, 1, 0]])[0]
    assert deformed < 1e-2 * order


def test_shifts_of_all_of_a_path_cost_nothing():
    contrast = OrderContrast(np.stack([LOOP, LOOP + np.array([30.0, -7.0])]), [OPEN], chips=CHIPS)
    assert contrast.of([[1, 1, 0, 1, 0, 0, 1, 0]])[0, 0] < 1e-2


def test_more_light_over_the_noise_tells_more_and_a_third_photo_adds():
    paths = open_orders([Trajectory.from_samples(LOOP)])
    code = [1, 0, 0, 1, 1, 1, 0, 0]
    dim, bright = (
        OrderContrast(paths, [OPEN], chips=CHIPS, scene=SceneLight(strength=s)).of([code])[0]
        for s in (50.0, 100.0)
    )
    assert np.all(bright >= dim)
    two = OrderContrast(paths, [OPEN, code], chips=CHIPS)
    three = two.of([[1, 1, 1, 1, 0, 0, 0, 0]])[0]
    assert np.all(three > two.taken())


@pytest.mark.parametrize("runs", [RunLimits(), RunLimits(min_open=2)])
def test_the_search_comes_near_the_best_of_all_codes(runs):
    limits = Limits(CHIPS, (1, CHIPS), runs)
    codes = np.array(list(itertools.product((0, 1), repeat=CHIPS)), dtype=np.int8)
    rests = np.array([longest_rest([code]) for code in codes])
    codes = codes[limits.satisfied(codes) & (rests <= 3)]  # log2 of 8 chips
    contrast = OrderContrast(open_orders([Trajectory.from_samples(LOOP)]), [OPEN], chips=CHIPS)
    best = contrast.of(codes).min(axis=1).max()
    code, least = search_next(contrast, limits, rng=np.random.default_rng(1))
    assert limits.satisfied(code[None])[0]
    assert longest_rest([code]) <= 3
    assert 0.9 * best < least <= (1 + 1e-3) * best


def test_a_shutter_rests_no_longer_than_the_photos_before_leave_it():
    contrast = OrderContrast(open_orders([Trajectory.from_samples(LOOP)]), [np.ones(52)], chips=52)
    limits = Limits(52, (1, 52))
    code, _ = search_next(contrast, limits, rng=np.random.default_rng(3))
    assert longest_rest([code]) <= 6
    fine = np.tile([1, 0], 26)  # it switches at every chip, so the next code may rest
    paths = open_orders([Trajectory.from_samples(LOOP)])
    finely = OrderContrast(paths, [np.ones(52), fine], chips=52)
    free, least = search_next(finely, limits, rng=np.random.default_rng(3))
    assert finely.of([code]).min() <= least == finely.of([free]).min()


def test_survivors_are_what_the_photos_leave_open():
    angle = 4 * np.pi * TIMES
    curls = np.stack([30 * TIMES - 8 * np.sin(angle), 8 * np.cos(angle)], axis=1)
    paths = open_orders([Trajectory.from_samples(curls)])
    by_open = OrderContrast(paths, [OPEN], chips=CHIPS)
    assert len(survivors(by_open, 1)) == len(paths) > 2
    by_two = OrderContrast(paths, [OPEN, [1, 1, 1, 1, 0, 0, 0, 0]], chips=CHIPS)
    assert 2 <= len(survivors(by_two, 1)) < len(paths)


def test_the_next_code_can_be_played_and_comes_back_from_its_file(tmp_path):
    rng = np.random.default_rng(0)
    scene = 0.1 + 0.8 * np.kron(rng.random((28, 28)), np.ones((8, 8)))
    path = Trajectory.from_samples(LOOP)
    photo = capture(scene, path, rng=rng)
    choice = next_code(
        [photo], (), estimate_of(path), chips=16, chip_ns=500_000, device="flc", rng=rng
    )
    assert isinstance(choice, NextCode)
    assert choice.chi_square > choice.before
    choice.save(tmp_path / "next.json")
    stored = read_code(tmp_path / "next.json")
    assert (stored.code.bits, stored.code.chip_ns) == (choice.code.bits, 500_000)
    assert stored.problem["next_code"]["reason"] == choice.reason
    assert stored_device(stored, source="next.json") == load_profile("flc")


@pytest.mark.parametrize(("sure", "asked"), [(0.9, False), (0.95, True)])
def test_another_photo_is_asked_for_until_the_order_is_sure(sure, asked):
    rng = np.random.default_rng(0)
    scene = 0.1 + 0.8 * np.kron(rng.random((28, 28)), np.ones((8, 8)))
    path = Trajectory.from_samples(LOOP)
    codes = [ShutterCode("1" * 16), ShutterCode("1101000101101110", 250_000)]
    photos = [capture(scene, path, code, rng=rng) for code in codes]
    estimate = estimate_of(path, path.reversed(), confidence=0.93)
    choice = next_code(photos, codes, estimate, least_probability=sure, rng=rng)
    assert (choice is not None) == asked
    if choice is not None:
        assert (choice.code.chips, choice.code.chip_ns) == (16, 1_000_000)
