import numpy as np
import pytest
from numpy.polynomial import legendre

from motdiff.tracing.path_otf import KernelLikeness, PathOtf, kernel_otf, path_moments
from motdiff.trajectory import Trajectory, bilinear_otf

FY = np.linspace(-0.3, 0.3, 13)
FX = np.linspace(0, 0.3, 9)
NODES, WEIGHT = legendre.leggauss(40)


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


def test_moments_of_a_psf_are_those_of_its_path():
    path = Trajectory.straight(9.0, angle_rad=0.4)
    middle, spread = path_moments(np.roll(path.psf(31), (2, -3), axis=(0, 1)))
    np.testing.assert_allclose(middle, [-3, 2], atol=1e-6)
    along = np.array([np.cos(0.4), np.sin(0.4)])
    # across a straight path there is nothing: a least variance keeps the matrix invertible
    assert along @ spread @ along == pytest.approx(9.0**2 / 12, rel=0.02)
    assert np.linalg.eigvalsh(spread)[0] == pytest.approx(0.05, abs=0.03)
