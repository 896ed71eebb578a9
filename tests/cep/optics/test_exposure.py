"""Coded OTF and PSF: closed forms, sums over chips, symmetries."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cep.optics.code import ShutterCode
from cep.optics.exposure import chip_basis, chip_psfs, coded_otf, coded_psf
from motdiff.trajectory import Trajectory, bilinear_otf

FX, FY = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 60))


def walk(seed, samples=25):
    rng = np.random.default_rng(seed)
    t = np.concatenate([[0], np.sort(rng.uniform(0.01, 0.99, samples - 2)), [1]])
    return Trajectory.from_samples(np.cumsum(rng.normal(0, 1.5, (samples, 2)), axis=0), t=t)


codes = st.text("01", min_size=1, max_size=20).filter(lambda bits: "1" in bits).map(ShutterCode)
walks = st.integers(0, 10_000).map(walk)


def test_box_code_is_a_sinc():
    length = 17.3
    found = coded_otf(Trajectory.straight(length), ShutterCode("1" * 9), FX, FY)
    assert np.abs(np.abs(found) - np.abs(np.sinc(FX * length))).max() < 1e-13


@given(codes, st.floats(1, 80), st.floats(-3, 3))
def test_straight_motion_is_chip_sinc_times_polynomial(code, length, angle):
    found = coded_otf(Trajectory.straight(length, angle_rad=angle), code, FX, FY)
    f = (FX * np.cos(angle) + FY * np.sin(angle)) * length / code.chips
    polynomial = np.exp(-2j * np.pi * np.outer(f, np.arange(code.chips))) @ code.array
    assert np.abs(np.abs(found) - np.abs(np.sinc(f) * polynomial) / code.chips).max() < 1e-12


@given(walks, st.integers(1, 20))
@settings(max_examples=30)
def test_open_shutter_is_the_trajectory(path, chips):
    assert (
        np.abs(coded_otf(path, ShutterCode("1" * chips), FX, FY) - path.otf(FX, FY)).max() < 1e-12
    )
    assert np.abs(coded_psf(path, ShutterCode("1" * chips)) - path.psf()).max() < 1e-12


@given(walks, codes)
@settings(max_examples=30)
def test_chips_add_up(path, code):
    basis = chip_basis(path, code.chips, FX, FY)
    assert np.abs(np.tensordot(code.array, basis, 1) - coded_otf(path, code, FX, FY)).max() < 1e-12
    parts = chip_psfs(path, code.chips)
    assert np.allclose(parts.sum((1, 2)), 1 / code.chips)
    assert np.allclose(parts.sum(0), path.psf(), atol=1e-12)
    assert coded_psf(path, code).sum() == pytest.approx(code.duty)
    assert coded_otf(path, code, 0.0, 0.0) == pytest.approx(code.duty)


@given(walks, codes)
@settings(max_examples=30)
def test_reversed_path_with_reversed_code_is_the_same_photo(path, code):
    forward = coded_otf(path, code, FX, FY)
    assert np.abs(coded_otf(path.reversed(), code.reversed(), FX, FY) - forward).max() < 1e-12
    assert (
        np.abs(coded_otf(replace(path, xy=-path.xy), code, FX, FY) - forward.conj()).max() < 1e-12
    )
    assert np.abs(coded_otf(path, code, -FX, -FY) - forward.conj()).max() < 1e-12


def test_psf_and_otf_agree_through_the_fft():
    path = walk(3)
    code = ShutterCode("1101001")
    size = 64
    frequency = np.fft.fftfreq(size)
    fx, fy = np.meshgrid(frequency, frequency)
    from_psf = np.fft.fft2(np.fft.ifftshift(coded_psf(path, code, size)))
    # sampling folds the spectrum: compare with the sum over its copies
    copies = sum(
        coded_otf(path, code, fx + i, fy + j) * bilinear_otf(fx + i, fy + j)
        for i in range(-5, 6)
        for j in range(-5, 6)
    )
    assert np.abs(from_psf - copies).max() < 1e-3


def test_shapes_and_bad_arguments():
    path = walk(0)
    assert chip_basis(path, 5, np.zeros((2, 3)), 0.1).shape == (5, 2, 3)
    assert coded_otf(path, ShutterCode("101"), np.zeros((4, 1)), np.zeros(3)).shape == (4, 3)
    with pytest.raises(ValueError, match="chips: must be at least 1"):
        chip_basis(path, 0, 0.0, 0.0)
    with pytest.raises(ValueError, match="PSF frame of at least"):
        coded_psf(path.scaled(20), ShutterCode("1"))
