"""Training of the correction: samples, loss, weights and command line."""

import itertools
import re

import numpy as np
import pytest
import torch

from cep.files.images import write_image
from lab.trainings.correction import samples as samples_module
from lab.trainings.correction.__main__ import run
from lab.trainings.correction.samples import (
    LEAST_ALIKE,
    Kernels,
    alike,
    described,
    prepare,
    read_samples,
    searched,
)
from lab.trainings.correction.training import CorrectionTrainer, Settings, corrected_mnc, train
from motdiff.blind_search.coarse_to_fine import Start
from motdiff.metrics import mnc
from motdiff.network.correction import MAPS, CorrectionNetwork
from motdiff.training.motion_bank import MotionMix
from motdiff.training.prepared import Source
from motdiff.training.simulation import Photography
from motdiff.weights import CORRECTION_SCHEMA, load_correction
from motdiff.weights_io import read_card

MIX = MotionMix(max_length_px=25)


def path_kernel(seed):
    """Kernel of a random walk."""
    rng = np.random.default_rng(seed)
    kernel = np.zeros((64, 64))
    for down, right in np.cumsum(rng.integers(-1, 2, (25, 2)), axis=0):
        kernel[32 + down, 32 + right] += 1
    return torch.from_numpy(kernel / kernel.sum()).float()


@pytest.fixture(scope="module")
def kernels():
    """Kernels with a tail that is not theirs, which one map lacks, in maps that otherwise hold
    noise."""
    truth = torch.stack([path_kernel(seed) for seed in range(6)])
    maps = 0.1 * torch.randn(6, MAPS, 64, 64, generator=torch.Generator().manual_seed(0))
    maps[:, 0] = truth / truth.amax(dim=(1, 2), keepdim=True)
    maps[:, 3] = maps[:, 0]
    maps[:, 0, 10, 20:50] = 0.5
    return Kernels(maps.half(), truth.half())


# ---- samples


@pytest.fixture(scope="module")
def source():
    blocks = torch.randint(0, 256, (3, 34, 34), generator=torch.Generator().manual_seed(0))
    scene = blocks.repeat_interleave(10, 1).repeat_interleave(10, 2).to(torch.uint8)
    return Source([scene], MIX, Photography(), 5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, source):
    """Two shards of three photos each, searched in two small frames."""
    folder = tmp_path_factory.mktemp("kernels")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(samples_module, "SHARD_PHOTOS", 3)
        patch.setattr(samples_module, "SEARCHES", (Start(29), Start(35)))
        prepare(folder / "both", source, shards=range(2))
        prepare(folder / "second", source, shards=range(1, 2))
    return folder


@pytest.fixture(scope="module")
def samples(folder):
    return read_samples(folder / "both")


def test_described_kernels_are_those_that_are_not_lost_with_the_truth_laid_on_them(samples):
    kernels = described(samples)
    assert 4 <= len(kernels) <= 12
    assert kernels.maps.shape == (len(kernels), MAPS, 64, 64)
    assert kernels.truth.shape == (len(kernels), 64, 64)
    torch.testing.assert_close(
        kernels.maps[:, 0].amax(dim=(1, 2)).float(), torch.ones(len(kernels))
    )
    likeness = alike(kernels.maps[:, 0].float(), kernels.truth.float())
    assert likeness.min() >= LEAST_ALIKE - 1e-3
    assert likeness.mean() > 0.7
    free = [
        mnc(m[0].float().numpy(), t.float().numpy())
        for m, t in zip(kernels.maps, kernels.truth, strict=True)
    ]
    np.testing.assert_allclose(likeness, free, atol=0.02)  # no other shift is better


def test_a_shard_depends_on_its_number_and_the_seed_alone(folder):
    one, other = (folder / name / "searched_00001.npz" for name in ("both", "second"))
    assert one.read_bytes() == other.read_bytes()


def test_photos_are_searched_alike_in_any_order(samples):
    photos = (samples.photos[:3, 0, :128, :128].float() / 255).square()
    starts = (Start(15),)
    forwards, backwards = (searched(stack, searches=starts) for stack in (photos, photos.flip(0)))
    assert forwards.shape == (3, 1, 64, 64)
    torch.testing.assert_close(forwards.sum(dim=(2, 3)), torch.ones(3, 1))
    torch.testing.assert_close(forwards, backwards.flip(0), atol=1e-3, rtol=0)


def test_samples_of_the_second_pass_are_those_of_the_corrected_kernels(samples):
    class Lessened(CorrectionNetwork):
        def forward(self, maps):
            return maps[:, 0] - 0.3

    first, second = (described(samples, network=net) for net in (None, Lessened().eval()))
    lessened = (first.maps[:, 0].float() - 0.3).clamp(min=0)
    expected = lessened / lessened.amax(dim=(1, 2), keepdim=True)
    # what was hardly alike may be lost by the change
    nearest = [
        (second.maps[:, 0].float() - kernel).abs().amax(dim=(1, 2)).min() for kernel in expected
    ]
    assert sum(float(distance) < 0.03 for distance in nearest) >= len(first) - 1


def test_folders_without_whole_shards_are_refused(folder, tmp_path):
    with pytest.raises(ValueError, match=re.escape("holds no searched_*.npz")):
        read_samples(tmp_path)
    whole = (folder / "both" / "searched_00000.npz").read_bytes()
    (tmp_path / "searched_00000.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"searched_00000\.npz: is damaged"):
        read_samples(tmp_path)


@pytest.mark.parametrize(("down", "right"), [(0, 0), (2, -1), (-2, 2)])
def test_kernels_are_compared_over_small_shifts(down, right):
    kernel = path_kernel(0)[None]
    found = alike(3 * kernel.roll((down, right), (1, 2)), kernel)
    torch.testing.assert_close(found, torch.ones(1))


def test_the_likeness_is_the_mnc():
    one = path_kernel(1)
    other = path_kernel(1) + 0.02 * path_kernel(2).roll(3, 0)
    assert float(alike(one[None], other[None])) == pytest.approx(
        mnc(one.numpy(), other.numpy()), abs=1e-5
    )


# ---- training


def test_training_removes_a_tail_that_no_kernel_has(kernels):
    trainer = CorrectionTrainer(Settings(steps=200, batch=4, rate=5e-3))
    losses = [trainer.update(kernels) for _ in range(60)]
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:3])


def test_a_run_writes_as_it_goes_and_its_average_at_the_end(samples, tmp_path):
    target = tmp_path / "c.safetensors"
    lines = []
    settings = Settings(steps=5, batch=2)
    times = itertools.count(0.0, 10.0)
    train(
        samples,
        target,
        settings=settings,
        save_s=25.0,
        clock=lambda: next(times),
        report=lines.append,
    )
    assert len(lines) == 2
    card = read_card(target, CORRECTION_SCHEMA)
    assert card["steps"] == 5
    assert card["seconds"] == 50
    assert card["settings"] == {"steps": 5, "batch": 2, "rate": 1.5e-3, "seed": 0}
    trainer = CorrectionTrainer(settings)
    first = described(samples)
    passes = [first]
    for _ in range(5):
        if trainer.step == 2:  # 0.4 of the steps
            passes.append(described(samples, network=trainer.average))
        trainer.update(*passes)
    for name, value in load_correction(target).state_dict().items():
        torch.testing.assert_close(trainer.average.state_dict()[name], value, atol=2e-3, rtol=2e-3)


def test_a_network_that_changes_nothing_gains_nothing(samples):
    before, once, twice = corrected_mnc(samples, CorrectionNetwork().eval())
    assert 0.5 < before < 1.0
    # light below 2 % of the peak is dropped
    assert (once, twice) == pytest.approx((before, before), abs=5e-3)


def test_the_commands_prepare_train_and_evaluate(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(samples_module, "SHARD_PHOTOS", 1)
    monkeypatch.setattr(samples_module, "SEARCHES", (Start(15), Start(21)))
    monkeypatch.setattr(samples_module, "LEAST_ALIKE", 0.0)
    photos = tmp_path / "photos"
    photos.mkdir()
    for name in "ab":
        write_image(
            photos / f"{name}.png",
            np.kron(np.random.default_rng(0).random((33, 33, 3)), np.ones((10, 10, 1))),
        )
    config = tmp_path / "run.toml"
    config.write_text(
        f'[data]\nphotos = "{photos}"\nheld_out = 2\n[motions]\nmax_length_px = 12\n',
        encoding="utf-8",
    )
    folder = tmp_path / "kernels"
    target = tmp_path / "c.safetensors"
    assert run(["prepare", str(config), "-o", str(folder), "--shards", "0:1"]) == 0
    assert run(["train", str(folder), "-o", str(target), "--steps", "1", "--batch", "2"]) == 0
    assert read_card(target, CORRECTION_SCHEMA)["steps"] == 1
    assert run(["evaluate", str(folder), "--weights", str(target)]) == 0
    assert re.fullmatch(
        r"1 photos: MNC [\d.]+, corrected [\d.]+, twice [\d.]+\n", capsys.readouterr().out
    )


# ---- bad input


def test_bad_input_gives_one_line(tmp_path, capsys):
    for command in (
        ["train", str(tmp_path / "nowhere"), "-o", str(tmp_path / "c.safetensors")],
        ["evaluate", str(tmp_path)],
        ["evaluate", str(tmp_path), "--device", "tpu"],
        ["prepare", str(tmp_path / "no.toml"), "-o", str(tmp_path / "kernels")],
    ):
        assert run(command) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="steps: must be at least 1, got 0"):
        Settings(steps=0)
