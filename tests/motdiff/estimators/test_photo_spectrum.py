import numpy as np
import pytest

from motdiff.estimators.photo_spectrum import PhotoSpectrum
from motdiff.tracing.path_otf import kernel_otf
from motdiff.trajectory import Trajectory
from tests.motdiff.estimators.test_simple_motion import photo_of

NOISE = 0.005


def blur_of(path, spectrum):
    otf = kernel_otf(path.psf(63), spectrum.fy, spectrum.fx)
    return spectrum.smeared((otf.real**2 + otf.imag**2).astype(np.float32))


def misfit(path, spectrum):
    blur = blur_of(path, spectrum)
    return spectrum.misfit(blur, spectrum.scene(blur))[0]


def test_the_true_motion_has_the_least_misfit_of_its_neighbours():
    truth = Trajectory.straight(21.0, angle_rad=0.5)
    spectrum = PhotoSpectrum(photo_of(truth), sigma=NOISE)
    least = misfit(truth, spectrum)
    for factor, angle_rad in ((0.9, 0.5), (1.1, 0.5), (1.0, 0.4), (1.0, 0.6)):
        other = Trajectory.straight(21.0 * factor, angle_rad=angle_rad)
        assert misfit(other, spectrum) > least + 10


def test_brightness_and_mirroring_change_no_misfit_between_motions():
    photo = photo_of(Trajectory.straight(21.0, angle_rad=0.5))
    paths = [Trajectory.straight(length, angle_rad=0.5) for length in (19.0, 21.0)]
    differences = []
    for image, sigma in ((photo, NOISE), (0.5 * photo, 0.5 * NOISE), (photo[::-1, ::-1], NOISE)):
        spectrum = PhotoSpectrum(image, sigma=sigma)
        differences.append(misfit(paths[0], spectrum) - misfit(paths[1], spectrum))
    assert differences[1:] == pytest.approx(differences[:1] * 2, rel=0.03)


def test_the_slope_of_a_misfit_is_that_of_differences():
    spectrum = PhotoSpectrum(photo_of(Trajectory.straight(15.0)), sigma=NOISE)
    blur = blur_of(Trajectory.straight(17.0), spectrum)
    scene = spectrum.scene(blur)
    change = 0.01 * blur
    _, slope = spectrum.misfit(blur, scene)
    above, below = (spectrum.misfit(blur + sign * change, scene)[0] for sign in (1, -1))
    assert 2 * float((slope * change).sum()) == pytest.approx(above - below, rel=0.02)


def test_a_smear_keeps_sums_and_is_its_own_transpose():
    spectrum = PhotoSpectrum(photo_of(Trajectory.straight(15.0)), sigma=NOISE)
    shape = (spectrum.fy.size, spectrum.fx.size)
    a, b = np.random.default_rng(0).random((2, *shape)).astype(np.float32)
    assert (spectrum.smeared(a) * b).sum() == pytest.approx(
        (a * spectrum.smeared(b)).sum(), rel=1e-4
    )
    inside = np.zeros(shape, dtype=np.float32)
    inside[5, 5] = 1
    assert spectrum.smeared(inside).sum() == pytest.approx(1)
