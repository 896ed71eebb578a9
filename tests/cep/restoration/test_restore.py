import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from skimage import data

from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.restoration.blur import trimmed_psf
from cep.restoration.registry import METHODS
from cep.restoration.restore import restore
from cep.restoration.result import misfit
from cep.restoration.tv import divergence, shrink_gradients, tv
from cep.restoration.wiener import wiener
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory

# pnp is for a known camera: test_plug_and_play.py
ALL = [method.function for name, method in METHODS.items() if name != "pnp"]
BITS = "1011000110111010"  # no zero on the circle


def coded_psf(length_px=9.0, size=32, angle_rad=0.5):
    slices = Trajectory.straight(length_px, angle_rad=angle_rad).slice_psfs(
        np.linspace(0, 1, len(BITS) + 1), size
    )
    return np.tensordot([float(b) for b in BITS], slices, axes=1)


def blur_periodic(scene, psf):
    """Direct sum over the PSF's pixels: no FFT."""
    out = np.zeros(scene.shape)
    for row, column in zip(*np.nonzero(psf), strict=True):
        shift = (row - psf.shape[0] // 2, column - psf.shape[1] // 2)
        out += psf[row, column] * np.roll(scene, shift, axis=(0, 1))
    return out


def psnr(a, b):
    return -10 * np.log10(np.mean((a - b) ** 2))


@pytest.fixture(scope="module")
def scene():
    return ((data.camera() / 255.0) ** 2.2)[60:260, 100:300]


@pytest.mark.parametrize("size", [31, 32])
def test_noise_free_periodic_photo_is_recovered_exactly(scene, size):
    psf = coded_psf(size=size)
    photo = blur_periodic(scene[:90, :101], psf)
    restored = wiener(photo, psf, noise_variance=0.0, border="periodic")
    np.testing.assert_allclose(restored, scene[:90, :101], atol=1e-9)


def test_wiener_with_all_noise_is_flat(scene):
    psf = coded_psf()
    photo = scene[:64, :64]
    flat = wiener(photo, psf, noise_variance=np.inf, border="periodic")
    np.testing.assert_allclose(flat, photo.mean() / psf.sum(), atol=1e-12)


def test_wiener_has_the_least_error_among_its_own_strengths():
    # a scene drawn from the very prior the filter assumes
    rng = np.random.default_rng(3)
    f2 = np.fft.fftfreq(128)[:, None] ** 2 + np.fft.rfftfreq(128)[None] ** 2
    f2[0, 0] = np.inf
    truth = np.fft.irfft2(
        np.fft.rfft2(rng.standard_normal((128, 128))) * np.sqrt(1e-4 / f2), (128, 128)
    )
    psf = coded_psf()
    photo = blur_periodic(truth, psf) + 0.05 * rng.standard_normal(truth.shape)
    errors = [
        np.mean(
            (
                wiener(
                    photo, psf, noise_variance=k * 0.05**2, scene_strength=1e-4, border="periodic"
                )
                - truth
            )
            ** 2
        )
        for k in (0.2, 0.5, 1.0, 2.0, 5.0)
    ]
    assert np.argmin(errors) == 2
    estimated = wiener(photo, psf, border="periodic")
    assert np.mean((estimated - truth) ** 2) < 1.01 * errors[2]


@pytest.mark.parametrize("method", ALL)
def test_scale_is_that_of_the_full_exposure_and_colour_is_per_channel(scene, method):
    psf = coded_psf()
    duty = psf.sum()
    assert 0.4 < duty < 0.7
    colour = np.stack([scene, 0.5 * scene, 0.25 * scene], axis=-1)[:120, :130]
    photo = capture(
        colour, psf, camera=Camera(photons_full_scale=1e6), rng=np.random.default_rng(0)
    )
    restored = method(photo, psf)
    assert restored.shape == photo.shape
    np.testing.assert_allclose(
        restored.mean(axis=(0, 1)), visible(colour, 32).mean(axis=(0, 1)), rtol=0.02
    )
    assert psnr(restored, visible(colour, 32)) > psnr(photo / duty, visible(colour, 32)) + 3


def test_flat_photo_stays_flat():
    for method in ALL:
        np.testing.assert_allclose(
            method(np.full((40, 43), 0.3), coded_psf()), 0.3 / coded_psf().sum(), atol=1e-6
        )


@pytest.mark.parametrize(("method", "gain_db"), [(wiener, 4.0), (tv, 5.0)])
def test_known_psf_improves_a_noisy_photo(scene, method, gain_db):
    psf = coded_psf()
    photo = capture(
        scene, psf, camera=Camera(photons_full_scale=20_000), rng=np.random.default_rng(0)
    )
    truth = visible(scene, 32)
    assert psnr(method(photo, psf), truth) > psnr(photo / psf.sum(), truth) + gain_db


@pytest.mark.parametrize("method", ALL)
def test_real_borders_beat_the_periodic_assumption(scene, method):
    psf = coded_psf(15.0)
    photo = capture(
        scene, psf, camera=Camera(photons_full_scale=20_000), rng=np.random.default_rng(0)
    )
    truth = visible(scene, 32)
    assert psnr(method(photo, psf), truth) > psnr(method(photo, psf, border="periodic"), truth) + 3


@given(st.integers(0, 31), st.integers(0, 31), st.sampled_from(ALL))
@settings(max_examples=20, deadline=None)
def test_a_shifted_periodic_photo_is_restored_shifted(down, right, method):
    photo = np.random.default_rng(0).random((32, 32))
    options = {"noise_variance": 1e-4, "scene_strength": 1e-4} if method is wiener else {}
    psf = coded_psf()
    restored = method(photo, psf, border="periodic", **options)
    moved = method(np.roll(photo, (down, right), (0, 1)), psf, border="periodic", **options)
    np.testing.assert_allclose(moved, np.roll(restored, (down, right), (0, 1)), atol=1e-7)


def test_divergence_is_the_adjoint_of_the_gradient():
    rng = np.random.default_rng(0)
    image, p, q = (rng.standard_normal((2, 9, 12)) for _ in range(3))
    across, down = shrink_gradients(image, 0.0)
    assert np.sum(across * p + down * q) == pytest.approx(np.sum(image * divergence(p, q)))


def test_restore_reports_misfit_border_and_clipping(scene):
    psf = coded_psf()
    bright = np.clip(scene * 3, 0, 3)
    camera = Camera(photons_full_scale=1e5, read_noise_e=0.0)
    result = restore(
        capture(bright, psf, camera=camera, rng=np.random.default_rng(0)),
        psf,
        method="wiener",
        camera=camera,
    )
    assert result.method == "wiener"
    assert result.unreliable_px == trimmed_psf(psf).shape[0] // 2
    assert result.saturated_fraction > 0.01
    assert "clipped" in result.warnings[0]
    dim = capture(scene * 0.5, psf, camera=camera, rng=np.random.default_rng(0))
    clean = restore(dim, psf, method="tv")
    assert clean.warnings == ()
    assert clean.residual == misfit(dim, clean.image, psf)
    assert clean.seconds > 0


def test_misfit_of_the_truth_is_the_noise(scene):
    psf = coded_psf()
    truth = visible(scene, 32)
    photo = ndimage.convolve(truth, trimmed_psf(psf)) + 0.01 * np.random.default_rng(
        0
    ).standard_normal(truth.shape)
    assert misfit(photo, truth, psf) == pytest.approx(0.01, rel=0.03)
    assert np.isnan(misfit(photo[:5, :5], truth[:5, :5], psf))


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize(
    ("photo", "psf", "said"),
    [
        (np.ones((8, 8, 4)), np.ones((1, 1)), "photo: must be"),
        (np.ones((1, 1)), np.ones((1, 1)), "photo: must be at least 3 x 3"),
        (np.full((8, 8), np.nan), np.ones((1, 1)), "photo: must be finite"),
        (np.ones((8, 8)), np.zeros((3, 3)), "psf: must be"),
        (np.ones((8, 8)), -np.ones((3, 3)), "psf: must be"),
        (np.ones((8, 8)), np.ones((3, 3, 3)), "psf: must be"),
    ],
)
def test_bad_arrays(method, photo, psf, said):
    with pytest.raises(ValueError, match=said):
        method(photo, psf)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda a, k: restore(a, k, method="magic"), f"must be one of {', '.join(METHODS)}, or"),
        (lambda a, k: tv(a, k, weight=0.0), "weight"),
        (lambda a, k: wiener(a, k, noise_variance=-1.0), "noise_variance"),
        (lambda a, k: wiener(a, k, noise_variance=1.0, camera=Camera()), "not both"),
        (lambda a, k: wiener(a, k, scene_strength=0.0), "scene_strength"),
    ],
)
def test_bad_options(call, said):
    with pytest.raises(ValueError, match=said):
        call(np.ones((8, 8)), np.ones((1, 1)))
