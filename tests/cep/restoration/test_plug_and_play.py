"""Plug-and-play restoration: its algebra with linear denoisers in place of the trained one, then
the trained one."""

import numpy as np
import pytest
from skimage import data

from cep.files.images import read_photo
from cep.optics.camera import Camera
from cep.optics.capture import capture
from cep.restoration.plug_and_play import pnp
from cep.restoration.registry import METHODS
from cep.restoration.restore import restore
from cep.restoration.wiener import wiener
from motdiff.simulate import visible
from motdiff.trajectory import Trajectory

BITS = "1011000110111010"  # no zero on the circle


def coded_psf(length_px=9.0, size=32, angle_rad=0.5):
    slices = Trajectory.straight(length_px, angle_rad=angle_rad).slice_psfs(
        np.linspace(0, 1, len(BITS) + 1), size
    )
    return np.tensordot([float(b) for b in BITS], slices, axes=1)


def otf(psf, shape):
    """Full spectrum of the PSF on a periodic grid."""
    grid = np.zeros(shape)
    for row, column in zip(*np.nonzero(psf), strict=True):
        grid[(row - psf.shape[0] // 2) % shape[0], (column - psf.shape[1] // 2) % shape[1]] += psf[
            row, column
        ]
    return np.fft.fft2(grid)


def blur_periodic(scene, psf):
    return np.fft.ifft2(np.fft.fft2(scene) * otf(psf, scene.shape)).real


def psnr(a, b):
    return -10 * np.log10(np.mean((a - b) ** 2))


def unchanged(image, sigma):
    return image


@pytest.fixture(scope="module")
def scene():
    return ((data.camera() / 255.0) ** 2.2)[60:260, 100:300]


# ---- the splitting


def test_without_a_denoiser_the_wiener_filter_s_error_shrinks_by_a_closed_form(scene):
    """With x = z each step brings a frequency closer to y / H, by a / (|H|^2 + a)."""
    psf = coded_psf()
    variance = 1e-5
    rng = np.random.default_rng(0)
    photo = 0.2 + blur_periodic(scene[:90, :101], psf)  # no light below 0, which would be cut
    photo += np.sqrt(variance) * rng.standard_normal(photo.shape)
    restored = pnp(photo, psf, noise_variance=variance, denoiser=unchanged, border="periodic")

    first = wiener(photo, psf, noise_variance=variance, border="periodic")
    transfer = otf(psf, photo.shape)
    duty = psf.sum()
    exact = np.fft.fft2(photo) / transfer
    sigmas = np.geomspace(0.1, np.sqrt(variance) / duty, 6)
    weights = 0.4 * variance / duty**2 / sigmas[1:] ** 2
    shares = np.prod([a / (np.abs(transfer / duty) ** 2 + a) for a in weights], axis=0)
    expected = np.fft.ifft2(exact + shares * (np.fft.fft2(first) - exact)).real
    np.testing.assert_allclose(restored, expected, atol=2e-4 * np.std(expected))
    assert np.abs(expected - first).max() > 0.01  # they could have been told apart


def test_a_denoiser_that_knows_the_scene_s_law_comes_close_to_the_best_linear_filter():
    """For a Gaussian scene of spectrum A / f^2 the right denoiser is A / (A + s^2 f^2), the best
    filter Wiener's."""
    rng = np.random.default_rng(3)
    strength = 1e-4
    variance = 1e-4
    shape = (128, 128)
    f2 = np.fft.fftfreq(128)[:, None] ** 2 + np.fft.rfftfreq(128)[None] ** 2
    drawn = np.fft.rfft2(rng.standard_normal(shape)) * np.sqrt(
        strength / np.where(f2 > 0, f2, np.inf)
    )
    truth = 0.5 + np.fft.irfft2(drawn, shape)  # no light below 0, which would be cut
    psf = coded_psf()
    photo = blur_periodic(truth, psf) + np.sqrt(variance) * rng.standard_normal(shape)

    def gaussian(image, sigma):
        return np.fft.irfft2(np.fft.rfft2(image) * strength / (strength + sigma**2 * f2), shape)

    found = pnp(photo, psf, noise_variance=variance, denoiser=gaussian, border="periodic")
    best = wiener(photo, psf, noise_variance=variance, scene_strength=strength, border="periodic")
    naive = pnp(photo, psf, noise_variance=variance, denoiser=unchanged, border="periodic")
    assert psnr(best, truth) - 1.0 < psnr(found, truth) < psnr(best, truth) + 1e-9
    assert psnr(naive, truth) < psnr(found, truth) - 3


@pytest.mark.parametrize("size", [31, 32])
def test_noise_free_periodic_photo_is_recovered(scene, size):
    psf = coded_psf(size=size)
    photo = blur_periodic(scene[:90, :101], psf)
    restored = pnp(photo, psf, noise_variance=0.0, denoiser=unchanged, border="periodic")
    np.testing.assert_allclose(restored, scene[:90, :101], atol=3e-3)


def test_levels_fall_log_evenly_to_the_noise_at_full_exposure(scene):
    told = []

    def noted(image, sigma):
        told.append(float(sigma[0]))
        return image

    psf = coded_psf()
    pnp(scene, psf, noise_variance=1e-6, denoiser=noted)
    assert told[0] == pytest.approx(0.1)
    assert told[-1] == pytest.approx(1e-3 / psf.sum())
    np.testing.assert_allclose(np.diff(np.log(told)), np.diff(np.log(told))[0])
    told.clear()
    pnp(scene, psf, noise_variance=1.0, denoiser=noted)  # noisier than where they start from
    np.testing.assert_allclose(told, 1 / psf.sum())


def test_the_camera_s_noise_is_its_mean_over_the_photo(scene):
    camera = Camera(photons_full_scale=2000)
    psf = coded_psf()
    photo = capture(scene, psf, camera=camera, rng=np.random.default_rng(0))
    by_camera = pnp(photo, psf, camera=camera)
    np.testing.assert_allclose(
        by_camera,
        pnp(photo, psf, noise_variance=float(camera.noise_variance(photo).mean())),
        atol=1e-9,
    )


# ---- with the trained denoiser


def test_a_photo_is_restored_best_by_its_own_camera(scene):
    psf = coded_psf()
    dim, bright = Camera(photons_full_scale=300), Camera(photons_full_scale=1e6)
    photo = capture(scene, psf, camera=dim, rng=np.random.default_rng(0))
    truth = visible(scene, 32)
    by_own, by_other = (psnr(pnp(photo, psf, camera=camera), truth) for camera in (dim, bright))
    assert by_own > by_other + 2


def test_it_is_the_method_pnp():
    assert METHODS["pnp"].function is pnp


def test_scale_is_that_of_the_full_exposure_and_colour_is_per_channel(scene):
    psf = coded_psf()
    colour = np.stack([scene, 0.5 * scene, 0.25 * scene], axis=-1)[:120, :131]
    photo = capture(
        colour, psf, camera=Camera(photons_full_scale=1e6), rng=np.random.default_rng(0)
    )
    truth = visible(colour, 32)
    result = restore(photo, psf, method="pnp")
    assert result.image.shape == photo.shape
    np.testing.assert_allclose(result.image.mean(axis=(0, 1)), truth.mean(axis=(0, 1)), rtol=0.02)
    assert psnr(result.image, truth) > psnr(photo / psf.sum(), truth) + 5
    np.testing.assert_allclose(result.image[..., 1], pnp(photo[..., 1], psf), atol=1e-5)


@pytest.mark.parametrize("photons", [1000, 20_000, 1e6])
@pytest.mark.parametrize("bits", ["1", BITS])
def test_it_beats_the_wiener_filter_that_is_told_the_same(scene, photons, bits):
    slices = Trajectory.straight(15.0, angle_rad=0.5).slice_psfs(
        np.linspace(0, 1, len(bits) + 1), 32
    )
    psf = np.tensordot([float(b) for b in bits], slices, axes=1)
    camera = Camera(photons_full_scale=photons)
    photo = capture(scene, psf, camera=camera, rng=np.random.default_rng(0))
    truth = visible(scene, 32)
    gain_db = psnr(pnp(photo, psf, camera=camera), truth) - psnr(
        wiener(photo, psf, camera=camera), truth
    )
    assert gain_db > 0.3


def test_real_borders_beat_the_periodic_assumption(scene):
    psf = coded_psf(15.0)
    photo = capture(
        scene, psf, camera=Camera(photons_full_scale=20_000), rng=np.random.default_rng(0)
    )
    truth = visible(scene, 32)
    assert psnr(pnp(photo, psf), truth) > psnr(pnp(photo, psf, border="periodic"), truth) + 3


@pytest.mark.parametrize("noise", [None, 0.0, 1e-4])
def test_an_even_photo_stays_as_bright_as_it_was(noise):
    restored = pnp(np.full((64, 75), 0.3), coded_psf(), noise_variance=noise)
    inner = restored[8:-8, 8:-8]
    assert inner.mean() == pytest.approx(0.3 / coded_psf().sum(), rel=2e-3)
    np.testing.assert_allclose(inner, 0.3 / coded_psf().sum(), rtol=0.02)


# ---- bad input


@pytest.mark.parametrize(
    ("photo", "psf", "options", "said"),
    [
        (np.ones((8, 8, 4)), np.ones((1, 1)), {}, "photo: must be"),
        (np.ones((1, 1)), np.ones((1, 1)), {}, "photo: must be at least 3 x 3"),
        (np.full((8, 8), np.nan), np.ones((1, 1)), {}, "photo: must be finite"),
        (np.ones((8, 8)), np.zeros((3, 3)), {}, "psf: must be"),
        (
            np.ones((8, 8)),
            np.ones((1, 1)),
            {"noise_variance": -1.0},
            "noise_variance: must be 0 or more",
        ),
        (
            np.ones((8, 8)),
            np.ones((1, 1)),
            {"noise_variance": np.inf},
            "noise_variance: must be 0 or more",
        ),
        (
            np.ones((8, 8)),
            np.ones((1, 1)),
            {"noise_variance": 1.0, "camera": Camera()},
            "not both",
        ),
    ],
)
def test_bad_input(photo, psf, options, said):
    with pytest.raises(ValueError, match=said) as caught:
        pnp(photo, psf, **options)
    assert "\n" not in str(caught.value)


# ---- the command


def test_deblur_takes_the_camera_s_noise_with_it(cep, workplace):
    told = ("deblur", "blurred.png", "--trajectory", "trajectory.json", "--method", "pnp")
    assert cep.succeeds(*told, "--photons", "1e5", "-o", "bright.png")["method"] == "pnp"
    cep.succeeds(*told, "--photons", "100", "-o", "dark.png")
    bright, dark = (read_photo(f"{name}.png").pixels for name in ("bright", "dark"))
    assert np.abs(dark - bright).max() > 0.02
    line = cep.refuses(*told[:-1], "tv", "--photons", "100", "-o", "tv.png")
    assert "wiener and pnp" in line
