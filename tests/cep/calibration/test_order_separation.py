"""The separation of orders, beside PSFs that are shifted and subtracted on a grid."""

import numpy as np
import pytest

from cep.calibration.order_separation import BAND_CY_PX, OrderSeparation, ordered_walks
from motdiff.trajectory import Trajectory

CHIPS = 8
TIMES = np.linspace(0, 1, 53)
BEND = np.stack([20 * TIMES**2, 12 * TIMES * (1 - TIMES)], axis=1)
HALF = [0, 0, 0, 0, 1, 1, 1, 1]


def band_limited_psf(path, code, grid_px=120):
    """Spectrum of the light let through, its frequencies above the band removed."""
    fy, fx = np.meshgrid(np.fft.fftfreq(grid_px), np.fft.fftfreq(grid_px), indexing="ij")
    slices = Trajectory.from_samples(path).slice_otfs(
        np.linspace(0, 1, CHIPS + 1), fx.ravel(), fy.ravel()
    )
    spectrum = (np.asarray(code, dtype=float) @ slices).reshape(grid_px, grid_px)
    return spectrum * (np.hypot(fx, fy) <= BAND_CY_PX * (1 + 1e-9))


@pytest.mark.parametrize("code", [HALF, [1, 0, 0, 1, 1, 1, 0, 1], [0, 1, 0, 0, 0, 0, 0, 0]])
def test_it_is_the_smallest_squared_difference_over_all_shifts(code):
    measure = OrderSeparation([np.stack([BEND, BEND[::-1]])], chips=CHIPS)
    true, altered = (band_limited_psf(path, code) for path in (BEND, BEND[::-1]))
    fine = np.zeros((480, 480), dtype=complex)  # a quarter of a px
    at = np.fft.fftfreq(120, 1 / 120).astype(int)
    fine[np.ix_(at, at)] = true * altered.conj()
    alike = (np.fft.ifft2(fine) * fine.size).real.max()
    energy = (abs(true) ** 2).sum() + (abs(altered) ** 2).sum()
    whole = (abs(band_limited_psf(BEND, [1] * CHIPS)) ** 2).sum()
    assert measure.of(code) == pytest.approx([(energy - 2 * alike) / whole], rel=0.02, abs=2e-4)


def test_an_open_shutter_and_a_code_like_its_mirror_image_do_not_tell_the_direction():
    measure = OrderSeparation([np.stack([BEND, BEND[::-1]])], chips=CHIPS)
    for code in ([1] * CHIPS, [1, 0, 0, 1, 1, 0, 0, 1]):
        assert measure.of(code) == pytest.approx([0], abs=1e-5)
    assert measure.of(HALF)[0] > 0.03


def test_where_the_camera_points_does_not_count():
    measure = OrderSeparation([np.stack([BEND, np.add(BEND, [7.3, -11.6])])], chips=CHIPS)
    assert measure.of(HALF) == pytest.approx([0], abs=1e-4)


def test_orders_of_walks_share_the_psf_of_the_open_shutter():
    walks = ordered_walks(6, rng=np.random.default_rng(2))
    measure = OrderSeparation(walks, chips=CHIPS)
    assert measure.of([1] * CHIPS).max() < 0.005
    assert len(measure.of(HALF)) == sum(len(orders) - 1 for orders in walks)
    for orders in walks:
        assert 2 <= len(orders) <= 7
        assert np.array_equal(orders[1], orders[0][::-1])
    least = measure.of_each_motion(measure.of(HALF))
    assert least[0] == measure.of(HALF)[: len(walks[0]) - 1].min()


def test_conditioning_is_the_smallest_mtf_in_the_band():
    measure = OrderSeparation([np.stack([BEND, BEND[::-1]])], chips=CHIPS)
    spectra = [abs(band_limited_psf(BEND, code)) / np.mean(code) for code in (HALF, [1] * CHIPS)]
    rms = np.sqrt((spectra[0] ** 2 + spectra[1] ** 2) / 2)
    assert measure.conditioning([HALF, [1] * CHIPS]) == pytest.approx(
        [rms[rms > 0].min()], rel=1e-4
    )
