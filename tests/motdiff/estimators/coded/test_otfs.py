"""Coded OTFs against the trajectory's own slices, finite differences and the symmetries of the
Fourier transform."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motdiff.estimators.coded.otfs import CodedOtfs
from motdiff.psf_frame import centroid_px
from motdiff.trajectory import Trajectory

# chips that divide the intervals between 27 knots, and chips that do not
CODES = [
    ("1" * 26, "01100110101100101110001011"),
    ("1011001", "0000001"),
    ("1" * 52, "10" * 26),
    ("1101", "01101", "1" * 9),
]
KNOTS = 27


def walk(seed: int, knots: int = KNOTS) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(0, 0.8, (knots, 2)), axis=0)


def frequencies(seed: int, count: int = 60) -> np.ndarray:
    """Within 0.42 cycles/px, the most that fits use; beyond, the quadrature is less exact."""
    return np.random.default_rng([seed, 1]).uniform(-0.3, 0.3, (count, 2))


def exact(points: np.ndarray, code: str, f: np.ndarray) -> np.ndarray:
    """Normalised coded OTF (F,) in double precision, from slices of the exposure summed over the
    open chips."""
    path = Trajectory.from_samples(points)
    is_open = np.array(list(code)) == "1"
    slices = path.slice_otfs(np.linspace(0, 1, len(code) + 1), f[:, 0], f[:, 1])[is_open]
    return slices.sum(axis=0) / is_open.mean() * np.exp(-2j * np.pi * f @ (points[0] - path.xy[0]))


def otfs_of(
    codes: tuple[str, ...], paths: np.ndarray, shifts: np.ndarray, f: np.ndarray
) -> np.ndarray:
    tensors = (torch.tensor(values.copy(), dtype=torch.float32) for values in (paths, shifts, f))
    return CodedOtfs(codes, paths.shape[1]).otfs(*tensors).numpy()


@pytest.mark.parametrize("codes", CODES)
def test_equal_the_slices_of_the_open_chips(codes: tuple[str, ...]) -> None:
    paths = np.stack([walk(seed) for seed in range(3)])
    f = frequencies(0)
    shifts = np.random.default_rng(2).normal(size=(3, len(codes), 2))
    found = otfs_of(codes, paths, shifts, f)
    assert found.shape == (3, len(codes), len(f))
    for path, moved, row in zip(paths, shifts, found, strict=True):
        for code, shift, otf in zip(codes, moved, row, strict=True):
            np.testing.assert_allclose(otf, exact(path + shift, code, f), atol=2e-5)


@pytest.mark.parametrize("codes", CODES)
def test_a_grid_holds_the_same_values_and_slopes(codes: tuple[str, ...]) -> None:
    rng = np.random.default_rng(7)
    fy, fx = np.fft.fftfreq(10) / 2, np.fft.rfftfreq(10) / 2
    listed = np.stack([v.ravel() for v in np.meshgrid(fx, fy)], axis=1)
    paths = np.stack([walk(seed) for seed in range(2)])
    shifts = rng.normal(size=(2, len(codes), 2))
    paths, shifts, fy, fx, f = (
        torch.tensor(values, dtype=torch.float32) for values in (paths, shifts, fy, fx, listed)
    )
    otfs, slopes = CodedOtfs(codes, KNOTS).with_slopes(paths, shifts, f)
    grid = CodedOtfs(codes, KNOTS).on_grid(paths, shifts, fy, fx)
    torch.testing.assert_close(grid.H.flatten(2), otfs, atol=1e-5, rtol=0)
    # the function Re(conj(w) H) has the slope w in H
    w = torch.tensor(rng.normal(size=(*grid.H.shape, 2)) @ [1, 1j], dtype=torch.complex64)
    by_knot, by_shift = grid.slopes(w)
    change = w.flatten(2)[:, :, None].conj() * slopes
    expected = torch.einsum("bikf,fd->bkd", change.real, 2 * np.pi * f)
    torch.testing.assert_close(by_knot, expected, atol=1e-4, rtol=1e-4)
    # what moves every knot moves the photo
    expected = torch.einsum("bikf,fd->bid", change.real, 2 * np.pi * f)
    torch.testing.assert_close(by_shift, expected, atol=1e-4, rtol=1e-4)


def test_a_path_at_rest_has_an_otf_of_modulus_one() -> None:
    f = frequencies(1)
    place = np.array([2.0, -1.5])
    found = otfs_of(CODES[0], np.tile(place, (1, KNOTS, 1)), np.zeros((1, 2, 2)), f)
    np.testing.assert_allclose(
        found[0], np.tile(np.exp(-2j * np.pi * f @ place), (2, 1)), atol=2e-5
    )


@pytest.mark.parametrize("codes", CODES)
@pytest.mark.parametrize("size_px", [8.0, 0.02, 0.0])
def test_slopes_are_the_derivatives(codes: tuple[str, ...], size_px: float) -> None:
    path = walk(4)
    f = frequencies(4, 12)
    path = size_px * (path - path.mean(axis=0)) / np.ptp(path)
    shifts = np.random.default_rng(5).normal(size=(len(codes), 2))
    step_px = 1e-4
    tensors = [torch.tensor(values[None], dtype=torch.float32) for values in (path, shifts)]
    otfs, slopes = CodedOtfs(codes, KNOTS).with_slopes(
        *tensors, torch.tensor(f, dtype=torch.float32)
    )
    assert slopes.shape == (1, len(codes), KNOTS, len(f))
    np.testing.assert_allclose(
        otfs.numpy(), otfs_of(codes, path[None], shifts[None], f), atol=1e-6
    )
    for photo, code in enumerate(codes):
        for knot in (0, 1, 13, KNOTS - 1):
            for axis in (0, 1):
                step = np.zeros_like(path)
                step[knot, axis] = step_px
                ahead, behind = (
                    exact(path + sign * step + shifts[photo], code, f) for sign in (1, -1)
                )
                slope = slopes[0, photo, knot].numpy() * 2 * np.pi * f[:, axis]
                np.testing.assert_allclose(slope, (ahead - behind) / (2 * step_px), atol=1e-5)


@pytest.mark.parametrize("codes", CODES)
def test_centroids_are_those_of_the_psfs(codes: tuple[str, ...], coded_psf) -> None:
    path = Trajectory.from_samples(walk(6))
    found = (
        CodedOtfs(codes, KNOTS)
        .centroids(torch.tensor(path.xy[None].copy(), dtype=torch.float32))[0]
        .numpy()
    )
    expected = [centroid_px(coded_psf(path, code))[::-1] for code in codes]
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_open_share_is_that_of_the_chips() -> None:
    for codes in CODES:
        shares = [code.count("1") / len(code) for code in codes]
        np.testing.assert_allclose(CodedOtfs(codes, KNOTS).open_share, shares, atol=1e-12)


@st.composite
def coded_walks(draw: st.DrawFn) -> tuple[str, np.ndarray, np.ndarray]:
    chips = draw(st.integers(1, 40))
    seed = draw(st.integers(0, 2**31))
    code = "".join(
        draw(
            st.lists(st.sampled_from("01"), min_size=chips, max_size=chips).filter(
                lambda bits: "1" in bits
            )
        )
    )
    return code, walk(seed, draw(st.integers(3, 30))), frequencies(seed, 20)


def one(
    code: str, path: np.ndarray, f: np.ndarray, shift: tuple[float, float] = (0, 0)
) -> np.ndarray:
    return otfs_of((code,), path[None], np.array([[shift]]), f)[0, 0]


@settings(deadline=None)
@given(coded_walks(), st.tuples(st.floats(-5, 5), st.floats(-5, 5)))
def test_symmetries(case: tuple[str, np.ndarray, np.ndarray], shift: tuple[float, float]) -> None:
    code, path, f = case
    otf = one(code, path, f)
    tolerance = 5e-5
    np.testing.assert_allclose(
        one(code[::-1], path[::-1], f), otf, atol=tolerance
    )  # both run backwards
    np.testing.assert_allclose(
        one(code, -path, f), otf.conj(), atol=tolerance
    )  # turned by 180 degrees
    np.testing.assert_allclose(one(code, path, -f), otf.conj(), atol=tolerance)  # the PSF is real
    np.testing.assert_allclose(
        one(code, path, f, shift), one(code, path + np.array(shift), f), atol=tolerance
    )
    assert np.abs(otf).max() <= 1 + tolerance


@settings(deadline=None)
@given(coded_walks())
def test_a_code_and_its_complement_make_the_open_exposure(
    case: tuple[str, np.ndarray, np.ndarray],
) -> None:
    code, path, f = case
    complement = code.translate(str.maketrans("01", "10"))
    if "1" in complement:
        share = code.count("1") / len(code)
        both = share * one(code, path, f) + (1 - share) * one(complement, path, f)
        np.testing.assert_allclose(both, one("1", path, f), atol=5e-5)


def test_an_open_shutter_does_not_see_the_order() -> None:
    path = walk(8)
    f = frequencies(8)
    np.testing.assert_allclose(one("1" * 13, path[::-1], f), one("1" * 13, path, f), atol=1e-5)
    code = "1" * 6 + "0" * 6
    assert np.abs(one(code, path[::-1], f) - one(code, path, f)).max() > 0.1
