"""Files of weights: 8 bits and a step for each output, whole headers, networks that fit."""

import json

import pytest
import torch
from safetensors.torch import save_file

from motdiff.weights_io import (
    filled,
    halved,
    packed,
    read_card,
    read_header,
    read_tensors,
    write_with_card,
)

SCHEMA = "test.network/1"


@pytest.fixture
def network():
    torch.manual_seed(5)
    network = torch.nn.Sequential(torch.nn.Conv2d(3, 4, 3), torch.nn.BatchNorm2d(4))
    with torch.no_grad():
        # outputs of very different size: one step for all would lose the small ones
        network[0].weight *= torch.tensor([1e-3, 1.0, 50.0, 0.0])[:, None, None, None]
    return network.eval()


@pytest.fixture
def file(network, tmp_path):
    path = tmp_path / "weights.safetensors"
    size = write_with_card(
        packed(network.state_dict(), source="run"), path, schema=SCHEMA, card={"steps": 12}
    )
    assert path.stat().st_size == size
    return path


def test_a_packed_weight_is_within_half_a_step_of_its_output(network, file):
    weights = network[0].weight.detach()
    largest = weights.abs().amax(dim=(1, 2, 3), keepdim=True)
    stored = read_tensors(file)["0.weight"]
    assert stored.dtype == torch.float32
    assert torch.all((stored - weights).abs() <= largest / 127 * 0.501)
    # the largest of each output is exact
    torch.testing.assert_close(stored.abs().amax(dim=(1, 2, 3), keepdim=True), largest)


def test_biases_and_counts_are_not_packed(network, file):
    tensors = read_tensors(file)
    assert set(tensors) == set(network.state_dict())
    torch.testing.assert_close(
        tensors["0.bias"], network[0].bias.detach(), rtol=2**-11, atol=2**-25
    )
    assert tensors["1.num_batches_tracked"].dtype == torch.int64
    state = halved(network.state_dict(), source="run")
    assert {name: t.dtype for name, t in state.items() if not t.is_floating_point()} == {
        "1.num_batches_tracked": torch.int64
    }
    assert state["0.weight"].dtype == torch.float16


@pytest.mark.parametrize("value", [65_600.0, float("inf"), float("nan")])
def test_what_float16_cannot_hold_is_refused(value):
    state = {"fine": torch.ones(2), "scale": torch.tensor([1.0, value])}
    with pytest.raises(ValueError, match="run 7: scale holds values that float16 cannot"):
        packed(state, source="run 7")


def test_a_card_is_read_by_its_schema(file):
    assert read_card(file, SCHEMA) == {"steps": 12}
    assert json.loads(read_header(file)[SCHEMA]) == {"steps": 12}
    with pytest.raises(ValueError, match=rf"is no other/1 file, its header has {SCHEMA}"):
        read_card(file, "other/1")


def test_a_file_without_a_card_and_one_that_is_not_whole_are_refused(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_file({"a": torch.ones(2)}, path)
    with pytest.raises(ValueError, match="its header has nothing"):
        read_card(path, SCHEMA)
    save_file({"a": torch.ones(2)}, path, {SCHEMA: '{"steps": 1'})
    with pytest.raises(ValueError, match="its header is not whole"):
        read_card(path, SCHEMA)
    path.write_bytes((2**40).to_bytes(8, "little") + b"{}")
    with pytest.raises(ValueError, match="its header has more than"):
        read_header(path)


def test_a_network_is_filled_ready_to_use(network, file):
    twin = torch.nn.Sequential(torch.nn.Conv2d(3, 4, 3), torch.nn.BatchNorm2d(4)).train()
    twin = filled(twin, file, schema=SCHEMA)
    assert not twin.training
    assert not any(parameter.requires_grad for parameter in twin.parameters())
    photo = torch.ones(1, 3, 8, 8)
    torch.testing.assert_close(twin(photo), network(photo), rtol=0.02, atol=0.5)
    with pytest.raises(ValueError, match="is no other/1 file"):
        filled(twin, file, schema="other/1")
    with pytest.raises(ValueError, match="do not fit the network"):
        filled(torch.nn.Linear(3, 4), file)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (2,), ()])
def test_steps_are_one_for_each_output(tmp_path, shape):
    path = tmp_path / "weights.safetensors"
    weights = torch.ones(2, 3, dtype=torch.int8)
    save_file({"a": weights, "a.step": torch.full((2, 1), 0.5)}, path)
    assert read_tensors(path)["a"].tolist() == [[0.5] * 3] * 2
    save_file({"a": weights, "a.step": torch.full(shape, 0.5)}, path)
    with pytest.raises(ValueError, match="a needs a step for each output"):
        read_tensors(path)


def test_a_tensor_may_be_named_as_a_step(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_file({"time.step": torch.tensor([3.0])}, path)
    assert read_tensors(path)["time.step"].tolist() == [3.0]
