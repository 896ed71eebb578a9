"""Checkpoints: exact, in small parts, and never lost, wherever a write stops."""

import json
import os

import pytest
import torch
from safetensors.torch import save_file

from motdiff.training import checkpoint as module
from motdiff.training.checkpoint import PART_BYTES, Checkpoint, read_checkpoint, write_checkpoint


def state(step=3, *, seed=0, count=6):
    draw = torch.Generator().manual_seed(seed)
    tensors = {
        f"model.layer{i}.weight": torch.randn(4, 3, 5, 5, generator=draw) for i in range(count)
    }
    tensors["model.conv.weight"] = torch.randn(4, 6, 3, 3, generator=draw).to(
        memory_format=torch.channels_last
    )
    tensors["model.norm.count"] = torch.tensor(2**40 + step)
    tensors["ema.half"] = torch.randn(7, generator=draw).half()
    return Checkpoint(
        step,
        tensors,
        {"data": {"photos": "p"}, "motions": {"exposure_s": [0.1, 0.5]}},
        seconds=12.25,
    )


def assert_same(found, expected):
    assert found is not None
    assert (found.step, found.seconds, found.config) == (
        expected.step,
        expected.seconds,
        expected.config,
    )
    assert found.tensors.keys() == expected.tensors.keys()
    for name, tensor in expected.tensors.items():
        assert found.tensors[name].dtype == tensor.dtype
        assert torch.equal(found.tensors[name], tensor), name


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_checkpoint_comes_back_exactly(tmp_path):
    folder = tmp_path / "deep" / "run" / "checkpoint"
    write_checkpoint(folder, state())
    assert_same(read_checkpoint(folder), state())
    assert names(folder) == ["index.json", "part_000.safetensors"]


def test_a_later_one_takes_the_earlier_ones_place(tmp_path):
    folder = tmp_path / "checkpoint"
    write_checkpoint(folder, state(3, count=30))
    write_checkpoint(folder, state(4, seed=1))
    assert_same(read_checkpoint(folder), state(4, seed=1))
    assert names(tmp_path) == ["checkpoint"]


def test_there_may_be_none(tmp_path):
    assert read_checkpoint(tmp_path / "checkpoint") is None
    assert read_checkpoint(tmp_path / "no" / "such" / "folder") is None


@pytest.mark.parametrize("limit", [1500, 3000, 6000])
def test_no_part_is_larger_than_the_limit(tmp_path, monkeypatch, limit):
    monkeypatch.setattr(module, "PART_BYTES", limit)
    write_checkpoint(tmp_path / "checkpoint", state())
    parts = sorted((tmp_path / "checkpoint").glob("part_*.safetensors"))
    assert len(parts) > 1
    assert all(part.stat().st_size <= limit for part in parts)
    assert_same(read_checkpoint(tmp_path / "checkpoint"), state())


def test_many_small_tensors_leave_room_for_their_names(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "PART_BYTES", 20_000)
    tensors = {
        f"adam.exp_avg_sq.backbone.stages.2.blocks.{i}.norm1.bias": torch.zeros(1, 1, 1, 2)
        for i in range(500)
    }
    write_checkpoint(tmp_path / "c", Checkpoint(1, tensors, {}))
    assert max(part.stat().st_size for part in (tmp_path / "c").glob("part_*")) <= 20_000


def test_a_tensor_above_the_limit_has_a_part_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "PART_BYTES", 1000)
    write_checkpoint(tmp_path / "c", state(count=3))
    assert_same(read_checkpoint(tmp_path / "c"), state(count=3))


def test_the_limit_is_15_mebibytes():
    assert PART_BYTES == 15 * 2**20


# ---- writes that stop midway


@pytest.fixture
def fails_at(monkeypatch):
    """A full disk at the write of a part, or at a rename, counted from 0."""

    def arm(name, count):
        real = {"save_file": save_file, "rename": os.rename}[name]
        calls = iter(range(1000))

        def failing(*arguments):
            if next(calls) == count:
                raise OSError(28, "No space left on device")
            return real(*arguments)

        monkeypatch.setattr(module if name == "save_file" else module.os, name, failing)

    return arm


@pytest.mark.parametrize("part", [0, 2])
def test_the_old_one_survives_a_write_that_fails(tmp_path, monkeypatch, fails_at, part):
    folder = tmp_path / "checkpoint"
    monkeypatch.setattr(module, "PART_BYTES", 2000)
    write_checkpoint(folder, state(3))
    fails_at("save_file", part)
    with pytest.raises(OSError, match="No space"):
        write_checkpoint(folder, state(4, seed=1))
    assert_same(read_checkpoint(folder), state(3))
    monkeypatch.setattr(module, "save_file", save_file)
    write_checkpoint(folder, state(5, seed=2))
    assert_same(read_checkpoint(folder), state(5, seed=2))
    assert names(tmp_path) == ["checkpoint"]


def stopped_between_the_renames(folder, fails_at, monkeypatch):
    rename = os.rename
    write_checkpoint(folder, state(3))
    fails_at("rename", 1)
    with pytest.raises(OSError, match="No space"):
        write_checkpoint(folder, state(4, seed=1))
    monkeypatch.setattr(module.os, "rename", rename)
    assert not folder.exists()


def test_a_kill_between_the_renames_leaves_the_old_one(tmp_path, fails_at, monkeypatch):
    folder = tmp_path / "checkpoint"
    stopped_between_the_renames(folder, fails_at, monkeypatch)
    assert_same(read_checkpoint(folder), state(3))
    write_checkpoint(folder, state(5, seed=2))
    assert_same(read_checkpoint(folder), state(5, seed=2))
    assert names(tmp_path) == ["checkpoint"]


def test_a_second_stop_after_one_between_the_renames_loses_nothing(
    tmp_path, fails_at, monkeypatch
):
    folder = tmp_path / "checkpoint"
    stopped_between_the_renames(folder, fails_at, monkeypatch)
    fails_at("save_file", 0)
    with pytest.raises(OSError, match="No space"):
        write_checkpoint(folder, state(5, seed=2))
    assert_same(read_checkpoint(folder), state(3))


# ---- what is no checkpoint


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda folder, index: index | {"schema": "motdiff.checkpoint/9"}, "motdiff.checkpoint/9"),
        (
            lambda folder, index: {name: index[name] for name in index if name != "schema"},
            "schema",
        ),
        (lambda folder, index: {name: index[name] for name in index if name != "step"}, "step"),
        (lambda folder, index: [index], "list"),
        (lambda folder, index: index | {"files": ["part_007.safetensors"]}, "part_007"),
    ],
)
def test_another_schema_or_half_an_index_is_refused(tmp_path, change, said):
    folder = tmp_path / "checkpoint"
    write_checkpoint(folder, state())
    index = folder / "index.json"
    index.write_text(json.dumps(change(folder, json.loads(index.read_text()))))
    refused(folder, said)


def test_a_broken_index_or_part_is_refused(tmp_path):
    folder = tmp_path / "checkpoint"
    write_checkpoint(folder, state())
    part = folder / "part_000.safetensors"
    part.write_bytes(part.read_bytes()[:-9])
    refused(folder, "is no whole")
    (folder / "index.json").write_text('{"schema": ')
    refused(folder, "is no whole")


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "mother.txt").write_text("dear mother")
    refused(tmp_path / "letters", "index.json")


def refused(folder, said):
    with pytest.raises(ValueError, match="checkpoint") as caught:
        read_checkpoint(folder)
    message = str(caught.value)
    assert message.startswith(f"{folder}: is no whole motdiff.checkpoint/1 checkpoint")
    assert said in message
    assert "\n" not in message
