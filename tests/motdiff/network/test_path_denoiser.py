"""Denoiser of paths: its scaling before training, and what its condition is."""

import torch

from motdiff.network.path_denoiser import POINTS, SIGMA_DATA, PathDenoiser


def noisy(count=5):
    generator = torch.Generator().manual_seed(0)
    return torch.randn((count, POINTS - 1, 2), generator=generator)


def shaken(network):
    """Fill all weights at random: some are 0 before training."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(0.05 * torch.randn(parameter.shape, generator=generator))
    return network


def test_before_training_it_is_the_wiener_filter_of_white_coefficients():
    sigma = torch.tensor([0.01, 0.1, 0.7, 3.0, 50.0])
    denoised = PathDenoiser()(noisy(), sigma, torch.full((5,), 8.0))
    expected = noisy() * (SIGMA_DATA**2 / (SIGMA_DATA**2 + sigma**2))[:, None, None]
    torch.testing.assert_close(denoised, expected)


def test_at_the_smallest_noise_a_path_stays_as_it_is():
    network = shaken(PathDenoiser())
    denoised = network(noisy(), torch.full((5,), 1e-4), torch.full((5,), 8.0))
    torch.testing.assert_close(denoised, noisy(), atol=1e-3, rtol=0)


def test_noise_level_and_size_change_what_is_expected():
    network = shaken(PathDenoiser())
    sigma, radius_px = torch.full((5,), 0.5), torch.full((5,), 8.0)
    denoised = network(noisy(), sigma, radius_px)
    assert not torch.allclose(denoised, network(noisy(), sigma, 2 * radius_px))
    assert not torch.allclose(denoised, network(noisy(), 1.5 * sigma, radius_px))


def test_each_path_is_denoised_alone():
    network = shaken(PathDenoiser())
    sigma, radius_px = torch.linspace(0.1, 2, 5), torch.linspace(3, 20, 5)
    together = network(noisy(), sigma, radius_px)
    alone = torch.cat(
        [network(noisy()[i : i + 1], sigma[i : i + 1], radius_px[i : i + 1]) for i in range(5)]
    )
    torch.testing.assert_close(together, alone, atol=1e-6, rtol=1e-4)
