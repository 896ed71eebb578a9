import numpy as np
import pytest
from numpy.polynomial import legendre

from motdiff.metrics import mnc_subpixel, timed_distance_px
from motdiff.tracing.path import trace_psf_to_trajectory
from motdiff.tracing.smooth import KernelLikeness, PathOtf, kernel_otf, smooth_path
from motdiff.trajectory import Trajectory, bilinear_otf

FY = np.linspace(-0.3, 0.3, 13)
FX = np.linspace(0, 0.3, 9)
NODES, WEIGHT = legendre.leggauss(40)


def loop():
    """A path that crosses itself once, slower in the loop."""
    t = np.linspace(0, 1, 401)
    tau = 2 * t - 1
    return Trajectory.from_samples(
        np.stack([9 * tau**3 - 3 * tau, 8 * (1 - tau**2) + 3 * tau], axis=-1), t=t
    )


def timed_px(path, truth):
    return min(timed_distance_px(either, truth) for either in (path, path.reversed()))


def test_a_smooth_motion_is_recovered_in_time_from_its_psf():
    truth = loop()
    fitted = smooth_path(truth.psf(64), [])
    assert fitted.likeness > 0.995
    assert timed_px(fitted.trajectory, truth) < 1  # of 12 px, in order and in time


def test_a_fitted_path_is_more_alike_to_a_noisy_kernel_than_its_trace():
    psf = loop().psf(64)
    rng = np.random.default_rng(1)
    noisy = np.maximum(psf + rng.normal(0, 0.04 * psf.max(), psf.shape), 0) * (psf > 0)
    trace = trace_psf_to_trajectory(noisy)
    fitted = smooth_path(noisy, [trace])
    assert fitted.likeness > mnc_subpixel(trace.psf(64), noisy) + 0.005


def test_the_likeness_is_the_correlation_of_the_psfs():
    psf = loop().psf(64)
    fitted = smooth_path(psf, [])
    assert fitted.likeness == pytest.approx(mnc_subpixel(fitted.trajectory.psf(64), psf), abs=0.01)


def test_a_kernel_anywhere_in_its_frame_has_the_same_centred_path():
    psf = loop().psf(64)
    middle, aside = (smooth_path(kernel, []) for kernel in (psf, np.roll(psf, (4, -3), (0, 1))))
    assert timed_px(middle.trajectory, aside.trajectory) < 0.5


def arc(t):
    return np.stack([14 * (t - 0.5), 6 * (t - 0.5) ** 2 - 0.5], axis=-1)


def test_nodes_of_a_quadrature_have_the_exact_otf_of_their_path():
    t = np.linspace(0, 1, 2001)
    exact = Trajectory.from_samples(arc(t), t=t).otf(FX, FY[:, None])
    otf = PathOtf(FY, FX, WEIGHT / 2).otf(arc((NODES + 1) / 2))
    np.testing.assert_allclose(otf, exact, atol=1e-5)


def test_a_kernel_has_the_otf_of_its_path_through_the_hat_of_its_pixels():
    path = Trajectory.straight(9.0, angle_rad=0.4)
    fy, fx = FY / 3, FX / 3  # low: a kernel's samples alias
    expected = path.otf(fx, fy[:, None]) * bilinear_otf(fx, fy[:, None])
    np.testing.assert_allclose(kernel_otf(path.psf(21), fy, fx), expected, atol=0.02)


def test_slopes_in_the_nodes_are_those_of_differences():
    rng = np.random.default_rng(0)
    points = 5 * rng.standard_normal((6, 2))
    path_otf = PathOtf(FY, FX, np.full(6, 1 / 6))
    alike = KernelLikeness(Trajectory.straight(9.0).psf(21), FY, FX, blur_px=0.5)
    _, by_otf = alike(path_otf.otf(points))
    slope = path_otf.slope(by_otf)
    step = 0.02
    for k, axis in ((0, 0), (3, 1)):
        moved = np.zeros((6, 2))
        moved[k, axis] = step
        difference = (
            alike(path_otf.otf(points + moved))[0] - alike(path_otf.otf(points - moved))[0]
        )
        assert slope[k, axis] == pytest.approx(difference / (2 * step), rel=0.02, abs=1e-4)


def test_a_kernel_is_all_alike_to_itself_and_to_its_multiples():
    kernel = Trajectory.straight(9.0).psf(21)
    alike = KernelLikeness(kernel, FY, FX)
    assert alike(3 * kernel_otf(kernel, FY, FX).astype(np.complex64))[0] == pytest.approx(1)
