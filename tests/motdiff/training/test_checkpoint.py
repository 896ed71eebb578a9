"""Checkpoints: exact, and never lost, wherever a write stops."""

import pytest
import torch
from safetensors.torch import load_file, save_file

from motdiff.training.checkpoint import Checkpoint, read_checkpoint, write_checkpoint


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


def test_a_checkpoint_comes_back_exactly(tmp_path):
    file = tmp_path / "deep" / "run" / "checkpoint"
    write_checkpoint(file, state())
    assert_same(read_checkpoint(file), state())


def test_a_later_one_takes_the_earlier_ones_place(tmp_path):
    file = tmp_path / "checkpoint"
    write_checkpoint(file, state(3, count=30))
    write_checkpoint(file, state(4, seed=1))
    assert_same(read_checkpoint(file), state(4, seed=1))
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint"]


def test_there_may_be_none(tmp_path):
    assert read_checkpoint(tmp_path / "checkpoint") is None
    assert read_checkpoint(tmp_path / "no" / "such" / "folder") is None


def test_the_old_one_survives_a_write_that_fails(tmp_path, monkeypatch):
    file = tmp_path / "checkpoint"
    write_checkpoint(file, state(3))

    def full(*_arguments):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("motdiff.files.outputs.os.fsync", full)
        with pytest.raises(OSError, match="No space"):
            write_checkpoint(file, state(4, seed=1))
    assert_same(read_checkpoint(file), state(3))
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint"]


# ---- what is no checkpoint


def test_a_file_that_is_no_whole_checkpoint_is_refused(tmp_path):
    file = tmp_path / "checkpoint"
    write_checkpoint(file, state())
    data = file.read_bytes()
    tensors = load_file(file)
    file.write_bytes(data[:-9])
    refused(file, "cannot be read as weights")
    file.write_bytes(data.replace(b"motdiff.checkpoint/2", b"motdiff.checkpoint/9"))
    refused(file, "is no motdiff.checkpoint/2 file")
    for header in ("[]", '{"step": 1}', "{"):
        save_file(tensors, file, {"motdiff.checkpoint/2": header})
        refused(file, "whole")


def test_a_folder_is_refused(tmp_path):
    """As runs of earlier versions have them, whose log must not be written over."""
    (tmp_path / "checkpoint").mkdir()
    refused(tmp_path / "checkpoint", "is a folder")


def refused(file, said):
    with pytest.raises(ValueError, match=said) as caught:
        read_checkpoint(file)
    message = str(caught.value)
    assert message.startswith(f"{file}: ")
    assert "\n" not in message
