"""What physics says about a blur: correlations against scipy and closed forms, quick kernels
against the truth."""

import numpy as np
import pytest
import torch
from scipy import signal

from motdiff.blind_search.coarse_to_fine import Start
from motdiff.metrics import mnc
from motdiff.network.physics_maps import (
    QUICK_STARTS,
    autocorrelation,
    physics_maps,
    quick_kernels,
    spectral_maps,
)
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

ZERO = PSF_PX // 2


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def curved(size=64):
    t = np.linspace(0, 1, 60)
    return Trajectory.from_samples(np.c_[14 * t, 8 * np.sin(2.5 * t)], t=t**1.3).psf(size)


def point_symmetric(maps):
    """Equal to itself turned by 180 degrees about the zero lag; lag -32 has no partner."""
    inner = maps[..., 1:, 1:]
    torch.testing.assert_close(inner, inner.flip(-2, -1), atol=1e-5, rtol=0)


# ---- kernels


def test_autocorrelation_of_kernels_is_the_correlation_of_each_with_itself():
    kernels = np.stack([curved(), np.random.default_rng(0).random((64, 64))])
    maps = autocorrelation(torch.from_numpy(kernels)[:, None])
    assert maps.shape == (2, 1, 64, 64)
    for kernel, found in zip(kernels, maps[:, 0].numpy(), strict=True):
        full = signal.correlate2d(kernel, kernel)  # zero lag at index 63
        np.testing.assert_allclose(found, full[31:95, 31:95] / full[63, 63], atol=1e-12)
    assert torch.equal(maps.flatten(2).argmax(dim=2), torch.full((2, 1), ZERO * 64 + ZERO))
    torch.testing.assert_close(maps[..., ZERO, ZERO], torch.ones(2, 1, dtype=torch.float64))
    point_symmetric(maps)


def test_autocorrelation_does_not_know_where_the_kernel_lies_nor_its_direction():
    kernel = torch.from_numpy(curved())
    for other in (kernel.roll((5, -7), (0, 1)), kernel.flip(0, 1), 3 * kernel):
        torch.testing.assert_close(autocorrelation(other), autocorrelation(kernel))


def test_an_empty_kernel_has_an_empty_autocorrelation():
    assert not autocorrelation(torch.zeros(1, 2, 64, 64)).any()


# ---- photos


def natural_noise(count, side, *, seed=0):
    """White noise over f: the power spectrum of sharp scenes, and periodic."""
    white = torch.randn(
        count, side, side, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )
    fy = torch.fft.fftfreq(side)[:, None]
    fx = torch.fft.rfftfreq(side)[None, :]
    radius = (fx.square() + fy.square()).sqrt().clamp(min=1 / side)
    return torch.fft.irfft2(torch.fft.rfft2(white) / radius, s=(side, side))


@pytest.mark.parametrize("lag", [(0, 9), (12, -5), (-3, -20)])
def test_two_points_show_as_side_peaks_at_their_distance(lag):
    """|1/2 + 1/2 exp(i w)|^2 = 1/2 + 1/2 cos w: half the zero lag's peak on either side, as wide
    as the band allows.

    The cepstrum has 2 log|1 + exp(i w)| = 2 cos w - cos 2w + ...: up at the distance, down at
    twice it.
    """
    scene = natural_noise(12, 128)
    photos = (scene + scene.roll(lag, (1, 2)))[None] / 2
    correlation, cepstrum = spectral_maps(photos)[0]
    row, column = torch.meshgrid(torch.arange(64) - ZERO, torch.arange(64) - ZERO, indexing="ij")

    def peak_at(down, right):
        return torch.exp(-((row - down) ** 2 + (column - right) ** 2) * 2 * (np.pi * 0.22) ** 2)

    sides = peak_at(*lag) + peak_at(-lag[0], -lag[1])
    expected = peak_at(0, 0) + sides / 2
    linear = 4 * torch.atanh(
        (correlation / 4).clamp(-1 + 1e-12, 1 - 1e-12)
    )  # the peaks are held down
    assert (
        float(torch.corrcoef(torch.stack([linear.flatten(), expected.flatten()]))[0, 1]) > 0.95
    )  # 0.82 without the sides
    away = row.square() + column.square() > 3**2
    for map_ in (correlation, cepstrum):
        found = int(torch.where(away, map_, -torch.inf).argmax())
        assert (found // 64 - ZERO, found % 64 - ZERO) in (lag, (-lag[0], -lag[1]))
    if max(map(abs, lag)) < 16:
        assert float(cepstrum[ZERO + 2 * lag[0], ZERO + 2 * lag[1]]) < float(
            cepstrum.quantile(0.01)
        )


def test_spectral_maps_do_not_know_the_light_nor_its_level():
    photos = natural_noise(2, 96)[:, None]
    maps = spectral_maps(photos)
    torch.testing.assert_close(spectral_maps(0.02 * photos), maps, atol=1e-6, rtol=0)
    torch.testing.assert_close(spectral_maps(photos + 5), maps, atol=1e-6, rtol=0)
    point_symmetric(maps)


def test_spectral_maps_have_no_mean_and_never_exceed_4():
    maps = spectral_maps(natural_noise(3, 96).float()[:, None])
    assert maps.shape == (3, 2, 64, 64)
    assert maps.dtype == torch.float32
    assert float(maps.abs().max()) <= 4
    assert float(maps.mean(dim=(2, 3)).abs().max()) < 0.2  # 0 but for the peak, which is held down


def test_crops_are_averaged():
    photos = natural_noise(3, 96)
    together = spectral_maps(photos[None].repeat(1, 2, 1, 1))
    torch.testing.assert_close(together, spectral_maps(photos[None]))
    torch.testing.assert_close(spectral_maps(photos[None].flip(1)), spectral_maps(photos[None]))


def test_photos_need_not_be_square():
    wide = natural_noise(1, 128)[None, :, :80]
    turned = spectral_maps(wide.transpose(2, 3)).transpose(2, 3)
    torch.testing.assert_close(turned[:, 0], spectral_maps(wide)[:, 0])
    # the cepstrum's level is a mean over half of the spectrum, and that half is another one
    torch.testing.assert_close(turned[:, 1], spectral_maps(wide)[:, 1], atol=0.02, rtol=0)


@pytest.mark.parametrize("level", [0.0, 0.3, 1.0])
def test_flat_photos_say_nothing_but_nothing_wrong(level):
    """A burnt-out sky among the crops must not poison the training."""
    assert spectral_maps(torch.full((1, 1, 96, 96), level)).isfinite().all()
    flat_beside_scene = torch.cat(
        [torch.full((1, 1, 96, 96), level), natural_noise(1, 96)[None].float()], dim=1
    )
    assert spectral_maps(flat_beside_scene).isfinite().all()


def test_small_photos_are_refused():
    with pytest.raises(ValueError, match=r"^photos: sides must be at least 64 px, got 63 x 80$"):
        spectral_maps(torch.rand(1, 1, 80, 63))


# ---- quick kernels


def test_quick_kernels_find_a_straight_blur():
    rng = np.random.default_rng(1)
    blocks = np.full((192, 192), 0.5)
    for row, column, height, width in np.c_[
        rng.integers(-10, 192, (250, 2)), rng.integers(6, 50, (250, 2))
    ]:
        blocks[max(row, 0) : row + height, max(column, 0) : column + width] = rng.uniform(
            0.05, 0.95
        )
    truth = Trajectory.straight(11.0, angle_rad=0.5).psf(64)
    photo = blur_valid(blocks, truth)
    photos = torch.from_numpy(photo + rng.normal(0, 0.005, photo.shape)).float()[None, None]
    kernels = quick_kernels(photos, sigma=0.005)
    assert kernels.shape == (1, len(QUICK_STARTS), 64, 64)
    assert float(kernels.min()) >= 0
    torch.testing.assert_close(kernels.sum(dim=(2, 3)), torch.ones(1, len(QUICK_STARTS)))
    for kernel in kernels[0].double().numpy():
        assert mnc(kernel, truth) > 0.7
        assert mnc(kernel, truth) > mnc(kernel, truth[:, ::-1]) + 0.3
        lag = np.arange(64) - ZERO
        assert abs((kernel.sum(axis=0) * lag).sum()) < 1
        assert abs((kernel.sum(axis=1) * lag).sum()) < 1


def test_quick_kernels_end_each_scale_on_all_gradients_unless_told_otherwise():
    """As training had them and use has them: other kernels than the network knows would mislead
    it."""
    photos = torch.from_numpy(blur_valid(natural_noise(1, 110)[0].numpy(), curved(25))).float()[
        None, None
    ]
    usual, closed, open_ = (
        quick_kernels(photos, starts=(Start(15, 1.0),), **options)
        for options in ({}, {"fine_weights": (1e-3, 3e-4)}, {"fine_weights": ()})
    )
    torch.testing.assert_close(usual, closed, rtol=0, atol=0)
    assert (usual - open_).abs().max() > 1e-3


def test_quick_kernels_of_a_flat_photo_are_still_kernels():
    kernels = quick_kernels(
        torch.full((1, 1, 64, 64), 1.0), starts=(Start(15, 1.0), Start(21, 1.0))
    )
    torch.testing.assert_close(kernels.sum(dim=(2, 3)), torch.ones(1, 2))


def test_physics_maps_are_two_of_the_photo_and_two_of_each_kernel():
    photos = natural_noise(2, 96).float()[:, None]
    kernels = (
        torch.from_numpy(np.stack([curved(), curved()[::-1].copy(), 0 * curved()]))
        .float()
        .expand(2, 3, 64, 64)
    )
    maps = physics_maps(photos, kernels)
    assert maps.shape == (2, 2 + 2 * 3, 64, 64)
    torch.testing.assert_close(maps[:, :2], spectral_maps(photos))
    torch.testing.assert_close(maps[:, 2:4].amax(dim=(2, 3)), torch.ones(2, 2))
    torch.testing.assert_close(maps[:, 2:5] * kernels.amax(dim=(2, 3), keepdim=True), kernels)
    torch.testing.assert_close(maps[:, 5:], autocorrelation(kernels))
    assert not maps[:, (4, 7)].any()  # a lost kernel
