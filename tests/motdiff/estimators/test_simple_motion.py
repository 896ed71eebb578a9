import numpy as np
import pytest

from motdiff.estimators.simple_motion import PhotoSpectrum, simple_motion
from motdiff.metrics import mnc_subpixel, timed_distance_px
from motdiff.motions import boracchi_foi
from motdiff.simulate import photograph
from motdiff.tracing.path_otf import kernel_otf
from motdiff.tracing.quadratic import QuadraticPath
from motdiff.trajectory import Trajectory

NOISE = 0.005


def scene_of(side, seed=0):
    """A scene with the power spectrum of photographs, f^-2.36."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))
    frequency[0, 0] = np.inf
    image = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((side, side))) / frequency**1.18)
    return np.clip(0.5 + 0.15 * image / image.std(), 0, 1)


def photo_of(path, seed=0):
    rng = np.random.default_rng([seed, 1])
    return photograph(scene_of(340, seed), path, rng=rng, read_sigma=NOISE)[:256, :256]


def blotchy(psf, seed=0):
    """A kernel as a search leaves it: right on the whole, wrong in every pixel."""
    rng = np.random.default_rng(seed)
    kernel = psf * rng.uniform(0.2, 1.8, psf.shape)
    return kernel / kernel.sum()


@pytest.mark.parametrize(
    ("a", "b"),
    [((22.0, 9.0), (0.0, 0.0)), ((20.0, -12.0), (5.0, 7.0)), ((6.0, 24.0), (2.0, 8.0))],
)
def test_straight_bent_and_accelerated_motions_are_exact_to_a_fraction_of_a_pixel(a, b):
    truth = QuadraticPath(np.array(a), np.array(b)).trajectory()
    psf = truth.psf(63)
    kernel = blotchy(psf)
    motion = simple_motion(photo_of(truth)[None], kernel, sigma=NOISE)
    assert motion is not None
    assert mnc_subpixel(motion.psf, psf) > mnc_subpixel(kernel, psf) + 0.05
    apart_px = min(
        timed_distance_px(path, truth) for path in (motion.path, motion.path.reversed())
    )
    assert apart_px < 0.5
    assert 0 < motion.error_px < 1
    np.testing.assert_allclose(motion.psf, motion.path.psf(63))


def test_a_walk_is_no_simple_motion():
    walk = boracchi_foi(np.random.default_rng(3))
    assert simple_motion(photo_of(walk)[None], walk.psf(63), sigma=NOISE) is None


def test_a_motion_that_the_photo_does_not_show_is_refused():
    other = Trajectory.straight(24.0, angle_rad=1.3)
    photo = photo_of(Trajectory.straight(24.0, angle_rad=0.3))
    assert simple_motion(photo[None], other.psf(63), sigma=NOISE) is None


# -- likelihood of a blur -------------------------------------------------------------------------


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
