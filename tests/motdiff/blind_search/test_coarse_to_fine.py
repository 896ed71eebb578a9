"""The blind search as a whole: what each scale does, and what it is worth."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from dead_leaves import dead_leaves

from motdiff.blind_search import coarse_to_fine
from motdiff.blind_search.coarse_to_fine import PmpSettings, Start, estimate_kernels
from motdiff.blind_search.latent import l0_pmp_latent
from motdiff.metrics import mnc_subpixel
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory


def test_a_batch_gives_what_its_photos_give_alone():
    t = np.linspace(0, 1, 60)
    psf = Trajectory.from_samples(np.c_[10 * t, 6 * np.sin(2.5 * t)]).psf(25)
    photo = blur_valid(dead_leaves(230, 1), psf)
    photo = photo + np.random.default_rng(2).normal(0, 0.005, photo.shape)
    light = torch.from_numpy(np.clip(photo, 0, 1).astype(np.float32))
    one, two = light[:160, :160], light[40:200, 40:200]
    with torch.no_grad():
        together = estimate_kernels(torch.stack([one, two])[:, None], Start(21))
        alone = [estimate_kernels(photo[None, None], Start(21))[0] for photo in (one, two)]
    for i in range(2):  # hard thresholds magnify the last digit, which differs between processors
        assert mnc_subpixel(together[i].double().numpy(), alone[i].double().numpy()) > 0.98


@pytest.mark.parametrize("fine", [(), (3e-3, 1e-3)])
def test_each_scale_has_its_alternations_and_the_refinement_closes_where_all_gradients_count(
    monkeypatch, fine
):
    """Thirteen px: scales of 7, 11 and 13 px."""
    seen = []
    refined = []

    def latent(wrapped, kernel, *, intensity_weight, **_):
        seen.append((kernel.shape[-1], intensity_weight > 0))
        return l0_pmp_latent(wrapped, kernel, intensity_weight=intensity_weight, **_)

    monkeypatch.setattr(coarse_to_fine, "l0_pmp_latent", latent)
    monkeypatch.setattr(
        coarse_to_fine,
        "refine_kernel",
        lambda _photos, kernel, *, sigma, **_: refined.append(sigma) or kernel,
    )
    settings = PmpSettings(iterations=3, last_iterations=2, fine_weights=fine, sigma=0.01)
    light = torch.from_numpy(dead_leaves(60, 0).astype(np.float32))[None, None]
    kernel = estimate_kernels(light, Start(13), settings=settings)
    on_the_way = [True] * 3 + [False] * len(fine)
    assert (
        seen == [(side, salient) for side in (7, 11) for salient in on_the_way] + [(13, True)] * 2
    )
    assert refined == ([0.01] if fine else [])
    assert kernel.shape == (1, 13, 13)


def test_priors_fade_to_their_floors_and_progress_ends_at_one(monkeypatch):
    weights = []
    shares = []

    def latent(wrapped, _kernel, *, intensity_weight, gradient_weight, **_):
        weights.append((intensity_weight, gradient_weight))
        return wrapped

    monkeypatch.setattr(coarse_to_fine, "l0_pmp_latent", latent)
    light = torch.from_numpy(dead_leaves(40, 0).astype(np.float32))[None, None]
    estimate_kernels(
        light,
        Start(13, gradient_weight=4e-3),
        settings=PmpSettings(iterations=18, last_iterations=5, fine_weights=()),
        on_progress=shares.append,
    )
    intensity, gradient = np.transpose(weights)
    powers = 1.1 ** -np.arange(41.0)
    np.testing.assert_allclose(intensity, np.maximum(0.1 * powers, 1e-2))
    np.testing.assert_allclose(gradient, np.maximum(4e-3 * powers, 1e-4))
    assert len(shares) == 42
    assert shares[-2:] == pytest.approx([1, 1])
    # an alternation takes longer at full size than at half or a quarter of the pixels
    takes = np.diff(shares[:-1], prepend=0.0)
    np.testing.assert_allclose(takes[:18], takes[0])
    np.testing.assert_allclose(takes[18:36], takes[18])
    assert 0 < takes[0] < takes[18] < takes[36]


def test_looking_at_all_gradients_at_each_scale_brings_the_search_nearer():
    """Six shaken photos, the search shortened: salient edges alone lead away, even from the
    truth."""
    t = np.linspace(0, 1, 60)
    gains = []
    for seed in range(6):
        psf = Trajectory.from_samples(np.c_[14 * t, 9 * np.sin(4 * t + seed)]).psf(29)
        photo = blur_valid(dead_leaves(190, seed), psf)
        photo = np.clip(photo + np.random.default_rng(seed).normal(0, 0.005, photo.shape), 0, 1)
        light = torch.from_numpy(photo.astype(np.float32))[None, None]
        salient = PmpSettings(0.005, iterations=2, fine_weights=())
        fine = replace(salient, fine_weights=PmpSettings().fine_weights)
        with torch.no_grad():
            found = [
                estimate_kernels(light, Start(29, sparsity=1.0), settings=settings)[0].numpy()
                for settings in (salient, fine)
            ]
        gains.append(mnc_subpixel(found[1], psf) - mnc_subpixel(found[0], psf))
    assert np.mean(gains) > 0.03
