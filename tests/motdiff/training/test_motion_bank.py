"""The bank holds what its trajectories say: PSFs, HR maps and dwell, each motion by its own
number."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn import functional

from motdiff.gyro import GyroTrace
from motdiff.metrics import mnc, register_shift
from motdiff.training import motion_bank
from motdiff.training.motion_bank import (
    MotionMix,
    bank_of,
    build_bank,
    draw_motion,
    drawn_kinds,
    drawn_motions,
    dwell_on_map,
)
from motdiff.trajectory import Trajectory

ALL_KINDS = MotionMix(boracchi_foi=1, boracchi_foi_short=1, straight=1, quadratic=1)
NOTHING = MotionMix(boracchi_foi=0, straight=1e-9)
"""To be replaced by one kind: a mix may not be empty."""


def same(a, b):
    return all(
        torch.equal(getattr(a, name), getattr(b, name))
        for name in ("psfs", "pixels", "dwell", "starts")
    )


def motions(mix, *, count, seed=0, trace=None):
    """Draw each from the generator of its number."""
    return [
        draw_motion(mix, np.random.default_rng([seed, index]), trace) for index in range(count)
    ]


def seen_by_pixels(dwell):
    """PSF (64, 64) of a map: each map pixel as a point of that dwell, seen through the bilinear
    hat of each pixel."""
    offset = (np.arange(256) - 129.5) / 4 - (np.arange(64)[:, None] - 32)
    hat = np.maximum(1 - np.abs(offset), 0)
    return hat @ dwell @ hat.T / dwell.sum()


# ---- the bank


def test_targets_are_those_of_the_drawn_trajectories():
    bank = build_bank(ALL_KINDS, count=9, seed=3)
    index = torch.tensor([7, 2, 2, 0, 8])
    psf, x0, dwell = bank.targets(index)
    assert psf.dtype == x0.dtype == dwell.dtype == torch.float32
    assert x0.shape == dwell.shape == (5, 1, 256, 256)
    drawn = motions(ALL_KINDS, count=9, seed=3)
    for place, number in enumerate(index.tolist()):
        motion = drawn[number]
        np.testing.assert_allclose(
            psf[place], motion.psf(64), rtol=1e-3, atol=1e-7
        )  # half precision
        hr_map = motion.hr_map()
        np.testing.assert_array_equal(x0[place, 0], hr_map)
        on_path = dwell[place, 0].numpy()[hr_map > 0]
        np.testing.assert_allclose(on_path, dwell_on_map(motion, hr_map), rtol=1e-3)
        assert on_path.mean() == pytest.approx(1, abs=1e-3)
        assert not dwell[place, 0].numpy()[hr_map == 0].any()


def test_dwell_on_the_map_is_the_psf():
    """The box mean alone is centred right, but finer than a PSF, which sees each point through a
    bilinear hat."""
    bank = build_bank(ALL_KINDS, count=10, seed=0)
    psfs, _, dwell = bank.targets(torch.arange(10))
    boxes = functional.avg_pool2d(dwell, 4)[:, 0]
    for psf, fine, box in zip(
        psfs.double().numpy(), dwell[:, 0].double().numpy(), boxes.double().numpy(), strict=True
    ):
        seen = seen_by_pixels(fine)
        assert mnc(psf, seen) > 0.99
        np.testing.assert_allclose(register_shift(psf, seen), 0, atol=0.05 + 1e-9)
        assert mnc(psf, box) > 0.9
        np.testing.assert_allclose(register_shift(psf, box), 0, atol=0.1 + 1e-9)
        lag = np.arange(64) - 32
        centroid = [(box.sum(axis=axis) * lag).sum() / box.sum() for axis in (0, 1)]
        np.testing.assert_allclose(centroid, 0, atol=0.1)


def test_motions_depend_on_seed_and_number_only():
    whole = build_bank(ALL_KINDS, count=8, seed=1)
    tail = bank_of(drawn_motions(ALL_KINDS, seed=1, indices=range(5, 8)))
    for mine, theirs in zip(
        tail.targets(torch.arange(3)), whole.targets(torch.arange(5, 8)), strict=True
    ):
        assert torch.equal(mine, theirs)
    assert len(whole) == 8
    assert len(tail) == 3
    assert not torch.equal(whole.psfs, build_bank(ALL_KINDS, count=8, seed=2).psfs)


@pytest.mark.filterwarnings(
    "ignore:.*fork:DeprecationWarning"
)  # Python >= 3.12, after any other thread was started
def test_workers_change_nothing(monkeypatch):
    alone = build_bank(ALL_KINDS, count=11, seed=4)
    monkeypatch.setattr(motion_bank, "_CHUNK", 3)
    assert same(alone, build_bank(ALL_KINDS, count=11, seed=4))
    assert same(alone, build_bank(ALL_KINDS, count=11, seed=4, workers=2))


def test_one_worker_starts_no_process(monkeypatch):
    def refused(*_arguments, **_options):
        raise RuntimeError("a process was started")

    monkeypatch.setattr(motion_bank, "ProcessPoolExecutor", refused)
    assert len(build_bank(ALL_KINDS, count=2, seed=4)) == 2
    with pytest.raises(RuntimeError, match="a process was started"):
        build_bank(ALL_KINDS, count=2, seed=4, workers=2)


def test_a_bank_moves_as_a_whole():
    bank = build_bank(NOTHING, count=2, seed=0)
    moved = bank.to("meta")
    assert {
        tensor.device.type for tensor in (moved.psfs, moved.pixels, moved.dwell, moved.starts)
    } == {"meta"}
    assert same(bank, bank.to("cpu"))


@pytest.mark.parametrize("count", [0, -1])
def test_empty_banks_are_refused(count):
    with pytest.raises(ValueError, match=f"^count: must be at least 1, got {count}$"):
        build_bank(ALL_KINDS, count=count, seed=0)


# ---- dwell


def test_dwell_is_the_time_spent():
    """Three quarters of the time on the first half of a line: 3/2 of the mean there, 1/2 on the
    other half."""
    motion = Trajectory.from_samples([[0, 0], [12, 0], [24, 0]], t=[0, 0.75, 1])
    hr_map = motion.hr_map()
    dwell = dwell_on_map(motion, hr_map)
    assert len(dwell) == int(hr_map.sum()) == 97
    assert dwell.mean() == pytest.approx(1)
    np.testing.assert_allclose(dwell[2:47], 1.5, atol=0.05)
    np.testing.assert_allclose(dwell[50:-2], 0.5, atol=0.05)


def test_dwell_counts_both_passes_of_a_path_that_turns_back():
    """Forth over 16 px and back over 8 px at one speed: twice the time where it passes twice."""
    motion = Trajectory.from_samples([[0, 0], [0, 16], [0, 8]], t=[0, 2, 3])
    dwell = dwell_on_map(motion, motion.hr_map())
    np.testing.assert_allclose(dwell[2:30], 65 / 96, atol=0.06)
    np.testing.assert_allclose(dwell[36:63], 130 / 96, atol=0.06)


# ---- the mix


def lengths(drawn):
    return np.array([motion.length_px for motion in drawn])


def test_boracchi_foi_has_the_full_length_and_its_short_kind_any():
    full = motions(MotionMix(max_length_px=45), count=5)
    np.testing.assert_allclose(lengths(full), 45)
    short = replace(NOTHING, straight=0, boracchi_foi_short=1, min_length_px=20, max_length_px=30)
    drawn = lengths(motions(short, count=30))
    assert 20 <= drawn.min() < 22
    assert 28 < drawn.max() <= 30


def test_straight_motions_are_straight():
    drawn = motions(replace(NOTHING, min_length_px=7, max_length_px=9), count=10)
    for motion in drawn:
        assert math.hypot(*(motion.xy[-1] - motion.xy[0])) == pytest.approx(motion.length_px)
    assert 7 <= lengths(drawn).min() < lengths(drawn).max() <= 9


def test_quadratic_motions_have_a_constant_acceleration():
    drawn = motions(
        replace(NOTHING, straight=0, quadratic=1, min_length_px=7, max_length_px=9), count=10
    )
    for motion in drawn:
        acceleration = np.diff(motion.xy, n=2, axis=0)
        np.testing.assert_allclose(acceleration - acceleration[0], 0, atol=1e-9)
        assert np.abs(acceleration[0]).max() > 1e-9
    assert 7 <= lengths(drawn).min() < lengths(drawn).max() <= 9


def test_kinds_come_by_their_shares():
    """Told apart by their samples: 2 on a straight path, 200 on a quadratic one."""
    mix = replace(NOTHING, straight=3, quadratic=1, min_length_px=5, max_length_px=10)
    straight = sum(motion.t.size == 2 for motion in motions(mix, count=400))
    assert abs(straight - 300) < 4 * math.sqrt(400 * 0.75 * 0.25)


def test_the_kinds_of_a_bank_are_those_of_its_motions():
    mix = MotionMix(boracchi_foi=0.5, straight=0.5, max_length_px=30)
    kinds = drawn_kinds(mix, count=12, seed=4)
    drawn = drawn_motions(mix, seed=4, indices=range(12))
    straight = [motion.t.size == 2 for motion in drawn]
    assert [kind == "straight" for kind in kinds] == straight
    assert set(kinds) == {"boracchi_foi", "straight"}


def test_gyro_motions_come_from_the_recording(tmp_path):
    rng = np.random.default_rng(0)
    rates = 0.01 * np.cumsum(rng.standard_normal((1500, 3)), axis=0)
    trace = GyroTrace(np.arange(1500) / 200, rates - rates.mean(axis=0))
    file = tmp_path / "gyro.csv"
    file.write_text(
        "t_s,x,y,z\n"
        + "\n".join(f"{t},{x},{y},{z}" for t, (x, y, z) in zip(trace.t_s, rates, strict=True))
    )
    mix = replace(
        NOTHING, straight=0, gyro=1, gyro_trace=str(file), min_extent_px=10, max_extent_px=14
    )
    for motion in motions(mix, count=8, trace=trace):
        assert 10 <= motion.extent_px <= 14
    bank = build_bank(mix, count=4, seed=0)
    _, x0, _ = bank.targets(torch.arange(4))
    for one in x0[:, 0]:
        rows, columns = torch.nonzero(one, as_tuple=True)
        assert (
            39 <= max(int(rows.max() - rows.min()), int(columns.max() - columns.min())) <= 57
        )  # 4 map px per px
    with pytest.raises(
        ValueError, match=r"^trace: motions.gyro > 0 needs a gyroscope recording, got none$"
    ):
        draw_motion(mix, np.random.default_rng(0))


def test_every_drawn_motion_fits_the_frame():
    mix = replace(NOTHING, min_length_px=55, max_length_px=75)  # some of these do not
    for motion in motions(mix, count=40):
        assert motion.frame_size() <= 64
    with pytest.raises(
        ValueError, match=r"^max_length_px: 100 drawn motions did not fit 64 px, got 200$"
    ):
        draw_motion(
            replace(NOTHING, min_length_px=190, max_length_px=200), np.random.default_rng(0)
        )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"boracchi_foi": -1}, "^motions: the shares must be non-negative and not all zero"),
        ({"boracchi_foi": 0}, "^motions: the shares must be non-negative and not all zero"),
        ({"gyro": 0.1}, "^gyro_trace: motions.gyro > 0 needs a gyroscope recording$"),
        (
            {"min_length_px": 0},
            "^min_length_px: must be positive and at most max_length_px, got 0 and 60",
        ),
        ({"min_length_px": 9, "max_length_px": 8}, "^min_length_px: .* got 9 and 8$"),
        ({"max_length_px": math.nan}, "^min_length_px"),
    ],
)
def test_bad_mixes(options, said):
    with pytest.raises(ValueError, match=said):
        MotionMix(**options)
