"""Prepared samples: written once, whole or not at all, and read back as they were."""

from functools import partial

import numpy as np
import pytest
import torch

from motdiff.blind_search.coarse_to_fine import Start
from motdiff.network.physics_maps import quick_kernels
from motdiff.training import prepared
from motdiff.training import samples as samples_module
from motdiff.training.motion_bank import MotionMix, bank_of, drawn_motions
from motdiff.training.prepared import Source, prepare, read_shards
from motdiff.training.samples import simulate
from motdiff.training.simulation import Photography

MIX = MotionMix(max_length_px=25)
PHOTOGRAPHY = Photography()
NAMES = ("photos", "kernels", "x0", "dwell")


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
def scenes():
    blocks = torch.randint(0, 256, (3, 34, 34), generator=torch.Generator().manual_seed(0))
    return [blocks.repeat_interleave(10, 1).repeat_interleave(10, 2).to(torch.uint8)]


def write(folder, scenes, shards, **options):
    prepare(folder, Source(scenes, MIX, PHOTOGRAPHY, 5), shards=shards, **options)


@pytest.fixture(scope="module")
def complete(tmp_path_factory, scenes):
    """Two shards of two samples each, never to be changed."""
    folder = tmp_path_factory.mktemp("prepared") / "deep" / "complete"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prepared, "SHARD_SAMPLES", 2)
        write(folder, scenes, range(2))
    return folder


@pytest.fixture
def small_shards(monkeypatch):
    monkeypatch.setattr(prepared, "SHARD_SAMPLES", 2)


def copied(folder, target, names):
    target.mkdir()
    for name in names:
        (target / name).write_bytes((folder / name).read_bytes())
    return target


def test_shards_are_files_by_number_and_nothing_else_is_left(complete):
    assert sorted(path.name for path in complete.iterdir()) == [
        "shard_00000.npz",
        "shard_00001.npz",
    ]


def test_reading_gives_the_simulated_samples_back(complete, scenes):
    stored = read_shards(complete)
    assert len(stored) == 4
    bank = bank_of(drawn_motions(MIX, seed=5, indices=range(2, 4)))
    again = simulate(
        bank,
        scenes,
        torch.arange(2),
        photography=PHOTOGRAPHY,
        physics=True,
        seed=5 * 1_000_003 + 1,
    )  # the second shard
    assert stored.photos.dtype == stored.x0.dtype == torch.uint8
    assert stored.photos.shape == (4, 1, 256, 256)
    light = (stored.photos[2:] / 255).square()
    grey = again.photos.mean(dim=1, keepdim=True)
    assert float((light.sqrt() - grey.sqrt()).abs().max()) < 0.51 / 255
    assert stored.kernels.dtype == stored.dwell.dtype == torch.float16
    torch.testing.assert_close(stored.kernels[2:].float(), again.kernels, rtol=1e-3, atol=1e-6)
    assert torch.equal(stored.x0[2:].float(), again.x0)
    torch.testing.assert_close(stored.dwell[2:].float(), again.dwell, rtol=1e-3, atol=1e-6)


def test_the_missing_shard_alone_is_written_as_by_a_fresh_run(
    complete, tmp_path, scenes, small_shards
):
    folder = copied(complete, tmp_path / "half", ["shard_00000.npz"])
    first = folder / "shard_00000.npz"
    first.write_bytes(b"as it was")
    told = []
    write(folder, scenes, range(2), on_shard=told.append)
    assert told == [0, 1]
    assert first.read_bytes() == b"as it was"
    assert sorted(path.name for path in folder.iterdir()) == ["shard_00000.npz", "shard_00001.npz"]
    with (
        np.load(folder / "shard_00001.npz") as mine,
        np.load(complete / "shard_00001.npz") as fresh,
    ):
        assert sorted(mine) == sorted(fresh) == sorted(NAMES)
        for name in NAMES:
            np.testing.assert_array_equal(mine[name], fresh[name])


def test_an_interrupted_write_leaves_nothing(
    complete, tmp_path, scenes, small_shards, monkeypatch
):
    folder = copied(complete, tmp_path / "torn", ["shard_00000.npz"])

    def interrupted(file, **arrays):
        file.write_bytes(b"half an arch")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(prepared, "simulate", lambda *_, **__: read_as_simulated(complete))
        patch.setattr(np, "savez", interrupted)
        with pytest.raises(KeyboardInterrupt):
            write(folder, scenes, range(1, 2))
    assert [item.name for item in folder.iterdir()] == ["shard_00000.npz"]


def read_as_simulated(folder):
    stored = read_shards(folder)
    return type(stored)(*(getattr(stored, name)[:2].float() for name in NAMES))


def test_shards_are_read_in_the_order_of_their_numbers(complete, tmp_path):
    folder = copied(complete, tmp_path / "swapped", ["shard_00000.npz", "shard_00001.npz"])
    (folder / "shard_00000.npz").rename(folder / "shard_00007.npz")
    whole = read_shards(complete)
    other = read_shards(folder)
    for name in NAMES:
        torch.testing.assert_close(
            getattr(other, name), getattr(whole, name).roll(2, 0), rtol=0, atol=0
        )


def test_a_folder_without_shards_is_refused(tmp_path):
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(ValueError, match=f"^{folder}: holds no prepared samples"):
            read_shards(folder)
