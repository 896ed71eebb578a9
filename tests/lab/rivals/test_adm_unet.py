"""The U-Net of guided-diffusion: its blocks by their formulas, and the names of its parameters."""

import math

import pytest
import torch
from torch.nn import functional

from lab.rivals.adm_unet import AdmConfig, AdmUNet

SMALL = {"size": 32, "channels": 1, "width": 32, "multipliers": (1, 2), "attention": (16,)}


def small_network():
    torch.manual_seed(0)
    network = AdmUNet(AdmConfig(**SMALL)).double().eval()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    return network


def test_the_checkpoints_of_the_authors_fit():
    """Names and shapes at places that tell the rules apart: resizing blocks, heads, skips, learned
    variance."""
    with torch.device("meta"):
        state = AdmUNet(
            AdmConfig(size=256, channels=3, width=128, multipliers=(1, 1, 2, 2, 4, 4))
        ).state_dict()
    expected = {
        "time_embed.2.weight": (512, 512),
        "input_blocks.0.0.weight": (128, 3, 3, 3),
        "input_blocks.2.0.in_layers.2.weight": (128, 128, 3, 3),  # halves the side
        "input_blocks.5.0.skip_connection.weight": (256, 128, 1, 1),
        "input_blocks.9.1.qkv.weight": (1536, 512, 1),  # 16 px
        "input_blocks.11.0.emb_layers.1.weight": (1024, 512),
        "middle_block.1.proj_out.weight": (512, 512, 1),
        "output_blocks.0.0.in_layers.0.weight": (1024,),
        "output_blocks.1.1.out_layers.3.weight": (512, 512, 3, 3),  # doubles the side
        "output_blocks.3.2.out_layers.3.weight": (512, 512, 3, 3),  # after the attention
        "out.2.weight": (6, 128, 3, 3),
    }
    assert {name: tuple(state[name].shape) for name in expected} == expected
    assert "input_blocks.11.1.qkv.weight" not in state
    assert max(int(name.split(".")[1]) for name in state if name.startswith("input_blocks")) == 11
    assert max(int(name.split(".")[1]) for name in state if name.startswith("output_blocks")) == 11


def test_the_attention_is_its_formula():
    attention = small_network().middle_block[1]
    x = torch.randn(1, 64, 3, 5, dtype=torch.float64)
    query, key, value = attention.qkv(
        functional.group_norm(x.flatten(2), 32, attention.norm.weight, attention.norm.bias)
    )[0].chunk(3)
    weights = torch.softmax(query.T @ key / math.sqrt(64), dim=1)  # (N, N), a row for each query
    mixed = (weights @ value.T).T[None]
    torch.testing.assert_close(attention(x), x + attention.proj_out(mixed).reshape(x.shape))


def test_each_head_has_its_own_query_key_and_value_side_by_side():
    """In these weights the channels of a head lie together; one head's are those of a network with
    that head alone."""
    from lab.rivals.adm_unet import _Attention

    torch.manual_seed(1)
    both = _Attention(128).double()
    alone = _Attention(64).double()
    with torch.no_grad():
        both.qkv.weight.zero_()
        both.qkv.weight[192:, 64:] = alone.qkv.weight
        both.qkv.bias[192:] = alone.qkv.bias
        both.proj_out.weight.zero_()
        both.proj_out.weight[64:, 64:] = alone.proj_out.weight
        both.proj_out.bias[64:] = alone.proj_out.bias
    x = torch.randn(1, 64, 4, 4, dtype=torch.float64)
    pair = torch.cat([torch.zeros_like(x), x], dim=1)
    both.norm = alone.norm = torch.nn.Identity()
    torch.testing.assert_close(both(pair)[:, 64:], alone(x))


def test_a_residual_block_is_its_formula():
    block = small_network().input_blocks[2][0]  # halves the side
    x = torch.randn(1, 32, 8, 8, dtype=torch.float64)
    time = torch.randn(1, 128, dtype=torch.float64)
    first = block.in_layers[0]
    conv = block.in_layers[2]
    hidden = functional.silu(functional.group_norm(x, 32, first.weight, first.bias))
    hidden = conv(hidden.unfold(2, 2, 2).unfold(3, 2, 2).mean(dim=(-1, -2)))
    scale, shift = (
        block.emb_layers[1].weight @ functional.silu(time[0]) + block.emb_layers[1].bias
    ).chunk(2)
    norm = block.out_layers[0]
    hidden = functional.group_norm(hidden, 32, norm.weight, norm.bias) * (1 + scale[:, None, None])
    hidden = block.out_layers[3](functional.silu(hidden + shift[:, None, None]))
    pooled = x.unfold(2, 2, 2).unfold(3, 2, 2).mean(dim=(-1, -2))
    torch.testing.assert_close(block(x, time), pooled + hidden)


def test_the_output_has_the_size_of_the_input_and_depends_on_the_timestep():
    network = small_network()
    x = torch.randn(2, 1, 32, 32, dtype=torch.float64)
    with torch.no_grad():
        early, late = (network.float()(x.float(), torch.tensor([t, t])) for t in (10, 900))
    assert early.shape == (2, 2, 32, 32)
    assert (early - late).abs().max() > 1e-3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"size": 33}, "multipliers: must be 1..8 levels that halve 33 px"),
        ({"size": 2048}, "size: must be a whole number within 1..1024, got 2048"),
        ({"size": True}, "size: must be a whole number"),
        ({"channels": 2}, "channels: must be 1 or 3, got 2"),
        ({"width": 48}, "width: must be a multiple of 32"),
        ({"multipliers": (1, 1)}, "width: levels with attention must be a multiple of 64 wide"),
        ({"multipliers": (1, 1000)}, "width: must be a multiple of 32, with levels up to 4096"),
        ({"multipliers": ()}, "multipliers: must be 1..8 levels"),
        ({"attention": 16}, "attention: must be whole numbers"),
        ({"blocks": 0}, "blocks: must be a whole number within 1..8, got 0"),
    ],
)
def test_other_sizes_are_refused(changes, words):
    with pytest.raises(ValueError, match=f"^{words}"):
        AdmConfig(**{**SMALL, **changes})
