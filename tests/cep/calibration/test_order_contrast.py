"""The contrast of orders, and the next code that it chooses, beside physics and brute force."""

import numpy as np
import pytest

from cep.calibration.next_code import (
    NextCode,
    next_code,
    next_limits,
    open_orders,
    survivors,
)
from cep.calibration.order_codes import search_next
from cep.calibration.order_contrast import OrderContrast, SceneLight
from cep.files.code_files import read_code, stored_device
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from cep.search.limits import Limits
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
    paths, _ = open_orders([Trajectory.from_samples(LOOP)])
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


def test_pairs_and_photos_that_are_chosen_have_the_figures_that_they_have_among_all():
    paths = np.stack([LOOP, LOOP[::-1], 0.7 * LOOP[::-1]])
    codes = ([1, 1, 0, 1, 0, 0, 1, 0], [1, 0, 0, 1, 1, 1, 0, 0])
    contrast = OrderContrast(paths, [OPEN], chips=CHIPS)
    every = contrast.of(codes)
    some = np.array([2, 0])
    assert contrast.among(some).of(codes) == pytest.approx(every[:, some], rel=1e-3)
    assert contrast.after(codes[0]).taken() == pytest.approx(every[0], rel=1e-3)
    backwards = OrderContrast(paths, [OPEN], chips=CHIPS, pairs=contrast.pairs[:, :1])
    assert backwards.of(codes)[:, 0] == pytest.approx(every[:, 0], rel=1e-3)


def test_the_light_of_a_scene_is_measured_where_it_has_texture():
    rng = np.random.default_rng(2)
    scene = 0.1 + 0.8 * np.kron(rng.random((40, 40)), np.ones((8, 8)))
    path = Trajectory.straight(9.0)
    textured = capture(scene, path, rng=rng)
    flat = np.full((560, 700), 0.5) + rng.normal(0, 0.005, (560, 700))
    flat[:200, :200] = textured[:200, :200]
    strengths = [SceneLight.of(photo, path).strength for photo in (textured[:200, :200], flat)]
    assert strengths[1] > 0.3 * strengths[0] > 1


def test_more_light_over_the_noise_tells_more_and_a_third_photo_adds():
    paths, _ = open_orders([Trajectory.from_samples(LOOP)])
    code = [1, 0, 0, 1, 1, 1, 0, 0]
    dim, bright = (
        OrderContrast(paths, [OPEN], chips=CHIPS, scene=SceneLight(strength=s)).of([code])[0]
        for s in (50.0, 100.0)
    )
    assert np.all(bright >= dim)
    two = OrderContrast(paths, [OPEN, code], chips=CHIPS)
    three = two.of([[1, 1, 1, 1, 0, 0, 0, 0]])[0]
    assert np.all(three > two.taken())


def test_survivors_are_what_the_photos_leave_open():
    angle = 4 * np.pi * TIMES
    curls = np.stack([30 * TIMES - 8 * np.sin(angle), 8 * np.cos(angle)], axis=1)
    paths, _ = open_orders([Trajectory.from_samples(curls)])
    by_open = OrderContrast(paths, [OPEN], chips=CHIPS)
    assert len(survivors(by_open, 1)) == len(paths) > 2
    by_two = OrderContrast(paths, [OPEN, [1, 1, 1, 1, 0, 0, 0, 0]], chips=CHIPS)
    assert 2 <= len(survivors(by_two, 1)) < len(paths)


def test_paths_nearly_alike_count_once_among_those_that_explain_the_photos():
    path = Trajectory.from_samples(LOOP)
    near = Trajectory.from_samples(LOOP + np.stack([1.2 * TIMES, 0 * TIMES], axis=1))
    paths, count = open_orders([path, near, path.reversed()])
    assert count == 2
    assert paths[0] == pytest.approx(LOOP - LOOP.mean(axis=0), abs=0.5)
    assert paths[1] == pytest.approx(paths[0][::-1], abs=0.5)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"least_probability": 0.98}, "least_probability: must be within 0..0.97"),
        ({"device": "mechanical", "chip_ns": 10}, "mechanical"),
        ({"device": "nothing"}, "'nothing' is unknown"),
    ],
)
def test_what_no_next_code_can_be_is_refused_before_the_search(options, named):
    with pytest.raises(ValueError, match=named):
        next_limits((), **options)


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
