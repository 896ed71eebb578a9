"""Closed forms, dense quadrature and invariances of trajectories."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from motdiff.trajectory import Trajectory, bilinear_otf, pixel_aperture_otf


def wiggle(seed: int, *, samples: int = 40, size_px: float = 16.0) -> Trajectory:
    rng = np.random.default_rng(seed)
    xy = np.cumsum(rng.standard_normal((samples, 2)), axis=0)
    t = np.cumsum(rng.uniform(0.1, 1.0, samples))
    motion = Trajectory.from_samples(xy, t=t)
    return motion.scaled(size_px / motion.extent_px)


def quadrature_otf(
    motion: Trajectory, fx: np.ndarray, fy: np.ndarray, lo: float = 0.0, hi: float = 1.0
) -> np.ndarray:
    """Composite 24-point Gauss-Legendre: good to 1e-13 while a quarter of a straight piece turns
    the phase < 8 rad."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    u = np.union1d(motion.t[(motion.t > lo) & (motion.t < hi)], [lo, hi])
    u = np.unique(np.concatenate([u, *(u[:-1] + np.diff(u) * k / 4 for k in (1, 2, 3))]))
    half = 0.5 * np.diff(u)
    times = 0.5 * (u[1:] + u[:-1])[:, None] + half[:, None] * nodes
    p = motion.at(times.ravel())
    w = (half[:, None] * weights).ravel()
    return np.array(
        [
            w @ np.exp(-2j * np.pi * (a * p[:, 0] + b * p[:, 1]))
            for a, b in zip(fx, fy, strict=True)
        ]
    )


seeds = st.integers(0, 2**31)
frequencies = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))


@pytest.mark.parametrize("seed", range(6))
def test_otf_equals_dense_integration(seed: int) -> None:
    motion = wiggle(seed)
    fx, fy = np.random.default_rng(seed).uniform(-0.6, 0.6, (2, 50))
    fx[0] = fy[0] = 0
    np.testing.assert_allclose(
        motion.otf(fx, fy), quadrature_otf(motion, fx, fy), atol=1e-11, rtol=0
    )


def test_slice_otfs_equal_dense_integration_and_add_up() -> None:
    motion = wiggle(7)
    fx, fy = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 20))
    edges = np.array([0.0, 0.13, 0.5, motion.t[20], 1.0])
    edges.sort()
    slices = motion.slice_otfs(edges, fx, fy)
    for part, lo, hi in zip(slices, edges[:-1], edges[1:], strict=True):
        np.testing.assert_allclose(
            part, quadrature_otf(motion, fx, fy, lo, hi), atol=1e-11, rtol=0
        )
    np.testing.assert_allclose(slices.sum(axis=0), motion.otf(fx, fy), atol=1e-12)
    np.testing.assert_allclose(motion.slice_otfs((0.2, 0.7), 0.0, 0.0), [0.5], atol=1e-12)


@given(length=st.floats(0.5, 60), angle=st.floats(0, 6.3), f=frequencies)
def test_straight_motion_has_a_sinc_otf(
    length: float, angle: float, f: tuple[float, float]
) -> None:
    along = f[0] * np.cos(angle) + f[1] * np.sin(angle)
    otf = Trajectory.straight(length, angle_rad=angle).otf(*f)
    assert otf == pytest.approx(np.sinc(along * length), abs=1e-12)


@given(seed=seeds, f=frequencies)
@settings(max_examples=30, deadline=None)
def test_reversal_and_mirror(seed: int, f: tuple[float, float]) -> None:
    motion = wiggle(seed)
    assert motion.reversed().otf(*f) == pytest.approx(motion.otf(*f), abs=1e-12)
    assert replace(motion, xy=-motion.xy).otf(*f) == pytest.approx(
        np.conj(motion.otf(*f)), abs=1e-12
    )
    edges = np.linspace(0, 1, 6)
    forward = motion.slice_otfs(edges, *f)
    np.testing.assert_allclose(motion.reversed().slice_otfs(edges, *f), forward[::-1], atol=1e-12)
    np.testing.assert_allclose(motion.reversed().reversed().xy, motion.xy)


@given(seed=seeds, factor=st.floats(0.2, 3), f=frequencies)
@settings(max_examples=30, deadline=None)
def test_scaling_stretches_frequency(seed: int, factor: float, f: tuple[float, float]) -> None:
    motion = wiggle(seed)
    scaled = motion.scaled(factor)
    assert scaled.otf(*f) == pytest.approx(
        complex(motion.otf(factor * f[0], factor * f[1])), abs=1e-10
    )
    assert scaled.length_px == pytest.approx(factor * motion.length_px)
    assert scaled.extent_px == pytest.approx(factor * motion.extent_px)


@given(
    seed=seeds,
    dx=st.floats(-100, 100),
    dy=st.floats(-100, 100),
    t0=st.floats(-5, 5),
    dt=st.floats(0.01, 100),
)
@settings(max_examples=30, deadline=None)
def test_from_samples_forgets_origin_and_clock(
    seed: int, dx: float, dy: float, t0: float, dt: float
) -> None:
    motion = wiggle(seed)
    moved = Trajectory.from_samples(motion.xy + np.array([dx, dy]), t=t0 + dt * motion.t)
    np.testing.assert_allclose(moved.xy, motion.xy, atol=1e-9)
    np.testing.assert_allclose(moved.t, motion.t, atol=1e-9)


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_otf_of_a_resampled_path_does_not_change_where_samples_are_added(seed: int) -> None:
    motion = wiggle(seed)
    t = np.union1d(motion.t, np.linspace(0, 1, 77))
    denser = Trajectory.from_samples(motion.at(t), t=t)
    assert denser.otf(0.31, -0.17) == pytest.approx(complex(motion.otf(0.31, -0.17)), abs=1e-12)
    assert denser.length_px == pytest.approx(motion.length_px)


def test_equal_samples_are_one_path() -> None:
    path = Trajectory.straight(12.0)
    again = replace(path, xy=path.xy * [1, -1])  # its zeros are -0.0
    assert path == again
    assert hash(path) == hash(again)
    others = (Trajectory.straight(13.0), path.reversed(), replace(path, direction="known"), "path")
    assert all(path != other for other in others)
    assert replace(path, t=path.t) in {path}


@pytest.mark.parametrize("size", [41, 64])
def test_psf_sums_to_one_with_centroid_at_the_centre(size: int) -> None:
    psf = wiggle(3).psf(size)
    at = np.arange(size) - size // 2
    assert psf.shape == (size, size)
    assert psf.min() >= 0
    assert psf.sum() == pytest.approx(1, abs=1e-12)
    assert at @ psf.sum(axis=0) == pytest.approx(0, abs=1e-9)  # the hat keeps first moments
    assert at @ psf.sum(axis=1) == pytest.approx(0, abs=1e-9)


def test_psf_of_a_horizontal_box() -> None:
    psf = Trajectory.straight(3.0).psf(9)  # from -1.5 to 1.5 along the centre row

    def hat(u: np.ndarray) -> np.ndarray:  # integral of the hat up to u
        return np.where(
            u <= 0, 0.5 * (np.clip(u, -1, 0) + 1) ** 2, 1 - 0.5 * (1 - np.clip(u, 0, 1)) ** 2
        )

    n = np.arange(9) - 4
    np.testing.assert_allclose(psf[4], (hat(1.5 - n) - hat(-1.5 - n)) / 3, atol=1e-14)
    assert np.all(psf[[0, 1, 2, 3, 5, 6, 7, 8]] == 0)


@pytest.mark.parametrize("seed", range(3))
def test_psf_spectrum_is_the_aliased_otf_through_the_bilinear_hat(seed: int) -> None:
    motion = wiggle(seed, size_px=12)
    psf = motion.psf(33)
    fx, fy = np.random.default_rng(seed).uniform(-0.5, 0.5, (2, 6))
    at = np.arange(33) - 16
    spectrum = np.array(
        [
            np.exp(-2j * np.pi * b * at) @ psf @ np.exp(-2j * np.pi * a * at)
            for a, b in zip(fx, fy, strict=True)
        ]
    )

    def alias_sum(reach: int) -> np.ndarray:
        m = np.arange(-reach, reach + 1)
        gx = fx[:, None, None] + m[None, :, None]
        gy = fy[:, None, None] + m[None, None, :]
        return (motion.otf(gx, gy) * bilinear_otf(gx, gy)).sum(axis=(1, 2))

    errors = [np.abs(alias_sum(reach) - spectrum).max() for reach in (2, 8, 32)]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-4


def test_psf_spectrum_equals_dense_integration_of_the_hat() -> None:
    motion = wiggle(11, size_px=10)
    f = 0.23
    at = np.arange(33) - 16
    spectrum = motion.psf(33).sum(axis=0) @ np.exp(-2j * np.pi * f * at)
    x = motion.at((np.arange(400_000) + 0.5) / 400_000)[:, 0]
    whole = np.floor(x)
    part = x - np.floor(x)
    wave = (1 - part) * np.exp(-2j * np.pi * f * whole) + part * np.exp(
        -2j * np.pi * f * (whole + 1)
    )
    assert spectrum == pytest.approx(wave.mean(), abs=1e-8)


def test_slices_sum_to_the_whole_and_hold_their_share_of_light() -> None:
    motion = wiggle(5)
    edges = np.sort(np.random.default_rng(1).uniform(0, 1, 9))
    edges = np.concatenate([[0.0], edges, [1.0]])
    slices = motion.slice_psfs(edges, 64)
    np.testing.assert_allclose(slices.sum(axis=0), motion.psf(64), atol=1e-14)
    np.testing.assert_allclose(slices.sum(axis=(1, 2)), np.diff(edges), atol=1e-12)


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_frame_size_is_the_smallest_that_works(seed: int) -> None:
    motion = wiggle(seed, size_px=9)
    size = motion.frame_size()
    assert motion.psf(size).sum() == pytest.approx(1)
    with pytest.raises(ValueError, match=rf"at least {size} px, got {size - 1}"):
        motion.psf(size - 1)


@pytest.mark.parametrize("seed", range(5))
def test_hr_map_is_one_connected_thin_line_centred_with_the_psf(seed: int) -> None:
    motion = wiggle(seed, size_px=30)
    hr = motion.hr_map()
    assert hr.shape == (256, 256)
    assert set(np.unique(hr)) == {0, 1}
    assert ndimage.label(hr, structure=np.ones((3, 3)))[1] == 1
    for end in motion.xy[[0, -1]]:
        row, column = np.rint(129.5 + 4 * end[::-1]).astype(int)
        assert hr[row - 1 : row + 2, column - 1 : column + 2].any()


def test_box_mean_of_the_hr_map_is_centred_with_the_psf() -> None:
    motion = Trajectory.straight(24.0, angle_rad=0.3)
    box = motion.hr_map().reshape(64, 4, 64, 4).mean(axis=(1, 3))
    at = np.arange(64) - 32
    for axis in (0, 1):
        assert at @ box.sum(axis=axis) / box.sum() == pytest.approx(
            0, abs=0.13
        )  # half an HR pixel
        assert at @ motion.psf(64).sum(axis=axis) == pytest.approx(0, abs=1e-9)


def test_hr_map_refuses_a_path_beyond_its_field() -> None:
    with pytest.raises(ValueError, match="64-px field"):
        Trajectory.straight(70.0).hr_map()


def test_pixel_aperture_is_a_sinc() -> None:
    assert pixel_aperture_otf(0.5, 0.0) == pytest.approx(2 / np.pi)
    assert bilinear_otf(0.5, 0.25) == pytest.approx((np.sinc(0.5) * np.sinc(0.25)) ** 2)


def test_resampling() -> None:
    motion = wiggle(2)
    even = motion.arc_resampled(50)
    # chords of a bent path are at most the arc between the points
    assert np.linalg.norm(np.diff(even, axis=0), axis=1).max() <= motion.length_px / 49 + 1e-9
    np.testing.assert_allclose(even[[0, -1]], motion.xy[[0, -1]])


@pytest.mark.parametrize(
    ("t", "xy", "said"),
    [
        ([0, 1], [[0, 0]], "must be"),
        ([0], [[0, 0]], "at least 2 samples"),
        ([0, 0.5, 0.5, 1], [[0, 0]] * 4, "strictly increasing"),
        ([0, 0.7, 0.5, 1], [[0, 0]] * 4, "strictly increasing"),
        ([0, np.nan, 1], [[0, 0]] * 3, "finite"),
        ([0, 1], [[0, 0], [np.inf, 0]], "finite"),
        ([0, 0.5], [[0, 0]] * 2, "from 0 to 1"),
        ([0, 1], [[0, 0], [3, 0]], "from_samples"),
    ],
)
def test_bad_samples_are_refused_in_one_line(
    t: list[float], xy: list[list[float]], said: str
) -> None:
    with pytest.raises(ValueError, match=said) as caught:
        Trajectory(np.array(t), np.array(xy))
    assert "\n" not in str(caught.value)


def test_bad_direction_edges_and_factor() -> None:
    motion = Trajectory.straight(3.0)
    with pytest.raises(ValueError, match="direction"):
        Trajectory(motion.t, motion.xy, "sideways")  # type: ignore[arg-type]
    for edges in ((0.5,), (0.5, 0.5), (-0.1, 1.0), (0.0, 1.1)):
        with pytest.raises(ValueError, match="edges"):
            motion.slice_otfs(edges, 0.1, 0.1)
    for factor in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="factor"):
            motion.scaled(factor)


def test_samples_cannot_be_changed_behind_its_back() -> None:
    motion = wiggle(0)
    with pytest.raises(ValueError, match="read-only"):
        motion.xy[0, 0] = 5


def dense(samples: int, noise_px: float) -> Trajectory:
    t = np.linspace(0, 1, samples)
    xy = np.stack([20 * np.sin(5 * t) + 3 * np.cos(17 * t), 15 * np.cos(4 * t)], axis=1)
    xy += noise_px * np.random.default_rng(0).standard_normal(xy.shape)
    return Trajectory.from_samples(xy, t=t**1.5, direction="known")


@pytest.mark.parametrize("tolerance_px", [1e-4, 0.01, 1.0])
@pytest.mark.parametrize(
    ("samples", "noise_px"), [(2, 0.0), (3, 0.0), (1000, 0.0), (4097, 1e-5), (4095, 0.3)]
)
def test_a_thinned_path_is_at_the_same_place_at_any_time(
    samples: int, noise_px: float, tolerance_px: float
) -> None:
    path = dense(samples, noise_px)
    thin = path.thinned(tolerance_px)
    assert thin.direction == "known"
    times = np.union1d(path.t, np.linspace(0, 1, 777))
    assert np.linalg.norm(thin.at(times) - path.at(times), axis=1).max() <= tolerance_px
    assert 2 <= thin.t.size <= samples


def test_a_million_samples_become_few_with_the_same_otf() -> None:
    path = dense(1_000_000, 0.0)
    thin = path.thinned()
    assert thin.t.size < 3000
    fx, fy = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 12))
    edges = np.linspace(0, 1, 9)
    difference = np.abs(path.slice_otfs(edges, fx, fy) - thin.slice_otfs(edges, fx, fy)).sum(
        axis=0
    )
    assert (difference <= 2 * np.pi * np.hypot(fx, fy) * 1e-4).all()


def test_dwell_is_no_less_than_place() -> None:
    """A straight path of uneven speed keeps its speeds."""
    t = np.linspace(0, 1, 10_000)
    path = Trajectory.from_samples(np.outer(t**3, [30.0, 0.0]), t=t)
    assert np.abs(path.thinned().at(t) - path.at(t)).max() <= 1e-4
    assert path.thinned().t.size > 50
    even = Trajectory.from_samples(np.outer(t, [30.0, 0.0]), t=t).thinned()
    assert even.t.size < 20


@pytest.mark.parametrize("tolerance_px", [0.0, -1.0, float("nan"), float("inf")])
def test_tolerances_that_are_none(tolerance_px: float) -> None:
    with pytest.raises(ValueError, match="tolerance_px"):
        dense(10, 0.0).thinned(tolerance_px)
