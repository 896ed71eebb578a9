"""Samples: a photo of a motion, and the motion laid on the kernel found in it."""

from functools import partial

import numpy as np
import pytest
import torch
from torch.nn import functional

from motdiff.blind_search.coarse_to_fine import Start
from motdiff.blind_search.grids import shifted
from motdiff.network.condition import PHOTO_PX
from motdiff.network.physics_maps import quick_kernels
from motdiff.training import samples as samples_module
from motdiff.training.motion_bank import MotionMix, build_bank
from motdiff.training.photos import crops
from motdiff.training.samples import Samples, registration, simulate
from motdiff.training.simulation import Photography, blurred
from motdiff.trajectory import Trajectory

PLAIN = Photography(most_noise=0.0, gammas=(1.0, 1.0), wrong_gamma=0.0, gains=(1.0, 1.0), jpeg=0.0)


@pytest.fixture(autouse=True, scope="module")
def small_search():
    """Small frames instead of the three of the training: what is proved here does not depend on
    the kernels' worth."""
    threads = torch.get_num_threads()
    with pytest.MonkeyPatch.context() as patch:
        starts = (Start(9, 1.0), Start(15, 3.0))
        patch.setattr(
            samples_module, "quick_kernels", partial(quick_kernels, starts=starts, iterations=1)
        )
        torch.set_num_threads(1)
        yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def bank():
    return build_bank(MotionMix(max_length_px=30), count=6, seed=0)


@pytest.fixture(scope="module")
def scenes():
    """Blocks of random colours, two photos of different shapes."""
    generator = torch.Generator().manual_seed(0)
    photos = [
        torch.randint(0, 256, (3, rows, columns), generator=generator)
        for rows, columns in ((34, 40), (42, 33))
    ]
    return [
        photo.repeat_interleave(10, 1).repeat_interleave(10, 2).to(torch.uint8) for photo in photos
    ]


# ---- shifts


def test_shifts_move_down_and_right_and_lose_what_leaves():
    maps = torch.arange(1.0, 13).view(1, 1, 3, 4).repeat(4, 2, 1, 1)
    maps[:, 1] += 100
    moved = shifted(maps, torch.tensor([[0, 0], [1, -2], [-2, 1], [3, 0]]))
    assert torch.equal(moved[0], maps[0])
    assert moved[1, 0].tolist() == [[0, 0, 0, 0], [3, 4, 0, 0], [7, 8, 0, 0]]
    assert moved[2, 0].tolist() == [[0, 9, 10, 11], [0, 0, 0, 0], [0, 0, 0, 0]]
    assert moved[2, 1].tolist() == [[0, 109, 110, 111], [0, 0, 0, 0], [0, 0, 0, 0]]
    assert not moved[3].any()


def test_shifts_keep_the_kind_of_numbers():
    maps = torch.ones(1, 1, 4, 4, dtype=torch.uint8)
    moved = shifted(maps, torch.tensor([[1, 1]]))
    assert moved.dtype == torch.uint8
    assert int(moved.sum()) == 9


# ---- registration


@pytest.mark.parametrize("shift", [(0, 0), (2, -3), (-5, 4), (8, -8)])
def test_registration_recovers_the_kernels_shift(bank, shift):
    psfs, x0, dwell = bank.targets(torch.arange(6))
    kernels = psfs.roll(shift, (1, 2))[:, None]
    move = registration(kernels, dwell)
    assert move.dtype == torch.int64
    expected = 4 * torch.tensor(shift).expand(6, 2)
    assert int((move - expected).abs().max()) <= 1
    # and the moved map draws where the kernel lies
    centre = [_centroid(functional.avg_pool2d(shifted(dwell, move), 4)), _centroid(kernels)]
    torch.testing.assert_close(*centre, atol=0.4, rtol=0)
    assert int(shifted(x0, move).sum()) == int(x0.sum())


def _centroid(maps):
    lag = torch.arange(64.0) - 32
    weight = maps[:, 0] / maps[:, 0].sum(dim=(1, 2), keepdim=True)
    return torch.stack([weight.sum(dim=2) @ lag, weight.sum(dim=1) @ lag], dim=1)


def test_registration_follows_the_most_alike_kernel(bank):
    psfs, _, dwell = bank.targets(torch.arange(6))
    lost = psfs.roll(1, 0).roll((-6, -6), (1, 2))
    kernels = torch.stack([lost, psfs.roll((3, 1), (1, 2)), lost], dim=1)
    assert int((registration(kernels, dwell) - torch.tensor([12, 4])).abs().max()) <= 1


def test_registration_leaves_the_motion_where_every_kernel_is_lost():
    upright = Trajectory.straight(30.0, angle_rad=np.pi / 2)
    dwell = torch.from_numpy(upright.hr_map()).float()[None, None]
    level = torch.from_numpy(Trajectory.straight(30.0).psf(64)).float()[None, None]
    for lost in (
        level,
        level.roll((5, 5), (2, 3)),
        torch.zeros_like(level),
        torch.full_like(level, 1 / 4096),
    ):
        assert registration(lost, dwell).tolist() == [[0, 0]]


def test_registration_does_not_depend_on_the_kernels_scale(bank):
    psfs, _, dwell = bank.targets(torch.arange(6))
    kernels = psfs.roll((2, 2), (1, 2))[:, None]
    assert torch.equal(registration(1000 * kernels, dwell), registration(kernels, dwell))


# ---- simulation


def taken(bank, scenes, index, *, physics=False, seed=7, photography=PLAIN):
    return simulate(
        bank, scenes, torch.tensor(index), photography=photography, physics=physics, seed=seed
    )


@pytest.mark.parametrize("borders", ["real", "symmetric"])
def test_samples_without_physics_are_photos_with_their_targets(bank, scenes, borders):
    samples = taken(bank, scenes, [4, 1], photography=Photography(borders=borders))
    _, x0, dwell = bank.targets(torch.tensor([4, 1]))
    assert len(samples) == 2
    assert samples.photos.shape == (2, 3, PHOTO_PX, PHOTO_PX)
    assert samples.photos.dtype == torch.float32
    assert samples.kernels.shape == (2, 0, 64, 64)
    assert torch.equal(samples.x0, x0)
    assert torch.equal(samples.dwell, dwell)


def test_plain_samples_are_crops_blurred_by_their_motions(bank, scenes):
    samples = taken(bank, scenes, [0, 3, 5])
    sharp = crops(scenes, count=3, size=PHOTO_PX + 63, generator=torch.Generator().manual_seed(7))
    expected = blurred(sharp, bank.targets(torch.tensor([0, 3, 5]))[0][:, None])
    assert float((samples.photos - expected).abs().max()) < 0.51 / 255


def test_samples_repeat_with_the_seed_and_only_then(bank, scenes):
    options = {"photography": Photography()}
    first, again = (taken(bank, scenes, [0, 1], **options) for _ in range(2))
    assert torch.equal(first.photos, again.photos)
    assert not torch.equal(first.photos, taken(bank, scenes, [0, 1], seed=8, **options).photos)


def test_physics_finds_kernels_and_lays_the_motion_on_them(bank, scenes):
    plain, found = (taken(bank, scenes, [2], physics=physics) for physics in (False, True))
    assert torch.equal(found.photos, plain.photos)
    assert found.kernels.shape == (1, 2, 64, 64)
    torch.testing.assert_close(found.kernels.sum(dim=(2, 3)), torch.ones(1, 2))
    move = registration(found.kernels, plain.dwell)
    assert torch.equal(found.x0, shifted(plain.x0, move))
    assert torch.equal(found.dwell, shifted(plain.dwell, move))


def test_samples_count_their_photos():
    assert len(Samples(torch.zeros(4, 1), torch.zeros(0), torch.zeros(0), torch.zeros(0))) == 4
