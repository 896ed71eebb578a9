"""A shutter's ramps, delay and bias along a motion: closed forms, and chips added one by one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis, chip_parts, chip_rows, coded_otf, coded_psf, open_path
from cep.optics.response import RAMP_STEPS, ShutterResponse
from cep.optics.timeline import extended, timeline
from motdiff.trajectory import Trajectory

FX, FY = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 40))


def walk(seed, samples=25):
    rng = np.random.default_rng(seed)
    t = np.concatenate([[0], np.sort(rng.uniform(0.01, 0.99, samples - 2)), [1]])
    return Trajectory.from_samples(np.cumsum(rng.normal(0, 1.5, (samples, 2)), axis=0), t=t)


def finer(bits, parts, *, before=0, after=0):
    """Cut every chip in ``parts``; each pulse begins ``before`` parts later and ends ``after``
    parts later."""
    fine = np.repeat([int(bit) for bit in f"{bits}0"], parts)
    rises, falls = (np.flatnonzero(np.diff(fine, prepend=0, append=0) == way) for way in (1, -1))
    moved = np.zeros_like(fine)
    for rise, fall in zip(rises, falls, strict=True):
        moved[rise + before : fall + after] = 1
    return ShutterCode(moved)


codes = st.text("01", min_size=1, max_size=14).filter(lambda bits: "1" in bits).map(ShutterCode)
walks = st.integers(0, 10_000).map(walk)
shares = st.sampled_from([0.0, 0.25, 0.5])
shutters = st.builds(
    lambda rise, fall, delay, bias: ShutterResponse(
        chip_ns=1000,
        rise_ns=1000 * rise,
        fall_ns=1000 * fall,
        on_delay_ns=1000 * delay,
        on_bias_ns=1000 * bias,
    ),
    shares,
    st.floats(0, 0.5),
    shares,
    shares,
)


@given(walks, codes, shutters, st.data())
@settings(max_examples=60, deadline=None)
def test_chips_opened_one_by_one_add_up_to_the_code(path, code, shutter, data):
    order = data.draw(st.permutations(range(code.chips)))
    rows = chip_rows(path, code.chips, FX, FY, response=shutter)
    state = np.zeros(code.chips + 2, dtype=int)
    otf = np.zeros(FX.size, dtype=complex)
    for chip in order:
        otf = otf + rows[chip, state[chip], state[chip + 2]]
        state[chip + 1] = 1
    for chip in order:  # and close those that are closed: the negative row of the same neighbours
        if code.bits[chip] == "0":
            otf = otf - rows[chip, state[chip], state[chip + 2]]
            state[chip + 1] = 0
    assert np.abs(otf - coded_otf(path, code, FX, FY, response=shutter)).max() < 1e-12


@given(walks, codes, shutters)
@settings(max_examples=30, deadline=None)
def test_light_counts_transitions(path, code, shutter):
    light = float(coded_otf(path, code, 0.0, 0.0, response=shutter).real)
    gain = shutter.on_bias_ns + 0.5 * shutter.fall_ns - shutter.on_delay_ns - 0.5 * shutter.rise_ns
    assert light == pytest.approx((code.open_chips + code.pulses * gain / 1000) / code.chips)
    assert shutter.open_time(code.array[None]) == pytest.approx([light])
    assert open_path(path, code, response=shutter).dt.sum() == pytest.approx(light)
    assert coded_psf(path, code, 3 * path.frame_size(), response=shutter).sum() == pytest.approx(
        light
    )


@given(codes, st.floats(5, 60), st.floats(0, 1))
@settings(max_examples=40, deadline=None)
def test_equal_ramps_on_a_straight_motion_are_one_more_box(code, length, share):
    shutter = ShutterResponse(chip_ns=1e6, rise_ns=share * 1e6, fall_ns=share * 1e6)
    path = Trajectory.straight(length)
    f = np.linspace(0, 0.5, 50)
    ramp_px = share * length / code.chips
    instant = np.abs(coded_otf(path, code, f, 0.0))
    slow = np.abs(coded_otf(path, code, f, 0.0, response=shutter))
    stair = np.pi * f * ramp_px / (6 * RAMP_STEPS**2) * share * 2 * code.pulses / code.chips
    assert (np.abs(slow - instant * np.abs(np.sinc(f * ramp_px))) <= stair + 1e-12).all()


@given(codes, st.floats(5, 60), st.floats(0, 0.9))
@settings(max_examples=20, deadline=None)
def test_delay_with_equal_bias_only_shifts_a_straight_motion(code, length, share):
    shutter = ShutterResponse(chip_ns=1e6, on_delay_ns=share * 1e6, on_bias_ns=share * 1e6)
    path = Trajectory.straight(length)
    f = np.linspace(-0.5, 0.5, 50)
    shift = np.exp(-2j * np.pi * f * share * length / code.chips)
    assert (
        np.abs(
            coded_otf(path, code, f, 0.0, response=shutter) - shift * coded_otf(path, code, f, 0.0)
        ).max()
        < 1e-11
    )


@given(walks, codes, st.integers(0, 3), st.integers(0, 4))
@settings(max_examples=30, deadline=None)
def test_delay_and_bias_move_the_ends_of_every_pulse(path, code, delay, bias):
    # a closed chip at the end keeps the last tail within the exposure
    code = ShutterCode(code.bits + "0")
    shutter = ShutterResponse(chip_ns=400, on_delay_ns=100 * delay, on_bias_ns=100 * bias)
    fine = finer(code.bits[:-1], 4, before=delay, after=bias)
    assert fine.chips == 4 * code.chips
    assert (
        np.abs(
            coded_otf(path, code, FX, FY, response=shutter) - coded_otf(path, fine, FX, FY)
        ).max()
        < 1e-12
    )
    assert (
        np.abs(coded_psf(path, code, 128, response=shutter) - coded_psf(path, fine, 128)).max()
        < 1e-12
    )


def test_ramps_are_stairs_as_fine_as_they_say():
    path = walk(5)
    code = ShutterCode("0110")
    shutter = ShutterResponse(chip_ns=10, rise_ns=10, fall_ns=5)
    nodes, shares = np.polynomial.legendre.leggauss(12)
    cuts = np.union1d(path.t, np.linspace(0, 1, 4001))  # the quadrature of the straight ramps
    t = (0.5 * (cuts[1:] + cuts[:-1])[:, None] + 0.5 * np.diff(cuts)[:, None] * nodes).ravel()
    weight = (0.5 * np.diff(cuts)[:, None] * shares).ravel()
    ramp = np.clip(4 * t - 1, 0, 1) - np.clip((4 * t - 3) / 0.5, 0, 1)
    exact = np.exp(-2j * np.pi * (np.stack([FX, FY], 1) @ path.at(t).T)) @ (weight * ramp)
    found = coded_otf(path, code, FX, FY, response=shutter)
    assert 1e-7 < np.abs(found - exact).max() < 2e-3


@given(walks, codes)
@settings(max_examples=20, deadline=None)
def test_an_instant_shutter_on_time_is_none_at_all(path, code):
    instant = ShutterResponse(chip_ns=7)
    assert instant.instant
    plain = coded_otf(path, code, FX, FY)
    assert np.abs(coded_otf(path, code, FX, FY, response=instant) - plain).max() < 1e-12
    rows = chip_rows(path, code.chips, FX, FY, response=instant)
    assert np.abs(rows - chip_basis(path, code.chips, FX, FY)[:, None, None]).max() < 1e-12
    basis, opening, closing = chip_parts(path, code.chips, FX, FY, response=instant)
    assert np.abs(opening).max() == np.abs(closing).max() == 0
    assert np.abs(basis - chip_basis(path, code.chips, FX, FY)).max() < 1e-12


def test_the_tail_of_the_last_chip_follows_the_motion_on():
    path = Trajectory.straight(12.0)
    code = ShutterCode("0001")
    late = ShutterResponse(chip_ns=8, on_delay_ns=7, on_bias_ns=8)
    seen = open_path(path, code, response=late)
    assert seen.a[0] == pytest.approx([6 - 3 / 8, 0])
    assert seen.b[-1] == pytest.approx([6 + 3, 0])
    with pytest.raises(ValueError, match="frame of at least 21 px, got 17"):
        coded_psf(path, code, 17, response=late)


def test_frequencies_of_any_shape():
    shutter = ShutterResponse(chip_ns=2, rise_ns=1)
    assert chip_rows(walk(0), 5, np.zeros((2, 3)), 0.1, response=shutter).shape == (5, 2, 2, 2, 3)
    assert chip_rows(walk(0), 5, np.zeros((4, 1)), np.zeros(3)).shape == (5, 2, 2, 4, 3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"chip_ns": 0}, "chip_ns: must be above 0"),
        ({"rise_ns": -1}, "rise_ns: must be a time of at least 0 ns, got -1"),
        ({"fall_ns": np.inf}, "fall_ns: must be a time"),
        (
            {"rise_ns": 60, "on_delay_ns": 50},
            r"on_delay_ns \+ rise_ns: 110 ns is longer than a chip of 100 ns",
        ),
        (
            {"fall_ns": 60, "on_bias_ns": 50},
            r"on_bias_ns \+ fall_ns: .*chips of at least 110 ns would do",
        ),
        ({"on_delay_ns": 100}, "leaves nothing of a chip"),
    ],
)
def test_bad_shutters_are_named(options, words):
    with pytest.raises(ValueError, match=words) as caught:
        ShutterResponse(**{"chip_ns": 100, **options})
    assert "\n" not in str(caught.value)


def test_slow_shutters_need_long_chips():
    shutter = ShutterResponse(chip_ns=100, rise_ns=40)
    assert shutter.at(50).chip_ns == 50
    with pytest.raises(ValueError, match="longer than a chip of 30 ns"):
        shutter.at(30)
    with pytest.raises(
        ValueError, match="takes 40 ns, but the shortest chip of these edges lasts 30 ns"
    ):
        timeline(walk(0), np.array([0, 0.15, 1]), shutter, code=ShutterCode("11"))


def test_long_codes_gather_no_rounding_errors():
    # every piece of every ramp is alike here: 8192 rotations in a row would lose four digits
    path = Trajectory.straight(512.3)
    f = np.linspace(0, 0.5, 40)
    whole = ShutterResponse(chip_ns=1, rise_ns=1, fall_ns=1)
    basis = chip_parts(path, 512, f, 0.0, response=whole)[0]
    assert 512 * np.abs(basis - chip_basis(path, 512, f, 0.0)).max() < 1e-11


@given(st.integers(0, 10_000))
@settings(max_examples=20)
def test_a_path_goes_on_smoothly_both_ways(seed):
    rng = np.random.default_rng(seed)
    path = Trajectory.from_samples(np.cumsum(rng.normal(size=(9, 2)), axis=0))
    t, xy = extended(path)
    assert (np.diff(t) > 0).all()
    assert (t[0], t[-1]) == (-1, 2)
    velocity = np.diff(xy, axis=0) / np.diff(t)[:, None]
    assert velocity == pytest.approx(
        np.concatenate([f := velocity[8:16], f, f])[
            [*range(7, -1, -1), *range(8, 16), *range(23, 15, -1)]
        ]
    )
    straight_t, straight_xy = extended(Trajectory.straight(5.0))
    assert straight_xy[:, 0] == pytest.approx(5 * (straight_t - 0.5))
