"""Weights files: the averaged network to half precision, what a file says of itself, and files
that are none."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from motdiff.network.config import NetworkConfig
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.sampling import sample_paths
from motdiff.training import weight_files as module
from motdiff.training.batches import Batch
from motdiff.training.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from motdiff.training.config import DataConfig, OptimiserConfig, TrainingConfig, read_config
from motdiff.training.trainer import Trainer
from motdiff.training.weight_files import export_weights, load_start
from motdiff.weights import DEFAULT_WEIGHTS, load_network, read_network_card

CONFIGS = Path(module.__file__).parents[1] / "configs"
TINY = NetworkConfig(
    backbone="none",
    physics_channels=2,
    physics_width=8,
    physics_depth=1,
    physics_patch=2,
    denoiser_width=8,
    decoder_widths=(8, 4),
    dwell=True,
    time_width=16,
)


class Noise:
    def batch(self, step, size, *, rank=0):
        draw = torch.Generator().manual_seed(step)
        x0 = (torch.rand(size, 1, 256, 256, generator=draw) > 0.98).float()
        return Batch(None, torch.randn(size, 2, 64, 64, generator=draw), x0, x0)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A network after two steps, and its checkpoint."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    optimiser = OptimiserConfig(steps=2, batch=2, window=8, ema=0.5)
    trainer = Trainer(
        TrainingConfig(DataConfig(photos="photos"), network=TINY, optimiser=optimiser)
    )
    for _ in range(2):
        trainer.update(Noise())
    folder = tmp_path_factory.mktemp("run") / "checkpoint"
    trainer.save(folder)
    torch.set_num_threads(threads)
    return trainer, folder


@pytest.fixture
def exported(trained, tmp_path):
    file = tmp_path / "weights.safetensors"
    export_weights(trained[1], file, card={"mnc": 0.91, "photos": ["a", "b"]})
    return file


def rewritten(file, *, header=(), change=lambda tensors: tensors):
    tensors = change(load_file(file))
    with safe_open(str(file), framework="pt") as opened:
        kept = opened.metadata()
    file.unlink()
    save_file(
        tensors,
        file,
        {name: text for name, text in (kept | dict(header)).items() if text is not None},
    )


def refused(call, file, said):
    with pytest.raises(ValueError, match=said) as caught:
        call(file)
    message = str(caught.value)
    assert message.startswith(f"{file}: ")
    assert "\n" not in message
    assert len(message) < 600


# ---- there and back


def error_bound(weights):
    """Half a step of 8 bits, a 127th of each filter's largest weight; of others float16's."""
    bound = weights.abs() * 2**-11 + 2**-25
    if weights.ndim > 1:
        largest = weights.abs().amax(dim=tuple(range(1, weights.ndim)), keepdim=True)
        bound = bound + largest / 254
    return bound


def test_the_averaged_weights_come_back_to_the_precision_of_the_file(trained, exported):
    trainer, _ = trained
    network = load_network(exported)
    expected = trainer.average.state_dict()
    found = network.state_dict()
    assert found.keys() == expected.keys()
    for name, tensor in expected.items():
        assert found[name].dtype == tensor.dtype
        if tensor.is_floating_point():
            assert ((found[name] - tensor).abs() <= error_bound(tensor)).all()
        else:
            assert torch.equal(found[name], tensor)
    differ = [
        name
        for name, now in trainer.network.state_dict().items()
        if not torch.equal(now, expected[name])
    ]
    assert differ  # the weights themselves are others


def test_the_loaded_network_draws_what_the_averaged_one_does(trained, exported):
    trainer, _ = trained
    physics = torch.randn(1, 2, 64, 64, generator=torch.Generator().manual_seed(3))
    drawn = []
    for network in (trainer.average, load_network(exported)):
        with torch.no_grad():
            condition = network.condition(None, physics)
            generator = torch.Generator().manual_seed(0)
            drawn.append(
                sample_paths(
                    network,
                    condition,
                    count=1,
                    schedule=trainer.schedule,
                    steps=3,
                    generator=generator,
                )
            )
    torch.testing.assert_close(drawn[0].path, drawn[1].path, atol=2e-2, rtol=0)
    torch.testing.assert_close(drawn[0].dwell, drawn[1].dwell, atol=2e-2, rtol=2e-2)


def test_a_loaded_network_is_ready_to_use(exported):
    network = load_network(exported)
    assert network.config == TINY
    assert not any(module.training for module in network.modules())
    assert not any(parameter.requires_grad for parameter in network.parameters())
    assert {parameter.dtype for parameter in network.parameters()} == {torch.float32}


def test_a_file_says_what_it_is(trained, exported):
    trainer, folder = trained
    found = read_network_card(exported)
    assert found["card"] == {"mnc": 0.91, "photos": ["a", "b"]}
    assert found["config"] == read_checkpoint(folder).config
    assert found["config"]["optimiser"]["window"] == 8
    assert found["run"]["steps"] == 2
    assert found["run"]["seconds"] == pytest.approx(trainer.seconds, abs=0.5)


@pytest.mark.parametrize("dropout", [TINY.dropout, 0.3])  # which has no weights
def test_a_run_of_the_same_network_goes_on_from_all_weights_without_their_offset(
    trained, tmp_path, dropout
):
    file = tmp_path / "w.safetensors"
    export_weights(trained[1], file, offset=1.5)
    optimiser = OptimiserConfig(steps=2, batch=2, start=str(file))
    begun = Trainer(
        replace(trained[0].config, network=replace(TINY, dropout=dropout), optimiser=optimiser)
    )
    expected = trained[0].average.state_dict()
    for network in (begun.network, begun.average):
        for name, tensor in network.state_dict().items():
            if tensor.is_floating_point():
                # the output's bias lost its offset and got it back in float16
                bound = error_bound(expected[name]) + 2**-10
                assert ((tensor - expected[name]).abs() <= bound).all()


def test_weights_remember_all_runs_that_led_to_them(trained, tmp_path):
    first = tmp_path / "first.safetensors"
    second = tmp_path / "second.safetensors"
    export_weights(trained[1], first, validation_mnc=0.6)
    optimiser = replace(trained[0].config.optimiser, start=str(first), batch=3)
    trainer = Trainer(replace(trained[0].config, optimiser=optimiser))
    trainer.update(Noise())
    trainer.save(tmp_path / "checkpoint")
    export_weights(tmp_path / "checkpoint", second, validation_mnc=0.7)
    lines = read_network_card(second)["run"]["history"]
    assert [(line["samples"], line["validation_mnc"]) for line in lines] == [(4, 0.6), (3, 0.7)]
    rewritten(first, header={"history": None})  # as files of before
    assert read_network_card(first)["run"]["history"] == []
    export_weights(tmp_path / "checkpoint", second)
    lines = read_network_card(second)["run"]["history"]
    assert [(line["samples"], line["validation_mnc"]) for line in lines] == [(4, None), (3, None)]


def test_a_photo_encoder_and_a_global_view_can_be_put_on_the_shipped_weights():
    """Until it is trained the network gives the shipped one's logits, less the offset that export
    took from them."""
    shipped = load_network()
    offset = read_network_card(DEFAULT_WEIGHTS)["run"]["offset"]
    larger = MotDiffNetwork(
        replace(read_config(CONFIGS / "cpu_encoder.toml").network, denoiser_view=1)
    ).eval()
    assert larger.photo is not None
    assert larger.denoiser.view is not None
    larger.to(memory_format=torch.channels_last)  # as the loaded one: for the same bits
    load_start(larger, DEFAULT_WEIGHTS)
    draw = torch.Generator().manual_seed(0)
    photo = torch.rand(1, 3, 256, 256, generator=draw)
    physics = torch.randn(1, 8, 64, 64, generator=draw)
    x_t = torch.randn(1, 1, 256, 256, generator=draw)
    t = torch.tensor([300])
    with torch.no_grad():
        assert torch.equal(larger.condition(photo, physics), shipped.condition(None, physics))
        logits = larger(x_t, t, photo, physics)
        expected = shipped(x_t, t, None, physics)
    assert torch.equal(logits[:, 1:], expected[:, 1:])
    torch.testing.assert_close(logits[:, :1] - offset, expected[:, :1], atol=1e-5, rtol=1e-5)


def test_a_start_of_other_sizes_is_refused(exported):
    for other in (
        replace(TINY, physics_width=16),
        replace(TINY, backbone="b0", physics_channels=0),
    ):
        network = MotDiffNetwork(other)
        before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
        refused(
            lambda file, network=network: load_start(network, file),
            exported,
            "condition network has other sizes",
        )
        assert all(
            torch.equal(tensor, before[name]) for name, tensor in network.state_dict().items()
        )


def test_a_card_may_be_left_out(trained, tmp_path):
    size = export_weights(trained[1], tmp_path / "w.safetensors")
    assert read_network_card(tmp_path / "w.safetensors")["card"] == {}
    assert size == (tmp_path / "w.safetensors").stat().st_size


def test_the_file_holds_a_quarter_of_the_bytes_and_nothing_of_adam(trained, exported):
    state = trained[0].average.state_dict()
    stored = load_file(exported)
    assert {name.removesuffix(".step") for name in stored} == state.keys()
    for name, tensor in state.items():
        filters = tensor.is_floating_point() and tensor.ndim > 1
        assert (stored[name].dtype == torch.int8) == filters
    whole = sum(tensor.nbytes for tensor in state.values())
    assert sum(tensor.nbytes for tensor in stored.values()) < 0.35 * whole


def test_the_same_run_gives_the_same_bytes(trained, tmp_path):
    for name in ("a", "b"):
        export_weights(trained[1], tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


# ---- what can go wrong


def test_a_run_without_checkpoint_is_refused(tmp_path):
    with pytest.raises(ValueError, match="holds no checkpoint"):
        export_weights(tmp_path / "checkpoint", tmp_path / "w.safetensors")
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_file_is_replaced_whole_or_not_at_all(trained, tmp_path, monkeypatch):
    file = tmp_path / "w.safetensors"
    file.write_bytes(b"earlier")
    with monkeypatch.context() as patch:
        patch.setattr(
            module,
            "save",
            lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")),
        )
        with pytest.raises(OSError, match="No space"):
            export_weights(trained[1], file)
    assert file.read_bytes() == b"earlier"
    seen = []
    with monkeypatch.context() as patch:
        patch.setattr(
            "pathlib.Path.replace",
            lambda *paths: seen.append([path.read_bytes() for path in paths]),
        )
        export_weights(trained[1], file)
    ((whole, still),) = seen  # written under another name first
    assert still == b"earlier"
    export_weights(trained[1], file)
    assert file.read_bytes() == whole


def test_weights_beyond_half_precision_are_refused(tmp_path):
    checkpoint = Checkpoint(1, {"ema.a": torch.tensor([1.0, 7e4]), "ema.b": torch.ones(2)}, {})
    write_checkpoint(tmp_path / "checkpoint", checkpoint)
    with pytest.raises(ValueError, match=r"checkpoint: a holds values that float16 cannot"):
        export_weights(tmp_path / "checkpoint", tmp_path / "w.safetensors")
    assert not (tmp_path / "w.safetensors").exists()


@pytest.mark.parametrize("shape", [(1, 2, 1), (3, 5), ()])
def test_steps_that_would_broadcast_are_refused(exported, shape):
    name = next(name for name in load_file(exported) if name.endswith(".step"))
    rewritten(exported, change=lambda tensors: {**tensors, name: torch.ones(shape)})
    refused(load_network, exported, "needs a step for each output")


def test_steps_of_steps_are_refused(exported):
    name = next(name for name in load_file(exported) if name.endswith(".step"))
    rewritten(exported, change=lambda tensors: {**tensors, f"{name}.step": torch.ones(1)})
    refused(load_network, exported, "its tensors do not fit")


@pytest.mark.parametrize("call", [load_network, read_network_card])
def test_what_are_no_weights_is_refused_in_one_line(tmp_path, call):
    refused(call, tmp_path / "none.safetensors", "cannot be read as weights")
    refused(call, tmp_path, "is a folder")
    file = tmp_path / "w.safetensors"
    for data in (b"", b"not weights at all", b"\x10\0\0\0\0\0\0\0{}"):
        file.write_bytes(data)
        refused(call, file, "cannot be read as weights")
    save_file({"weight": torch.zeros(2)}, tmp_path / "foreign.safetensors", {"format": "pt"})
    refused(
        call,
        tmp_path / "foreign.safetensors",
        r"is no motdiff\.weights/1 file, its schema is None",
    )
    save_file({"weight": torch.zeros(2)}, tmp_path / "plain.safetensors")
    refused(call, tmp_path / "plain.safetensors", "its schema is None")


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ({"schema": "motdiff.weights/9"}, r"its schema is 'motdiff\.weights/9'"),
        ({"config": None}, "its header is not whole"),
        ({"config": "{"}, "its header is not whole"),
        ({"config": "[" * 100_000}, "its header is not whole"),
        ({"schema": "x" * 100_000}, "its schema is 'xxx"),
        ({"step": "many"}, "its header is not whole"),
    ],
)
@pytest.mark.parametrize("call", [load_network, read_network_card])
def test_half_a_header_is_refused(exported, header, said, call):
    rewritten(exported, header=header)
    refused(call, exported, said)


@pytest.mark.parametrize("network", [{"layers": 3}, {"backbone": "b9"}, None, 3])
def test_a_header_of_no_network_we_know_is_refused(exported, network):
    rewritten(exported, header={"config": json.dumps({"network": network})})
    refused(load_network, exported, "its header describes no network")


@pytest.mark.parametrize(
    "change",
    [
        lambda tensors: {
            name: tensor for name, tensor in tensors.items() if name != "denoiser.mid.bias"
        },
        lambda tensors: tensors | {"extra": torch.zeros(1)},
        lambda tensors: {name: tensor[None] for name, tensor in tensors.items()},
    ],
)
def test_tensors_of_another_network_are_refused(exported, change):
    rewritten(exported, change=change)
    refused(load_network, exported, "its tensors do not fit")


def test_a_header_too_large_is_refused_before_it_is_parsed(tmp_path):
    path = tmp_path / "w.safetensors"
    with path.open("wb") as stream:
        stream.write((2**40).to_bytes(8, "little") + b"{")
        stream.truncate(2**40 + 8)  # sparse
    with pytest.raises(
        ValueError,
        match=r"w\.safetensors: cannot be read as weights: its header has more than 16 MiB",
    ):
        read_network_card(path)
