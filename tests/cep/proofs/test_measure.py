"""Minimum over the continuum, noise gain, Wiener error: against closed forms, dense evaluation and
published tables."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate

from cep.optics.band import band, band_samples, circle_samples
from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_otf
from cep.optics.scene import PHOTO, noise_variance, wiener_mse
from cep.optics.straight_motion import straight_axis, uniform_length_px
from cep.proofs.certify.minimum import chip_minimum, min_chip, mtf_minimum
from cep.proofs.measure import measure, worst_of
from motdiff.trajectory import Trajectory

RASKAR = ShutterCode("1010000111000001010000110011110111010111001001100111")
codes = st.text("01", min_size=1, max_size=24).filter(lambda bits: "1" in bits).map(ShutterCode)


def arc(length_px=8.0):
    angle = np.linspace(0, 2.0, 60) ** 1.3
    return Trajectory.from_samples(
        length_px / 2.5 * np.stack([np.cos(angle), np.sin(2 * angle) / 2], 1)
    )


@given(codes)
@settings(max_examples=60, deadline=None)  # the first one loads the machine code
def test_min_chip_lies_below_a_dense_grid_and_within_its_bounds(code):
    dense = np.abs(np.fft.rfft(code.array, 4096 * code.chips)).min()
    found = min_chip(code)
    bounds = chip_minimum(code)
    # between grid points |P| falls by no more than its slope allows
    slope = 2 * np.pi * np.arange(code.chips) @ code.array
    assert dense - slope / (8192 * code.chips) <= found + 1e-12
    assert found <= dense + 1e-12
    assert bounds.lower - 1e-12 <= found <= bounds.upper + 1e-9
    assert bounds.lower >= 0.998 * bounds.upper or bounds.upper < 1e-6


@given(codes)
def test_min_chip_ignores_playing_backwards_and_shifts(code):
    value = min_chip(code)
    assert min_chip(code.reversed()) == pytest.approx(value, abs=1e-9)
    assert min_chip(ShutterCode("00" + code.bits)) == pytest.approx(value, abs=1e-9)


def test_min_chip_in_closed_form():
    assert min_chip(ShutterCode("1")) == pytest.approx(1.0)
    assert min_chip(ShutterCode("11")) == pytest.approx(0.0, abs=1e-12)
    # 1 + z + z^3: |P|^2 = 3 + 2 (cos w + cos 2w + cos 3w)
    w = np.linspace(0, np.pi, 2_000_001)
    assert min_chip(ShutterCode("1101")) == pytest.approx(
        np.sqrt((3 + 2 * np.cos(np.outer([1, 2, 3], w)).sum(0)).min())
    )


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2, 2.5])
@pytest.mark.parametrize("length", [5.0, 23.7, 52.0])
def test_straight_minimum_against_dense_evaluation(angle, length):
    path = Trajectory.straight(length, angle_rad=angle)
    reach = 0.5 * (abs(np.cos(angle)) + abs(np.sin(angle)))
    s = np.linspace(0, reach, 200_001)
    dense = np.abs(coded_otf(path, RASKAR, s * np.cos(angle), s * np.sin(angle))).min()
    found = mtf_minimum(path, RASKAR)
    assert found.upper == pytest.approx(dense, rel=1e-5)
    assert 0.998 * found.upper < found.lower <= found.upper
    assert np.abs(coded_otf(path, RASKAR, *found.at)) == pytest.approx(found.upper)


def test_curved_minimum_against_dense_evaluation():
    path = arc(1.5)
    code = ShutterCode("1101")
    fx, fy = np.meshgrid(np.linspace(-0.5, 0.5, 401), np.linspace(0, 0.5, 201))
    dense = np.abs(coded_otf(path, code, fx, fy)).min()
    found = mtf_minimum(path, code)
    assert 0.1 < found.upper <= dense + 1e-12
    assert found.upper == pytest.approx(dense, rel=1e-3)
    assert 0.5 * dense < found.lower <= found.upper


def test_zeros_between_grid_points_are_found():
    # zeros of the box at multiples of 1 / L
    assert mtf_minimum(Trajectory.straight(np.sqrt(1000)), ShutterCode("1")).upper < 1e-9
    found = mtf_minimum(arc(60.0), ShutterCode("1"))
    assert found.upper < 1e-9
    assert found.lower == 0


def test_band_is_an_fft_grid():
    fx, fy = band(8)
    assert fx.shape == fy.shape == (8, 8)
    assert fx[4, 4] == fy[4, 4] == 0
    assert fx[0, 0] == -0.5
    assert fx[0, 5] == fy[5, 0] == 0.125


@pytest.mark.parametrize(
    "path", [Trajectory.straight(20, angle_rad=0.3), Trajectory.straight(9), arc()]
)
def test_samples_integrate_over_the_band(path):
    samples = band_samples(path)
    assert samples.weight.sum() == pytest.approx(1)
    # mean of |f|^2 over the square is 1/6; of an even function of the motion's frequency by brute
    # force
    mean_radius2 = samples.weight @ (samples.radius2 * samples.radius2_weight).sum(axis=1)
    assert mean_radius2 == pytest.approx(1 / 6, rel=2e-3)
    grid = (np.arange(1000) + 0.5) / 1000 - 0.5
    direction = straight_axis(path)
    if direction is not None:
        along = np.add.outer(grid * direction[1], grid * direction[0])
        measured = samples.weight @ np.cos(
            20 * (samples.fx * direction[0] + samples.fy * direction[1])
        )
        assert measured == pytest.approx(np.cos(20 * along).mean(), abs=1e-5)


@pytest.mark.parametrize("length_px", [30_000.0, 90_000.0])
def test_a_very_long_motion_is_sampled_within_memory_and_still_resolved(length_px):
    samples = band_samples(Trajectory.straight(length_px))
    assert samples.fx.size <= max(2**18, 8 * 0.5 * length_px) + 1
    assert samples.weight @ (samples.radius2 * samples.radius2_weight).sum(
        axis=1
    ) == pytest.approx(1 / 6, rel=2e-3)
    # a box's |H|^2: its integral over the line is 1 / length, of which next to nothing lies beyond
    # the band
    power = samples.weight @ np.sinc(length_px * samples.fx) ** 2
    assert power == pytest.approx(1 / length_px, rel=1e-4)


def test_straight_and_uniform_are_recognised():
    straight = Trajectory.straight(12, angle_rad=1.1)
    assert uniform_length_px(
        Trajectory.from_samples(straight.at(np.linspace(0, 1, 40)))
    ) == pytest.approx(12)
    speeding = Trajectory.from_samples(np.outer(np.linspace(0, 1, 30) ** 2, [3.0, 4.0]))
    assert straight_axis(speeding) == pytest.approx([0.6, 0.8])
    assert uniform_length_px(speeding) is None
    assert straight_axis(arc()) is None
    assert measure(speeding, RASKAR).min_chip is None


@pytest.mark.parametrize("scale", [1e-300, 1e-11])
def test_a_path_within_rounding_of_a_point_is_one(scale):
    point = Trajectory.straight(0.0)
    for shape in ([[0, 0], [1, 2], [3, 1]], [[0, 0], [1, 0], [2, 0]]):
        path = Trajectory.from_samples(scale * np.array(shape, dtype=float))
        assert straight_axis(path) == pytest.approx([1.0, 0.0])
        assert uniform_length_px(path) is None
        assert asdict(measure(path, ShutterCode("1"))) == pytest.approx(
            asdict(measure(point, ShutterCode("1")))
        )


def test_noise_gain_of_a_straight_motion_in_closed_form():
    found = measure(Trajectory.straight(0.8), ShutterCode("1"))
    mean, _ = integrate.quad(lambda f: 2 / np.sinc(0.8 * f) ** 2, 0, 0.5)
    assert found.noise_gain_db == pytest.approx(10 * np.log10(mean), abs=1e-3)
    assert found.min_mtf == pytest.approx(np.sinc(0.4))
    mean_h, _ = integrate.quad(lambda f: 2 * np.sinc(0.8 * f), 0, 0.5)
    mean_h2, _ = integrate.quad(lambda f: 2 * np.sinc(0.8 * f) ** 2, 0, 0.5)
    assert found.flatness_var == pytest.approx(mean_h2 - mean_h**2, rel=1e-3)


def test_dark_codes_pay_in_noise_gain_not_in_dnf():
    path = Trajectory.straight(10.0)
    # a pulse of a tenth sees 1 px
    found = measure(path, ShutterCode("0000010000"))
    still = measure(Trajectory.straight(1.0), ShutterCode("1"))
    assert found.noise_gain_db == pytest.approx(still.noise_gain_db + 20, abs=1e-2)
    assert found.dnf_db == pytest.approx(still.dnf_db, abs=1e-2)
    assert found.min_over_duty == pytest.approx(still.min_over_duty, abs=1e-6)


def test_noise_gain_is_infinite_on_a_zero():
    found = measure(Trajectory.straight(32.0), ShutterCode("1"))
    assert found.noise_gain_db == np.inf
    assert found.to_dict()["noise_gain_db"] is found.to_dict()["dnf_db"] is None
    assert found.in_words("noise_gain_db") == "> 100"
    assert found.in_words("mse_db") == found.mse_db


def test_noise_gains_are_told_up_to_100_db():
    found = measure(Trajectory.straight(3.0), ShutterCode("1101"))
    assert found.to_dict() == asdict(found)
    assert found.in_words("noise_gain_db") == found.noise_gain_db
    assert found.in_words("min_chip") == found.min_chip
    near = replace(found, noise_gain_db=100.0, dnf_db=100.001)
    assert near.to_dict()["noise_gain_db"] == 100
    assert near.to_dict()["dnf_db"] is None
    assert near.in_words("dnf_db") == "> 100"


def test_reversed_path_and_code_measure_alike():
    path = arc()
    there = measure(path, RASKAR, budget=0)
    back = measure(path.reversed(), RASKAR.reversed(), budget=0)
    for name in ("flatness_var", "noise_gain_db", "dnf_db", "mse_db"):
        assert getattr(there, name) == pytest.approx(getattr(back, name), rel=1e-9)
    other = measure(path.reversed(), RASKAR, budget=0)
    assert abs(other.noise_gain_db - there.noise_gain_db) > 0.1
    assert worst_of(there, other).noise_gain_db == max(there.noise_gain_db, other.noise_gain_db)
    assert worst_of(there, other).min_mtf == min(there.min_mtf, other.min_mtf)


def test_a_lens_cap_leaves_the_scene_s_variance_as_the_error():
    samples = circle_samples(400)
    variance, _ = integrate.dblquad(
        lambda y, x: 4 * float(PHOTO.power(x * x + y * y)), 0, 0.5, 0, 0.5, epsrel=1e-4
    )
    assert wiener_mse(np.zeros(samples.fx.size), samples, 1.0) == pytest.approx(variance, rel=0.05)


def test_wiener_error_of_a_still_bright_photo_is_the_noise():
    samples = circle_samples(50)
    noise = 1e-7
    assert wiener_mse(np.ones(samples.fx.size), samples, noise) == pytest.approx(noise, rel=0.02)
    camera = Camera(photons_full_scale=1000, read_noise_e=3)
    assert noise_variance(camera, 0.5) == pytest.approx(camera.noise_variance(PHOTO.mean / 2))


def test_more_light_never_hurts_the_wiener_error():
    path = Trajectory.straight(20.0)
    errors = [
        measure(path, RASKAR, camera=Camera(photons_full_scale=p)).mse_db
        for p in (100, 1000, 10_000)
    ]
    assert errors[0] > errors[1] > errors[2]


def test_straight_wiener_error_agrees_with_the_plane():
    """The one-axis quadrature against a plain two-dimensional midpoint rule."""
    path = Trajectory.straight(12.0, angle_rad=0.5)
    camera = Camera(photons_full_scale=2000)
    code = ShutterCode("1101001")
    grid = (np.arange(800) + 0.5) / 800 - 0.5
    fx, fy = np.meshgrid(grid, grid)
    power = np.abs(coded_otf(path, code, fx, fy)) ** 2
    prior = 1 / PHOTO.power(fx**2 + fy**2)
    plane = np.mean(1 / (power / noise_variance(camera, code.duty) + prior))
    assert measure(path, code, camera=camera).mse_db == pytest.approx(
        10 * np.log10(plane), abs=0.02
    )
