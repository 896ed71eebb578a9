"""Batched blur and photography against the float64 blur of :mod:`motdiff.simulate`, and what each
option must do."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from motdiff.simulate import blur_symmetric, blur_valid
from motdiff.training.simulation import Photography, blurred, jpeg_loss, photographed
from motdiff.trajectory import Trajectory

PLAIN = Photography(most_noise=0.0, gammas=(1.0, 1.0), wrong_gamma=0.0, gains=(1.0, 1.0), jpeg=0.0)
"""Only motion blur, and the 8 bits of a file."""


def psfs(*, size=64):
    t = np.linspace(0, 1, 80)
    bent = Trajectory.from_samples(np.c_[14 * t, 9 * np.sin(2.5 * t)], t=t**1.3)
    straight = Trajectory.straight(11.3, angle_rad=0.7)
    return torch.from_numpy(np.stack([bent.psf(size), straight.psf(size)])).float()


def scene(side, *, batch=2, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(batch, 3, side, side, generator=generator)


def taken(sharp, kernels, photography, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return photographed(sharp, kernels, photography=photography, generator=generator)


def oracle(blur, sharp, kernels):
    pairs = zip(sharp.double(), kernels.double(), strict=True)
    photos = [
        blur(image.permute(1, 2, 0).numpy(), psf.numpy()).transpose(2, 0, 1)
        for image, psf in pairs
    ]
    return torch.from_numpy(np.stack(photos)).float()


# ---- blur


@pytest.mark.parametrize("shape", [(96, 101), (77, 80)])
@pytest.mark.parametrize("size", [29, 64])
def test_blur_is_the_one_with_real_borders(shape, size):
    sharp = scene(101)[:, :, : shape[0], : shape[1]]
    kernels = psfs(size=size)
    result = blurred(sharp, kernels[:, None])
    assert result.shape == (2, 3, shape[0] - size + 1, shape[1] - size + 1)
    torch.testing.assert_close(result, oracle(blur_valid, sharp, kernels), atol=1e-5, rtol=0)


def test_each_photo_has_its_own_kernel():
    sharp = scene(90)
    torch.testing.assert_close(
        blurred(sharp, psfs()[:, None])[1:], blurred(sharp[1:], psfs()[1:, None])
    )


def test_a_point_draws_the_kernel_around_itself():
    sharp = torch.zeros(2, 1, 127, 127)
    sharp[:, :, 63, 63] = 1
    drawn = blurred(sharp, psfs()[:, None])  # row r of the photo is row r + 31 of the scene
    torch.testing.assert_close(drawn[:, 0], psfs(), atol=1e-6, rtol=0)


# ---- photos without noise


@pytest.mark.parametrize(
    ("borders", "blur"), [("real", blur_valid), ("symmetric", blur_symmetric)]
)
def test_plain_photos_are_the_blurred_scene_in_8_bits(borders, blur):
    photography = replace(PLAIN, borders=borders)
    sharp = scene(96 + photography.margin)
    photos, sigma = taken(sharp, psfs(), photography)
    expected = oracle(blur, sharp, psfs())
    assert photos.shape == expected.shape == (2, 3, 96, 96)
    assert float((photos - expected).abs().max()) < 0.5 / 255 + 1e-5
    torch.testing.assert_close((255 * photos).round() / 255, photos)
    assert not sigma.any()


def test_real_borders_need_63_px_more():
    assert Photography(borders="real").margin == 63
    assert Photography(borders="symmetric").margin == 0


def test_borders_do_not_change_the_middle():
    sharp = scene(96 + 63)
    real, _ = taken(sharp, psfs(), PLAIN)
    mirrored, _ = taken(sharp[..., 31:-32, 31:-32], psfs(), replace(PLAIN, borders="symmetric"))
    inside = (..., slice(32, -32), slice(32, -32))
    torch.testing.assert_close(real[inside], mirrored[inside], atol=1.01 / 255, rtol=0)
    assert float((real - mirrored).abs().max()) > 0.05


@pytest.mark.parametrize("gain", [0.6, 1.5])
def test_gain_scales_the_light_and_full_scale_clips_it(gain):
    sharp = scene(159)
    photos, _ = taken(sharp, psfs(), replace(PLAIN, gains=(gain, gain)))
    expected = (gain * oracle(blur_valid, sharp, psfs())).clamp(0, 1)
    assert float((photos - expected).abs().max()) < 0.5 / 255 + 1e-5


def test_gamma_blurs_light_and_half_of_the_photos_have_none():
    """Two flat halves: within the blurred step, light and display values differ."""
    sharp = torch.full((40, 3, 64 + 63, 64 + 63), 0.1)
    sharp[..., 60:] = 0.9
    line = torch.from_numpy(Trajectory.straight(30.0).psf(64)).float().expand(40, 64, 64)
    photos, _ = taken(sharp, line, replace(PLAIN, gammas=(2.2, 2.2)))
    errors = []
    for gamma in (1.0, 2.2):
        light = blurred(sharp[:1] ** gamma, line[:1, None])
        errors.append(
            (photos ** (1 / gamma) - light ** (1 / gamma)).abs().amax(dim=(1, 2, 3)) * 255
        )
    kinds = torch.stack([error < 0.51 for error in errors])
    assert bool((kinds.sum(dim=0) == 1).all())  # every photo is of one kind and not of the other
    assert 10 <= int(kinds[0].sum()) <= 30


def test_wrong_gamma_spares_the_share_it_should_and_keeps_black_and_white():
    sharp = scene(64 + 63, batch=60, seed=3)
    kernels = psfs()[:1].expand(60, 64, 64)
    right, _ = taken(sharp, kernels, PLAIN)
    wrong, _ = taken(sharp, kernels, replace(PLAIN, wrong_gamma=0.4))
    changed = (wrong - right).abs().amax(dim=(1, 2, 3)) > 1e-3
    assert 14 <= int(changed.sum()) <= 34
    exponents = (wrong.log() / right.log()).amin(dim=(1, 2, 3))
    assert 0.7 - 1e-3 <= float(exponents.min()) <= float(exponents.max()) <= 1.4 + 1e-3


def test_jpeg_photos_went_through_it_once():
    sharp = scene(159)
    plain, _ = taken(sharp, psfs(), PLAIN)
    lossy, _ = taken(sharp, psfs(), replace(PLAIN, jpeg=1.0, qualities=(80.0, 80.0)))
    torch.testing.assert_close(
        lossy, jpeg_loss(blurred(sharp, psfs()[:, None]).clamp(0, 1), torch.full((2,), 80.0))
    )
    assert float((lossy - plain).abs().mean()) > 1e-4


# ---- noise and seeds


def test_noise_has_the_deviation_that_is_told():
    sharp = torch.full((6, 3, 127, 127), 0.5)
    kernels = psfs()[:1].expand(6, 64, 64)
    photos, sigma = taken(sharp, kernels, replace(PLAIN, most_noise=0.1))
    assert float(sigma.min()) >= 0
    assert float(sigma.max()) <= 0.1
    measured = photos.flatten(1).std(dim=1)
    expected = (sigma.square() + (1 / 255) ** 2 / 12).sqrt()  # and that of rounding to 8 bits
    loud = sigma > 1 / 255  # weaker noise is swallowed by the rounding of a flat photo
    assert int(loud.sum()) >= 3
    torch.testing.assert_close(measured[loud], expected[loud], rtol=0.03, atol=0)


def test_weak_noise_is_likelier_than_strong():
    kernels = psfs()[:1].expand(400, 64, 64)
    _, sigma = taken(scene(71, batch=400), kernels, replace(PLAIN, most_noise=0.04))
    assert float(sigma.median()) == pytest.approx(0.04 / 4, rel=0.25)  # the median of u squared
    assert float(sigma.max()) > 0.035


def test_photos_repeat_with_the_seed_and_only_then():
    sharp = scene(127)
    photography = Photography(jpeg=0.5, wrong_gamma=0.5)
    first, second = (taken(sharp, psfs(), photography, seed=5) for _ in range(2))
    assert torch.equal(first[0], second[0])
    assert torch.equal(first[1], second[1])
    other, _ = taken(sharp, psfs(), photography, seed=6)
    assert not torch.equal(first[0], other)


def test_photos_of_any_setting_stay_within_full_scale():
    photos, _ = taken(
        scene(127),
        psfs(),
        Photography(most_noise=0.3, gains=(2.0, 2.0), jpeg=1.0, wrong_gamma=1.0),
    )
    assert photos.isfinite().all()
    assert 0 <= float(photos.min()) <= float(photos.max()) <= 1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"borders": "black"}, '^borders: must be "real" or "symmetric", got \'black\'$'),
        ({"most_noise": -0.1}, "^most_noise: must lie within 0..1, got -0.1$"),
        ({"most_noise": 1.0}, "^most_noise"),
        ({"most_noise": float("nan")}, "^most_noise"),
    ],
)
def test_bad_settings(options, said):
    with pytest.raises(ValueError, match=said):
        Photography(**options)
