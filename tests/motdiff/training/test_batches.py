"""Batches: reproducible from seed, step and rank; every sample once an epoch; maps that turn
together."""

from functools import partial

import pytest
import torch
from torch.nn import functional

from motdiff.blind_search.coarse_to_fine import Start
from motdiff.blind_search.grids import mirrored
from motdiff.network.physics_maps import display_photo, physics_maps, quick_kernels
from motdiff.network.sampling import psfs_of_maps
from motdiff.training import batches
from motdiff.training import samples as samples_module
from motdiff.training.batches import Batch, LiveSource, PreparedSource, seed_of
from motdiff.training.motion_bank import MotionMix, build_bank
from motdiff.training.samples import Samples, simulate
from motdiff.training.simulation import Photography

PLAIN = Photography(most_noise=0.0, gammas=(1.0, 1.0), wrong_gamma=0.0, gains=(1.0, 1.0), jpeg=0.0)


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def prepared():
    """Seven samples as `read_shards` gives them, each with a path of its own."""
    draw = torch.Generator().manual_seed(0)
    bank = build_bank(MotionMix(max_length_px=20), count=7, seed=0)
    _, x0, dwell = bank.targets(torch.arange(7))
    photos = torch.randint(0, 256, (7, 1, 256, 256), generator=draw).to(torch.uint8)
    kernels = torch.rand(7, 3, 64, 64, generator=draw).half()
    return Samples(photos, kernels, x0.to(torch.uint8), dwell.half())


def shuffled(samples, *, photo=False, physics=True, seed=3, symmetries=True):
    return PreparedSource(samples, photo=photo, physics=physics, seed=seed, symmetries=symmetries)


def tensors(batch):
    return [
        maps for maps in (batch.photo, batch.physics, batch.x0, batch.dwell) if maps is not None
    ]


def same(a, b):
    return all(torch.equal(x, y) for x, y in zip(tensors(a), tensors(b), strict=True))


def origins(batch, samples):
    """Which sample each of a batch is, and how it was turned."""
    found = []
    for x0 in batch.x0:
        matches = [
            (i, s)
            for i in range(len(samples.x0))
            for s in range(8)
            if torch.equal(mirrored(samples.x0[i : i + 1].float(), s, pitch=4)[0], x0)
        ]
        found.append(matches[0])
    return found


# ---- seeds


def test_seeds_tell_numbers_and_their_order_apart():
    seeds = {
        seed_of(*numbers)
        for numbers in [(0,), (1,), (-1,), (0, 0), (0, 1), (1, 0), (2**62,), (0, 0, 0), (3, 4)]
    }
    assert len(seeds) == 9
    assert all(0 <= seed < 2**62 for seed in seeds)
    assert seed_of(5, 3, 0, 1) == seed_of(5, 3, 0, 1)


def test_neighbouring_steps_have_unrelated_seeds():
    seeds = torch.tensor([seed_of(1, step, 0) for step in range(4000)])
    bits = (seeds[:, None] >> torch.arange(62)) & 1
    assert (bits.float().mean(dim=0) - 0.5).abs().max() < 4.5 * 0.5 / 4000**0.5
    flips = (bits[1:] != bits[:-1]).float().mean()
    assert flips == pytest.approx(0.5, abs=0.01)


# ---- batch


def test_a_batch_is_cut_and_copied_whole():
    batch = Batch(None, torch.randn(5, 2, 64, 64), torch.rand(5, 1, 8, 8), torch.rand(5, 1, 8, 8))
    parts = batch.split(2)
    assert [len(part) for part in parts] == [2, 2, 1]
    assert all(part.photo is None for part in parts)
    for name in ("physics", "x0", "dwell"):
        assert torch.equal(
            torch.cat([getattr(part, name) for part in parts]), getattr(batch, name)
        )
    moved = batch.to("meta")
    assert {maps.device.type for maps in tensors(moved)} == {"meta"}
    assert batch.to("cpu").x0 is batch.x0


# ---- prepared samples


def test_every_epoch_has_every_sample_once_in_another_order(prepared):
    source = shuffled(prepared)
    seen = [index for step in range(14) for index, _ in origins(source.batch(step, 1), prepared)]
    assert sorted(seen[:7]) == sorted(seen[7:]) == list(range(7))
    assert seen[:7] != seen[7:]


@pytest.mark.parametrize("size", [3, 16])
def test_a_batch_may_reach_into_the_next_epoch(prepared, size):
    whole = shuffled(prepared, symmetries=False)
    alone = [origins(whole.batch(i, 1), prepared)[0] for i in range(3 * size)]
    for step in range(3):
        assert origins(whole.batch(step, size), prepared) == alone[step * size : (step + 1) * size]


def test_prepared_batches_follow_from_seed_step_and_rank(prepared):
    def batch(step=2, *, seed=3, rank=0):
        return shuffled(prepared, photo=True, seed=seed).batch(step, 4, rank=rank)

    assert same(batch(), batch())
    assert not any(same(batch(), other) for other in (batch(1), batch(rank=1), batch(seed=4)))


def test_orders_and_turns_have_seeds_of_their_own(prepared, monkeypatch):
    """Seven samples: epochs begin at steps 0, 3.5 and 7."""
    drawn = set()
    monkeypatch.setattr(batches, "seed_of", lambda *numbers: drawn.add(numbers) or 1)
    source = shuffled(prepared)
    for step in range(10):
        source.batch(step, 2)
    steps = {numbers for numbers in drawn if numbers[1] >= 0}
    assert len(steps) == 10
    assert len(drawn - steps) == 3


def test_samples_are_turned_all_eight_ways(prepared):
    source = shuffled(prepared)
    turns = [turn for step in range(8) for _, turn in origins(source.batch(step, 7), prepared)]
    assert set(turns) == set(range(8))
    still = shuffled(prepared, symmetries=False)
    assert {turn for _, turn in origins(still.batch(0, 7), prepared)} == {0}


def test_a_turned_sample_is_the_sample_of_the_turned_photo(prepared):
    batch = shuffled(prepared, photo=True, seed=5).batch(0, 7)
    for position, (index, turn) in enumerate(origins(batch, prepared)):
        one = slice(index, index + 1)
        light = prepared.photos[one].float().div(255).square()
        seen = display_photo(mirrored(light, turn, pitch=0))
        assert torch.equal(batch.photo[position : position + 1], seen)
        expected = physics_maps(
            mirrored(light, turn, pitch=0), mirrored(prepared.kernels[one].float(), turn, pitch=1)
        )
        inner = (
            ...,
            slice(1, None),
            slice(1, None),
        )  # the grid has lags of -32, but none of 32 to mirror them with
        torch.testing.assert_close(
            batch.physics[position : position + 1][inner], expected[inner], atol=5e-3, rtol=0
        )
        dwell = mirrored(prepared.dwell[one].float(), turn, pitch=4)
        assert torch.equal(batch.dwell[position : position + 1], dwell)


def likeness(photo, psf):
    """Greatest normalised correlation of a photo (256, 256) with a PSF (64, 64), over all
    shifts."""
    spectra = (torch.fft.rfft2(maps, s=(320, 320)) for maps in (photo, psf))
    first, second = spectra
    return (
        torch.fft.irfft2(first * second.conj(), s=(320, 320)).max() / (photo.norm() * psf.norm())
    ).item()


def test_a_turned_photo_is_blurred_by_the_turned_path():
    """The photo of a bright square shows the PSF itself."""
    scene = torch.zeros(3, 319, 319, dtype=torch.uint8)
    scene[:, 158:161, 158:161] = 255
    bank = build_bank(MotionMix(max_length_px=40), count=1, seed=2)
    taken = simulate(bank, [scene], torch.tensor([0]), photography=PLAIN, physics=False, seed=0)
    stored = (255 * taken.photos.mean(dim=1, keepdim=True).sqrt()).round().to(torch.uint8)
    source = shuffled(
        Samples(stored, taken.kernels, taken.x0.byte(), taken.dwell.half()),
        photo=True,
        physics=False,
    )
    seen = set()
    for step in range(40):
        batch = source.batch(step, 1)
        photo = batch.photo[0, 0] ** 2.2
        psfs = functional.avg_pool2d(psfs_of_maps(batch.dwell), 3, 1, 1)
        likes = [likeness(photo, mirrored(psfs, s, pitch=1)[0, 0]) for s in range(8)]
        assert likes[0] > 0.99 > max(likes[1:]) + 0.02
        seen.add(origins(batch, taken)[0][1])
    assert seen == set(range(8))


def test_a_prepared_batch_holds_what_the_network_takes(prepared):
    for photo, physics in [(True, False), (False, True), (True, True)]:
        batch = shuffled(prepared, photo=photo, physics=physics).batch(0, 3)
        assert (batch.photo is not None, batch.physics is not None) == (photo, physics)
        if photo:
            assert batch.photo.shape == (3, 3, 256, 256)


# ---- live samples


@pytest.fixture(scope="module")
def bank():
    return build_bank(MotionMix(max_length_px=20), count=2, seed=0)


@pytest.fixture(scope="module")
def scenes():
    """A black photo and a white one."""
    return [
        torch.zeros(3, 330, 330, dtype=torch.uint8),
        torch.full((3, 330, 330), 255, dtype=torch.uint8),
    ]


def test_live_batches_follow_from_seed_step_and_rank(bank, scenes):
    noisy = Photography(most_noise=0.1)

    def batch(step=2, *, seed=3, rank=0):
        source = LiveSource(bank, scenes, noisy, photo=True, physics=False, seed=seed)
        return source.batch(step, 2, rank=rank)

    assert same(batch(), batch())
    assert not any(same(batch(), other) for other in (batch(1), batch(rank=1), batch(seed=4)))


def test_each_motion_meets_each_scene(bank, scenes):
    """One stream of random numbers for motions and scenes would join each motion to one scene for
    ever."""
    source = LiveSource(bank, scenes, PLAIN, photo=True, physics=False, seed=0)
    batch = source.batch(0, 24)
    bright = batch.photo.mean(dim=(1, 2, 3)) > 0.5
    first = (batch.x0 == bank.targets(torch.tensor([0]))[1]).flatten(1).all(dim=1)
    pairs = set(zip(first.tolist(), bright.tolist(), strict=True))
    assert pairs == {(False, False), (False, True), (True, False), (True, True)}


def test_a_live_batch_holds_what_the_network_takes(bank, scenes, monkeypatch):
    starts = (Start(9, 1.0), Start(11, 1.0), Start(13, 1.0))
    monkeypatch.setattr(
        samples_module, "quick_kernels", partial(quick_kernels, starts=starts, iterations=1)
    )
    draw = torch.Generator().manual_seed(0)
    blocks = torch.randint(0, 256, (3, 33, 33), generator=draw).to(torch.uint8)
    textured = [blocks.repeat_interleave(10, 1).repeat_interleave(10, 2)]
    for photo, physics in [(True, False), (False, True), (True, True)]:
        batch = LiveSource(
            bank, textured, Photography(), photo=photo, physics=physics, seed=0
        ).batch(0, 2)
        assert (batch.photo is not None, batch.physics is not None) == (photo, physics)
        if photo:
            assert batch.photo.shape == (2, 3, 256, 256)
            assert 0 <= batch.photo.min() < batch.photo.max() <= 1
        if physics:
            assert batch.physics.shape == (2, 2 + 2 * 3, 64, 64)
            assert batch.physics.isfinite().all()
        assert batch.x0.shape == batch.dwell.shape == (2, 1, 256, 256)
        assert ((batch.dwell > 0) <= (batch.x0 > 0)).all()
