"""Proven minima and zeros: against dense evaluation, closed forms, roots, and the argument
principle."""

from dataclasses import replace
from itertools import pairwise, product
from math import gcd

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf, open_path
from cep.optics.response import ShutterResponse
from cep.proofs.certify.certificate import certify
from cep.proofs.certify.minimum import chip_minimum, min_chip, mtf_minimum
from cep.proofs.certify.taylor import first_cells, floors, jets, pieces_of_code, pieces_of_path
from cep.proofs.certify.zeros import (
    circle_rest,
    divided,
    divisible,
    kantorovich,
    sign_changes,
    vanishing_orders,
    zeros_along,
    zeros_of_code,
)
from cep.proofs.verify import verify
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory

codes = st.text("01", min_size=1, max_size=24).filter(lambda bits: "1" in bits).map(ShutterCode)
points = st.tuples(st.floats(-20, 20), st.floats(-20, 20))
bent = st.lists(points, min_size=3, max_size=8).filter(
    lambda xy: np.ptp(np.array(xy), axis=0).min() > 0.5
)


def shake(seed, length_px=60.0, samples=400):
    return boracchi_foi(np.random.default_rng(seed), max_length_px=length_px, samples=samples)


def random_code(rng, chips=52):
    return ShutterCode("1" + "".join(rng.choice(["0", "1"], chips - 1)))


def along_chips(code, cycles):
    return np.abs(np.exp(-2j * np.pi * np.outer(cycles, np.arange(code.chips))) @ code.array)


# -- the inner loop -------------------------------------------------------------------------------


@given(bent, codes, st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_jets_are_the_otf_and_its_slopes(xy, code, seed):
    path = Trajectory.from_samples(xy)
    pieces = pieces_of_path(open_path(path, code))
    f = np.random.default_rng(seed).uniform(-0.5, 0.5, (20, 2))
    jet = jets(pieces, f)
    step = 1e-6
    otf = coded_otf(path, code, f[:, 0], f[:, 1])
    assert np.hypot(jet[:, 0], jet[:, 1]) == pytest.approx(np.abs(otf), abs=2 * pieces.slack)
    for axis in (0, 1):
        move = step * np.eye(2)[axis]
        slope = (jets(pieces, f + move) - jets(pieces, f - move))[:, :2] / (2 * step)
        assert slope == pytest.approx(jet[:, 2 + 2 * axis : 4 + 2 * axis], abs=1e-5)


@given(bent, codes, st.floats(0.001, 0.05), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_no_point_of_a_cell_lies_below_its_floor(xy, code, size, seed):
    rng = np.random.default_rng(seed)
    pieces = pieces_of_path(open_path(Trajectory.from_samples(xy), code))
    centres = rng.uniform(-0.4, 0.4, (30, 2))
    half = size * rng.uniform(0.1, 1, 2)
    floor = floors(pieces, jets(pieces, centres), half)
    corners = [half * np.array(sign) for sign in product((-1, 0, 1), repeat=2)]
    for move in [*corners, *(half * rng.uniform(-1, 1, (10, 2)))]:
        jet = jets(pieces, centres + move)
        assert (np.hypot(jet[:, 0], jet[:, 1]) >= floor).all()


def test_the_floor_closes_quadratically():
    pieces = pieces_of_path(open_path(shake(0), ShutterCode("1101")))
    centre = np.array([[0.013, 0.02]])
    jet = jets(pieces, centre)
    value = float(np.hypot(jet[0, 0], jet[0, 1]))
    slope = np.abs((jet[0, 0] * jet[0, 2::2] + jet[0, 1] * jet[0, 3::2]) / value).sum()
    lost = [value - slope * h - floors(pieces, jet, np.array([h, h]))[0] for h in (4e-4, 2e-4)]
    assert lost[0] / lost[1] == pytest.approx(4, rel=0.02)


def test_first_cells_cover_the_box():
    for pieces in (
        pieces_of_path(open_path(shake(1), ShutterCode("1"))),
        pieces_of_code(ShutterCode("1101")),
    ):
        cells, half = first_cells(pieces)
        assert cells.min(axis=0) - half == pytest.approx(pieces.box[:, 0])
        assert cells.max(axis=0) + half == pytest.approx(pieces.box[:, 1])
        widths = np.where(half > 0, 2 * half, 1)
        assert len(cells) * np.prod(widths) == pytest.approx(
            np.prod(np.where(half > 0, np.ptp(pieces.box, axis=1), 1))
        )


# -- straight motion ------------------------------------------------------------------------------


@given(codes)
@settings(max_examples=80, deadline=None)
def test_chip_bounds_hold_a_dense_evaluation(code):
    dense = along_chips(code, np.linspace(0, 0.5, 200 * code.chips + 1)).min()
    found = chip_minimum(code)
    assert found.lower <= dense
    assert found.upper <= dense * (1 + 1e-9) + 1e-12
    assert along_chips(code, np.array(found.at)) == pytest.approx(found.upper, abs=1e-12)
    assert found.relative_width <= 1e-6
    assert (found.upper == 0) == (found.zero is not None) == bool(zeros_of_code(code.bits).found)


@pytest.mark.parametrize("chips", [128, 512, 1024])
def test_long_codes_are_told_to_a_millionth(chips):
    code = random_code(np.random.default_rng(chips), chips)
    found = chip_minimum(code)
    assert 0 < found.lower <= min_chip(code) <= found.upper
    assert found.relative_width <= 1e-6


def test_a_small_budget_widens_the_interval_but_not_past_the_truth():
    code = random_code(np.random.default_rng(5))
    wide = chip_minimum(code, budget=0)
    narrow = chip_minimum(code)
    assert wide.lower <= narrow.lower <= narrow.upper <= wide.upper * (1 + 1e-12)
    assert wide.relative_width > narrow.relative_width


# -- exact zeros of polynomials -------------------------------------------------------------------


@pytest.mark.parametrize("chips", [6, 12, 30])
def test_an_open_shutter_vanishes_at_the_roots_of_unity(chips):
    found = zeros_of_code("1" * chips)
    assert found.complete
    assert [zero.at[0] for zero in found.found] == pytest.approx(
        [k / chips for k in range(1, chips // 2 + 1)]
    )
    assert {zero.order for zero in found.found} == {
        d for d in range(2, chips + 1) if chips % d == 0
    }


def test_vanishing_orders_of_all_short_codes():
    for bits in product("01", repeat=7):
        chips = np.array([1, *map(int, bits)])
        direct = [
            d
            for d in range(1, 40)
            if abs(
                np.exp(
                    2j
                    * np.pi
                    * np.arange(8)
                    * next(k for k in range(1, d + 1) if gcd(k, d) == 1)
                    / d
                )
                @ chips
            )
            < 1e-9
        ]
        assert list(vanishing_orders(chips)) == direct
        for order in direct:
            quotient = divided(chips, order)
            values = np.exp(2j * np.pi * 0.37 * np.arange(8)) @ chips
            phi = np.prod(
                [
                    np.exp(2j * np.pi * 0.37) - np.exp(2j * np.pi * k / order)
                    for k in range(1, order + 1)
                    if gcd(k, order) == 1
                ]
            )
            assert np.exp(
                2j * np.pi * 0.37 * np.arange(len(quotient))
            ) @ quotient * phi == pytest.approx(values)


def test_one_changed_bit_is_no_divisor():
    # 105 is the first order whose cyclotomic polynomial has a coefficient of 2
    whole = np.ones(105, dtype=np.int64)
    assert divisible(whole, 105)
    for k in (0, 50, 104):
        changed = whole.copy()
        changed[k] = 0
        assert not divisible(changed, 105)
    assert not divisible(whole, 210)


@given(st.text("01", min_size=2, max_size=14).map(lambda half: "1" + half))
@settings(max_examples=60, deadline=None)
def test_palindromes_change_sign_where_their_roots_lie(half):
    bits = half + half[-2::-1]
    found = zeros_of_code(bits)
    chips = [int(bit) for bit in bits]
    roots = np.roots(chips)
    # a double root is found as two, each off by the square root of the rounding
    near = (np.abs(np.abs(roots) - 1) < 1e-3) & (
        np.abs(np.polyval(chips, roots / np.abs(roots))) < 1e-8
    )
    on_circle = roots[near & (roots.imag > -1e-6)]
    places = np.sort(np.abs(np.angle(on_circle)) / (2 * np.pi))
    distinct = places[np.diff(places, prepend=-1) > 1e-4]
    if found.complete:
        assert [zero.at[0] for zero in found.found] == pytest.approx(distinct.tolist(), abs=1e-4)
    for zero in found.found:
        assert along_chips(ShutterCode(bits), np.array(zero.at)) == pytest.approx(0, abs=1e-9)


def test_a_zero_that_is_no_root_of_unity_in_a_code_that_is_no_palindrome():
    part = "1101011"
    bits = part + part + "0" * 7 + part
    assert bits != bits[::-1]
    chips = np.array([int(bit) for bit in bits])
    assert vanishing_orders(chips) == ()
    assert circle_rest(chips).tolist() == [1, 1, 0, 1, 0, 1, 1]
    found = zeros_of_code(bits)
    assert found.complete
    assert {zero.kind for zero in found.found} == {"sign change"}
    assert [zero.at for zero in found.found] == [zero.at for zero in zeros_of_code(part).found]
    minimum = chip_minimum(ShutterCode(bits))
    assert minimum.upper == 0
    assert minimum.method == "zero proven (sign change)"


def test_a_double_zero_is_not_called_complete():
    # (1 - 3 z + z^2)^2 has real zeros only; (1 - z + 2 z^2 - ...) squared touches zero without a
    # change of sign
    touching = np.convolve([2, -1, 2], [2, -1, 2])
    changes, complete = sign_changes(touching)
    assert changes == ()
    assert not complete


def test_false_claims_by_merl_are_settled():
    false = chip_minimum(ShutterCode("1111101110100110101101110001111"))
    assert (false.lower, false.upper) == (0, 0)
    assert false.at == (1 / 6,)
    assert false.method == "root of unity of order 6"


# -- along a path ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_curved_bounds_hold_a_dense_evaluation(seed):
    path = shake(seed, 5.0)
    code = random_code(np.random.default_rng(100 + seed), 12)
    fx, fy = np.meshgrid(np.linspace(-0.5, 0.5, 201), np.linspace(0, 0.5, 101))
    dense = np.abs(coded_otf(path, code, fx, fy)).min()
    found = mtf_minimum(path, code)
    assert found.lower <= dense
    assert found.upper <= dense + 1e-12
    assert np.abs(coded_otf(path, code, *found.at)) == pytest.approx(found.upper, abs=1e-9)
    assert found.relative_width <= 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_a_minimum_above_zero_on_a_long_path(seed):
    """A short opening in the middle of a 60 px shake: 52 chips, a curved path, no zero."""
    code = ShutterCode("0" * 20 + "11011" + "0" * 27)
    found = mtf_minimum(shake(seed), code)
    if found.upper > 0:
        assert found.lower > 0
        assert found.relative_width <= 1e-3
    mirrored = replace(shake(seed), xy=-shake(seed).xy)
    assert mtf_minimum(mirrored, code).upper == pytest.approx(found.upper, rel=1e-6)
    assert mtf_minimum(shake(seed).reversed(), code.reversed()).upper == pytest.approx(
        found.upper, rel=1e-6
    )


def test_budget_and_shutter_pass_through():
    path = shake(3, 5.0)
    code = ShutterCode("110100")
    quick = mtf_minimum(path, code, budget=0)
    proven = mtf_minimum(path, code)
    assert quick.lower <= proven.lower <= proven.upper <= quick.upper * (1 + 1e-9)
    slow = ShutterResponse(chip_ns=10, rise_ns=4, fall_ns=5, on_bias_ns=2)
    ramped = mtf_minimum(path, code, response=slow, budget=0)
    fx, fy = np.meshgrid(np.linspace(-0.5, 0.5, 101), np.linspace(0, 0.5, 51))
    dense = np.abs(open_path(path, code, response=slow).otf(fx, fy)).min()
    assert 0.9 * dense < ramped.upper <= dense * (1 + 1e-9)


@pytest.mark.parametrize("seed", [1, 4, 5])
def test_zeros_of_a_shake_are_all_found(seed):
    """The argument principle: H turns around 0 along the band's edge as often as signs of the
    Jacobian add up to."""
    path = shake(seed)
    code = random_code(np.random.default_rng(seed))
    zeros = zeros_along(path, code)
    assert zeros.complete
    assert len(zeros.found) > 5
    pieces = pieces_of_path(open_path(path, code))
    at = np.array([zero.at for zero in zeros.found])
    assert np.abs(coded_otf(path, code, at[:, 0], at[:, 1])).max() < 1e-12
    jet = jets(pieces, at)
    signs = np.sign(jet[:, 2] * jet[:, 5] - jet[:, 3] * jet[:, 4])
    # one of each pair f, -f is listed, in the upper half but for those on its lower edge
    inside = at[:, 1] > 1e-6
    s = np.linspace(0, 1, 40_001)
    corners = np.array([[-0.5, 1e-6], [0.5, 1e-6], [0.5, 0.5], [-0.5, 0.5], [-0.5, 1e-6]])
    total = 0.0
    for a, b in pairwise(corners):
        line = a + s[:, None] * (b - a)
        edge = jets(pieces, line)
        otf = edge[:, 0] + 1j * edge[:, 1]
        total += float(np.angle(otf[1:] / otf[:-1]).sum())
    assert round(total / (2 * np.pi)) == signs[inside].sum()


def test_kantorovich_proves_zeros_only():
    path = shake(1)
    code = random_code(np.random.default_rng(1))
    pieces = pieces_of_path(open_path(path, code))
    zero = zeros_along(path, code).found[3]
    proven = kantorovich(pieces, np.array(zero.at) + 0.1 * zero.alone_within)
    assert proven is not None
    assert np.hypot(*(np.array(proven.at) - zero.at)) < 1e-9
    assert 0 < proven.radius < 1e-9 < proven.alone_within
    short = pieces_of_path(open_path(shake(3, 2.0), code))
    assert kantorovich(short, np.array([0.2, 0.2])) is None


def test_zeros_of_a_straight_motion():
    path = Trajectory.straight(20.0)
    found = zeros_along(path, ShutterCode("1" * 10))
    # the box: multiples of 1/20 cycles/px; the tenth comes from the chip itself
    assert [zero.at[0] for zero in found.found] == pytest.approx([k / 20 for k in range(1, 11)])
    assert found.found[-1].kind == "closed form"
    assert all(zero.at[1] == pytest.approx(0) for zero in found.found)
    slanted = mtf_minimum(Trajectory.straight(20.0, angle_rad=0.7), ShutterCode("1" * 10))
    assert slanted.upper == 0
    assert np.hypot(*slanted.at) == pytest.approx(1 / 20)
    assert mtf_minimum(Trajectory.straight(0.5), ShutterCode("1")).lower > 0.9


@pytest.mark.parametrize(
    "bits", ["1", "1101", "1010000111000001010000110011110111011111001001100111"]
)
@pytest.mark.parametrize("angle_rad", [0.0, 0.6])
def test_a_motion_with_a_zero_in_closed_form_needs_no_grid(monkeypatch, bits, angle_rad):
    """The grid's work grows with the square of the length: tens of thousands of px took
    minutes."""
    code = ShutterCode(bits)
    monkeypatch.setattr("cep.proofs.certify.minimum.jets", lambda *_: pytest.fail("a grid"))
    for length_px in (float(2 * code.chips), 30_000.0, 99_999.0):
        path = Trajectory.straight(length_px, angle_rad=angle_rad)
        found = mtf_minimum(path, code)
        assert (found.lower, found.upper) == (0.0, 0.0)
        assert found.at == zeros_along(path, code).found[0].at
        assert np.abs(found.at).max() <= 0.5 + 1e-12
        assert abs(coded_otf(path, code, *found.at)) < 1e-9


def test_a_zero_on_the_band_s_very_edge_is_rounded_one_way_or_the_other():
    """Here the length says that the first zero lies within the band, its place that it does
    not."""
    path = Trajectory.straight(57.9528375614075, angle_rad=0.5663900138464376)
    found = mtf_minimum(path, ShutterCode("1" + 39 * "0"))
    assert found.lower == 0
    assert found.upper < 1e-12


@pytest.mark.parametrize(
    ("length_px", "angle_rad"), [(14.0659, 1.9581), (17.0, 0.7), (16.5, -2.2)]
)
def test_zeros_of_a_slanting_motion_lie_in_the_band(length_px, angle_rad):
    code = ShutterCode("11100101")
    path = Trajectory.straight(length_px, angle_rad=angle_rad)
    zeros = zeros_along(path, code).found
    assert zeros
    for zero in zeros:
        assert np.abs(zero.at).max() <= 0.5 + 1e-12
        assert abs(coded_otf(path, code, *zero.at)) < 1e-9
    assert verify(certify(code, path).to_dict(), bits=code.bits).holds


def test_a_motion_with_zeros_beyond_the_band_alone_still_takes_the_grid():
    code = ShutterCode("1101")
    found = mtf_minimum(Trajectory.straight(7.9), code)
    dense = np.abs(coded_otf(Trajectory.straight(7.9), code, np.linspace(0, 0.5, 20_001), 0.0))
    assert 0 < found.lower <= dense.min() * (1 + 1e-9)
    assert found.upper == pytest.approx(dense.min(), rel=1e-3)


def test_a_budget_too_small_makes_no_claim_of_completeness():
    assert not zeros_along(shake(0), ShutterCode("110101"), budget=100).complete
