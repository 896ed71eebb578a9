"""Correction of kernels: its maps against sums over pixels, what they show, and the symmetries of
the network."""

import numpy as np
import pytest
import torch
from scipy import signal

from motdiff.blind_search.coarse_to_fine import fine_latent
from motdiff.blind_search.grids import QUARTER_TURNS, fast_size, mirrored, periodic_extension
from motdiff.metrics import mnc
from motdiff.network.correction import (
    MAPS,
    CorrectionNetwork,
    _wiener,
    corrected,
    corrected_kernel,
    correction_maps,
)
from motdiff.network.physics_maps import autocorrelation, spectral_maps
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

ZERO = 32
SHARP = np.kron(np.random.default_rng(3).random((40, 40)), np.ones((4, 4)))  # blocks of 4 px


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def kernel_of(*pixels):
    """Kernel of equal light at some displacements (down, right)."""
    kernel = np.zeros((64, 64))
    for down, right in pixels:
        kernel[ZERO + down, ZERO + right] = 1 / len(pixels)
    return kernel


def maps_of(sharps, true, told, *, sigma=0.0):
    """Maps of the kernel told, for photos of the sharp scenes blurred by the true one."""
    photos = torch.from_numpy(np.stack([blur_valid(sharp, true) for sharp in sharps])).float()
    kernel = torch.from_numpy(told)[None].float()
    return photos, correction_maps(
        photos[None], kernel, kernel[:, None].expand(-1, 2, -1, -1), sigma=sigma
    )


HOOK = kernel_of(*[(0, right) for right in range(-6, 7)], *[(down, 6) for down in range(1, 8)])
SHAFT = kernel_of(*[(0, right) for right in range(-6, 7)])  # the hook's end is missing


# ---- maps


def test_maps_are_the_kernel_the_others_and_those_of_the_photo_and_of_the_kernel():
    photos = torch.rand(2, 80, 72, generator=torch.Generator().manual_seed(0))
    kernels = torch.from_numpy(np.stack([HOOK, SHAFT])).float()
    others = torch.stack([kernels[[1, 0]], kernels[[0, 0]]])
    maps = correction_maps(photos[None], kernels, others, sigma=0.01)
    assert maps.shape == (2, MAPS, 64, 64)
    torch.testing.assert_close(maps[:, 0], kernels / kernels.amax(dim=(1, 2), keepdim=True))
    torch.testing.assert_close(maps[:, 1:3], others / others.amax(dim=(2, 3), keepdim=True))
    torch.testing.assert_close(maps[:, :8].abs().amax(dim=(2, 3)), torch.ones(2, 8))
    torch.testing.assert_close(maps[:, 8:10], spectral_maps(photos[None]).expand(2, -1, -1, -1))
    torch.testing.assert_close(maps[:, 10:], autocorrelation(kernels[:, None]))


def test_the_misfit_is_correlated_with_the_latent_gradients_of_all_crops():
    photos, maps = maps_of([SHARP, SHARP[::-1] ** 2], HOOK, SHAFT, sigma=0.01)
    count, height, width = photos.shape
    wrapped = periodic_extension(photos, (fast_size(height + 63), fast_size(width + 63)))
    kernel = torch.from_numpy(SHAFT).float()
    latent = fine_latent(wrapped, kernel.expand(count, -1, -1), sigma=0.01)[:, :height, :width]
    expected = np.zeros((64, 64))
    for photo, sharp in zip(
        photos.double().numpy(), latent.clamp(-0.5, 1.5).double().numpy(), strict=True
    ):
        for axis in (0, 1):
            seen, own = (
                np.diff(image, axis=axis)[: height - 1, : width - 1] for image in (photo, sharp)
            )
            blurred = signal.convolve2d(own, SHAFT)[
                ZERO : ZERO + height - 1, ZERO : ZERO + width - 1
            ]
            full = signal.correlate2d(
                seen - blurred, own
            )  # zero lag at the index of the size less 1
            expected += full[
                height - 2 - ZERO : height - 2 + ZERO, width - 2 - ZERO : width - 2 + ZERO
            ]
    np.testing.assert_allclose(maps[0, 7].numpy(), expected / np.abs(expected).max(), atol=1e-3)


def test_the_misfit_shows_where_light_is_missing():
    _, maps = maps_of([SHARP], HOOK, SHAFT)
    end = maps[0, 7, ZERO + 1 : ZERO + 8, ZERO + 6]
    assert end.min() > 0
    assert end.mean() > 3 * maps[0, 7].abs().mean()


@pytest.mark.parametrize("ridge", [3, 4, 5, 6])
def test_without_noise_the_least_squares_kernels_of_the_true_one_are_true(ridge):
    _, maps = maps_of([SHARP], HOOK, HOOK)
    assert mnc(maps[0, ridge].clamp(min=0).numpy(), HOOK) > 0.9


@pytest.mark.parametrize(("sigma", "penalty"), [(0.0, 3e-4), (0.05, 0.2503)])
def test_restored_waves_are_fainter_by_the_penalty_on_their_gradients(sigma, penalty):
    waves = 7
    phase = 2 * np.pi * waves * np.arange(96) / 96
    photo = torch.from_numpy(np.tile(np.cos(phase), (64, 1))).float()
    point = torch.from_numpy(kernel_of((0, 0)))[None].float()
    restored = _wiener(photo[None], point, sigma)
    gradient_power = 4 * np.sin(np.pi * waves / 96) ** 2  # of neighbours' differences
    torch.testing.assert_close(
        restored[0], photo / (1 + penalty * gradient_power), rtol=1e-4, atol=1e-5
    )


def test_the_maps_of_a_transposed_photo_are_transposed():
    _, maps = maps_of([SHARP], HOOK, SHAFT, sigma=0.01)
    _, transposed = maps_of([SHARP.T], HOOK.T, SHAFT.T, sigma=0.01)
    for number in (
        *range(8),
        10,
    ):  # the cepstrum's logarithm enlarges the last bits of empty frequencies
        torch.testing.assert_close(transposed[0, number], maps[0, number].T, atol=0.01, rtol=0)


def test_a_photo_below_64_px_is_refused():
    kernel = torch.from_numpy(HOOK)[None].float()
    with pytest.raises(ValueError, match="sides must be at least 64 px, got 70 x 63"):
        correction_maps(
            torch.rand(1, 1, 63, 70), kernel, kernel[:, None].expand(-1, 2, -1, -1), sigma=0.0
        )


# ---- network


@pytest.fixture(scope="module")
def network():
    """One that corrects at random."""
    torch.manual_seed(0)
    made = CorrectionNetwork()
    torch.nn.init.normal_(made.out.weight, std=0.1)
    return made.eval().requires_grad_(False)


def some_maps(count):
    return torch.rand(count, MAPS, 64, 64, generator=torch.Generator().manual_seed(1))


def test_a_new_network_changes_nothing():
    maps = some_maps(2)
    torch.testing.assert_close(CorrectionNetwork().eval()(maps), maps[:, 0])


def test_corrected_kernels_are_kernels(network):
    kernels = corrected(network, 0.1 * some_maps(3))
    assert kernels.shape == (3, 64, 64)
    assert kernels.min() == 0
    assert kernels[kernels > 0].min() >= 0.02 * kernels.amax(dim=(1, 2)).min() - 1e-9
    torch.testing.assert_close(kernels.sum(dim=(1, 2)), torch.ones(3))


@pytest.mark.parametrize("symmetries", [QUARTER_TURNS, range(8)])
def test_the_mean_correction_of_turned_maps_is_turned(network, symmetries):
    maps = some_maps(1)
    mean = corrected(network, maps, symmetries)
    for symmetry in symmetries:
        turned = corrected(network, mirrored(maps, symmetry, pitch=1), symmetries)
        torch.testing.assert_close(turned, mirrored(mean[:, None], symmetry, pitch=1)[:, 0])


def test_a_kernel_is_corrected_in_quarter_turns_and_then_in_all_symmetries():
    seen = []

    def network(maps):
        seen.append(len(maps))
        return maps[:, 0]

    photo = torch.rand(1, 80, 80, generator=torch.Generator().manual_seed(0)).numpy()
    kernel = Trajectory.straight(9.0, angle_rad=0.4).psf(63)
    found = corrected_kernel(network, photo, kernel, [kernel], sigma=0.01)
    assert seen == [4, 8]
    assert mnc(found, kernel) > 0.999
