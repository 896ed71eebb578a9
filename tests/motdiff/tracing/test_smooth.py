import numpy as np
import pytest

from motdiff.metrics import mnc_subpixel, timed_distance_px
from motdiff.tracing import smooth_path, trace_psf_to_trajectory
from motdiff.trajectory import Trajectory


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
