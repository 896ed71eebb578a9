"""Invariances of the metrics, and cases with known answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from motdiff.metrics import (
    best_aligned,
    mnc,
    mnc_matrix,
    mnc_subpixel,
    path_distance_px,
    psnr,
    psnr_up_to_shift,
    register_shift,
)
from motdiff.motions import boracchi_foi
from motdiff.trajectory import Trajectory


def kernel(seed: int, size: int = 48) -> np.ndarray:
    return boracchi_foi(np.random.default_rng(seed), max_length_px=30.0).psf(size)


def scene(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = ndimage.gaussian_filter(rng.standard_normal((90, 110)), 2)
    return (image - image.min()) / np.ptp(image)


seeds = st.integers(0, 10_000)


@given(seed=seeds, scale=st.floats(1e-3, 1e3), dy=st.integers(-5, 5), dx=st.integers(-5, 5))
@settings(max_examples=20, deadline=None)
def test_mnc_ignores_shift_scale_and_frame(seed: int, scale: float, dy: int, dx: int) -> None:
    a = kernel(seed)
    b = kernel(seed + 1)
    moved = scale * np.roll(np.pad(b, 6), (dy, dx), axis=(0, 1))
    for measure, tolerance in ((mnc, 1e-9), (mnc_subpixel, 2e-3)):  # the sub-pixel grid is finite
        assert measure(a, moved) == pytest.approx(measure(a, b), abs=tolerance)
        assert measure(a, b) == pytest.approx(measure(b, a), abs=tolerance)
        assert 0 <= measure(a, b) <= 1
        assert measure(a, a) == pytest.approx(1, abs=1e-9)


def test_mnc_of_small_kernels_by_hand() -> None:
    assert mnc([[1.0, 0.0]], [[1.0, 1.0]]) == pytest.approx(1 / np.sqrt(2))
    assert mnc([[3.0, 4.0]], [[4.0, 3.0]]) == pytest.approx(24 / 25)


def test_mnc_sees_rotation() -> None:
    lopsided = np.zeros((9, 9))
    lopsided[4, 2:8] = [6, 5, 4, 3, 2, 1]
    assert mnc(lopsided, lopsided[::-1, ::-1]) < 0.9


@pytest.mark.parametrize("seed", range(4))
def test_subpixel_mnc_forgives_half_a_pixel_and_integer_mnc_does_not(seed: int) -> None:
    # band-limited, as the interpolation assumes
    smooth = np.pad(ndimage.gaussian_filter(kernel(seed), 1.0), 8)
    moved = np.fft.ifft2(ndimage.fourier_shift(np.fft.fft2(smooth), (0.5, 0.5))).real
    assert mnc_subpixel(smooth, moved) == pytest.approx(1, abs=2e-3)
    assert mnc(smooth, moved) < mnc_subpixel(smooth, moved) - 0.01
    sharp = kernel(seed)
    assert mnc_subpixel(sharp, ndimage.shift(sharp, (0.5, 0.5), order=1)) > 0.02 + mnc(
        sharp, ndimage.shift(sharp, (0.5, 0.5), order=1)
    )


@pytest.mark.parametrize(("dx", "dy"), [(0.0, 0.0), (3.0, -2.0), (0.5, 0.25), (-1.4, 0.85)])
@pytest.mark.parametrize("size", [48, 49])
def test_register_shift_undoes_a_shift(dx: float, dy: float, size: int) -> None:
    a = np.pad(ndimage.gaussian_filter(kernel(3, 48), 1.2), 8)
    b = np.pad(a, ((0, size - 48),) * 2)
    b = np.fft.ifft2(ndimage.fourier_shift(np.fft.fft2(b), (-dy, -dx))).real
    # frames of 64 and 65 px have their centres at the same index
    assert register_shift(a, b) == pytest.approx((dx, dy), abs=0.051)


@pytest.mark.parametrize(
    ("a_px", "b_px"), [((40, 40), (65, 65)), ((64, 64), (33, 33)), ((34, 51), (60, 37))]
)
def test_frames_are_registered_by_their_centres(
    a_px: tuple[int, int], b_px: tuple[int, int]
) -> None:
    """One pair of blobs, in frames of any height and width."""

    def blobs(shape: tuple[int, int], dx: int, dy: int) -> np.ndarray:
        image = np.zeros(shape)
        row, column = shape[0] // 2 + dy, shape[1] // 2 + dx
        image[row, column] = 2.0
        image[row + 3, column - 4] = 1.0
        return ndimage.gaussian_filter(image, 1.5)

    a, b = blobs(a_px, 2, -1), blobs(b_px, -3, 4)
    assert register_shift(a, b) == pytest.approx((5, -5), abs=0.051)


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), np.ones(3), np.full((3, 3), np.nan)])
def test_mnc_refuses_what_is_no_psf(bad: np.ndarray) -> None:
    with pytest.raises(ValueError, match="psf_b"):
        mnc(np.ones((3, 3)), bad)
    with pytest.raises(ValueError, match="psf_a"):
        mnc_subpixel(bad, np.ones((3, 3)))


# ---- MNC of every pair


def motions(seed: int, count: int = 4) -> list[np.ndarray]:
    """PSFs of shaken hands, in frames of different sizes."""
    rng = np.random.default_rng(seed)
    paths = [boracchi_foi(rng, max_length_px=float(rng.uniform(5, 40))) for _ in range(count)]
    return [path.psf(max(int(rng.integers(30, 66)), path.frame_size())) for path in paths]


@pytest.mark.parametrize("seed", range(6))
def test_mnc_matrix_is_the_subpixel_mnc_of_every_pair(seed: int) -> None:
    psfs = motions(seed)
    found = mnc_matrix(psfs)
    expected = np.array([[mnc_subpixel(a, b) for b in psfs] for a in psfs])
    assert found.shape == (4, 4)
    np.testing.assert_array_equal(found, found.T)
    np.testing.assert_array_equal(np.diag(found), 1)
    # up to a quarter of a pixel off the best shift either way: 99 of 100 pairs are within 0.02
    np.testing.assert_allclose(found, expected, atol=0.03)
    assert np.median(np.abs(found - expected)) < 0.01
    assert found.max() <= 1


@pytest.mark.parametrize("seed", range(3))
def test_mnc_matrix_is_the_best_of_four_half_pixel_shifts(seed: int) -> None:
    a, b = motions(seed, 2)
    spectrum = np.fft.fft2(np.pad(a, 64))
    halves = [
        np.fft.ifft2(ndimage.fourier_shift(spectrum, (dy, dx))).real
        for dy in (0, 0.5)
        for dx in (0, 0.5)
    ]
    expected = max(np.linalg.norm(half) / np.linalg.norm(a) * mnc(half, b) for half in halves)
    assert mnc_matrix([a, b])[0, 1] == pytest.approx(expected, abs=3e-3)


def test_mnc_matrix_ignores_scale_frame_and_place() -> None:
    a = kernel(1)
    b = kernel(2)
    found = mnc_matrix(
        [a, b, 7 * np.pad(a, ((3, 11), (6, 0))), np.roll(np.pad(b, 9), (4, -7), axis=(0, 1))]
    )
    assert found[0, 2] == pytest.approx(1, abs=1e-9)
    assert found[1, 3] == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(
        found[2:, :2], found[:2, :2], atol=3e-3
    )  # the sinc's tails wrap at other frames


def test_mnc_matrix_of_points_by_hand() -> None:
    point, across, down = np.zeros((3, 13, 13))
    point[6, 6] = 2
    across[6, 4], across[6, 9] = 1, 1
    down[2, 6], down[10, 6] = 1, 1
    expected = [
        [1, np.sqrt(1 / 2), np.sqrt(1 / 2)],
        [np.sqrt(1 / 2), 1, 1 / 2],
        [np.sqrt(1 / 2), 1 / 2, 1],
    ]
    np.testing.assert_allclose(mnc_matrix([point, across, down]), expected, atol=1e-9)


def test_mnc_matrix_does_not_join_the_frames_ends() -> None:
    far, near = np.zeros((2, 3, 16))  # 16: a length that no transform rounds up
    far[1, 0], far[1, 15] = 1, 1
    near[1, 8], near[1, 9] = 1, 1
    found = mnc_matrix([far, near])[0, 1]
    assert found == pytest.approx(mnc_subpixel(far, near), abs=0.03)
    assert found < 0.7
    assert mnc_matrix([far.T, near.T])[0, 1] == pytest.approx(found)


def test_mnc_matrix_of_one_is_one() -> None:
    np.testing.assert_array_equal(mnc_matrix([kernel(0)]), [[1]])


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), np.ones(3), np.full((3, 3), np.nan)])
def test_mnc_matrix_names_what_is_no_psf(bad: np.ndarray) -> None:
    with pytest.raises(
        ValueError, match=r"^psfs\[1\]: must be a finite \(H, W\) array with some light"
    ):
        mnc_matrix([np.ones((3, 3)), bad])


def test_mnc_matrix_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^psfs: needs at least one$"):
        mnc_matrix([])


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_path_distance_ignores_direction_and_dwell(seed: int) -> None:
    path = boracchi_foi(np.random.default_rng(seed), samples=300)
    hurried = Trajectory.from_samples(path.xy, t=path.t**2)
    assert path_distance_px(path, path.reversed()) == pytest.approx(0, abs=1e-9)
    assert path_distance_px(path, hurried) == pytest.approx(0, abs=1e-9)


def test_path_distance_of_parallel_lines_of_two_lengths() -> None:
    # points at equal share of the arc lie |s| (20 - 10) apart, s from -1/2 to 1/2: 2.5 px on
    # average
    assert path_distance_px(
        Trajectory.straight(20.0), Trajectory.straight(10.0), samples=2001
    ) == pytest.approx(2.5, 1e-3)


@pytest.mark.parametrize(("error", "decibels"), [(1.0, 0.0), (0.1, 20.0), (0.5, 6.0206)])
def test_psnr_of_a_constant_error(error: float, decibels: float) -> None:
    image = scene()
    assert psnr(image + error, image) == pytest.approx(decibels, abs=1e-4)
    assert psnr(image, image) == 200


def test_psnr_of_known_noise() -> None:
    image = scene()
    noisy = image + 0.01 * np.random.default_rng(1).standard_normal(image.shape)
    assert psnr_up_to_shift(noisy, image) == pytest.approx(40, abs=0.2)
    assert psnr_up_to_shift(image, image) > 190


@pytest.mark.parametrize("shift", [(0, 3), (-4, 2), (1.25, -2.5)])
def test_psnr_up_to_shift(shift: tuple[float, float]) -> None:
    image = scene()
    moved = ndimage.shift(image, shift, order=5, mode="nearest")
    assert psnr_up_to_shift(moved, image) > 32  # bilinear re-alignment blurs a little
    assert psnr_up_to_shift(moved, image) > psnr_up_to_shift(moved, image, max_shift_px=0) + 5
    colour = np.stack([moved] * 3, axis=-1)
    assert psnr_up_to_shift(colour, np.stack([image] * 3, axis=-1)) == pytest.approx(
        psnr_up_to_shift(moved, image)
    )


def test_a_photo_is_moved_back_by_quarters_of_a_pixel() -> None:
    # bilinear interpolation of a plane is exact
    row, column = np.indices((40, 50))
    plane = 0.2 + 0.01 * row + 0.004 * column
    moved, reference = best_aligned(plane - 0.01 * 1.25 - 0.004 * 0.5, plane, 2.0, 6)
    np.testing.assert_allclose(moved, reference, atol=1e-12)


def test_psnr_refuses_unequal_or_tiny_photos() -> None:
    with pytest.raises(ValueError, match="differs from sharp"):
        psnr_up_to_shift(np.zeros((50, 50)), np.zeros((50, 51)))
    with pytest.raises(ValueError, match="crop_px"):
        psnr_up_to_shift(np.zeros((20, 20)), np.zeros((20, 20)))
