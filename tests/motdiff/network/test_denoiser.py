"""The MoTDiff network: its shapes and sizes, the published backbone it must equal, and who depends
on what."""

import json
import math
import re
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from motdiff.network.condition import (
    LocalEmphasis,
    PhotoEncoder,
    PyramidVisionTransformer,
    StepwiseAggregation,
)
from motdiff.network.config import NetworkConfig
from motdiff.network.denoiser import Denoiser, MotDiffNetwork, timestep_embedding
from motdiff.network.unet import GridUNet

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def seeded():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        yield
    torch.set_num_threads(threads)


def count(module):
    return sum(parameter.numel() for parameter in module.parameters())


def inputs(config, batch=2, side=64):
    if config.physics_channels:
        side = 256
    return {
        "x_t": torch.randn(batch, 1, side, side),
        "t": torch.arange(batch) * 500 + 3,
        "photo": None if config.backbone == "none" else torch.rand(batch, 3, side, side),
        "physics": (
            torch.randn(batch, config.physics_channels, 64, 64)
            if config.physics_channels
            else None
        ),
    }


# -- backbone -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("variant", "channels"), [("b0", (32, 64, 160, 256)), ("b2", (64, 128, 320, 512))]
)
def test_backbone_gives_four_scales(variant, channels):
    backbone = PyramidVisionTransformer(variant).eval()
    with torch.no_grad():
        features = backbone(torch.randn(2, 3, 64, 96))
    sizes = zip(channels, (4, 8, 16, 32), strict=True)
    assert [tuple(feature.shape) for feature in features] == [
        (2, c, 64 // s, 96 // s) for c, s in sizes
    ]
    assert backbone.channels == channels


@pytest.mark.parametrize(
    ("variant", "millions"),
    # published counts with the 1000-class head (whai362/PVT), less that head, and b0..b2 as
    # measured without it
    [
        ("b0", 3.41),
        ("b1", 13.5),
        ("b2", 24.85),
        ("b3", 45.2 - 0.513),
        ("b4", 62.6 - 0.513),
        ("b5", 82.0 - 0.513),
    ],
)
def test_backbone_has_the_published_number_of_parameters(variant, millions):
    with torch.device("meta"):
        backbone = PyramidVisionTransformer(variant)
    assert count(backbone) / 1e6 == pytest.approx(millions, abs=0.06 if variant > "b2" else 0.005)


def test_backbone_parameters_have_timms_names():
    state = PyramidVisionTransformer("b0").state_dict()
    assert {name: tuple(state[name].shape) for name in TIMM} == TIMM
    assert not [
        name
        for name in state
        if name.startswith(("stages.0.downsample", "stages.3.blocks.0.attn.sr"))
    ]
    kinds = {re.sub(r"\d+", "#", name) for name in state}
    assert kinds == {re.sub(r"\d+", "#", name) for name in TIMM} | {
        re.sub(r"\d+", "#", name.replace("weight", "bias")) for name in TIMM
    }


TIMM = {  # read in timm/models/pvt_v2.py; shapes of pvt_v2_b0
    "patch_embed.proj.weight": (32, 3, 7, 7),
    "patch_embed.norm.weight": (32,),
    "stages.0.blocks.0.norm1.weight": (32,),
    "stages.0.blocks.0.attn.q.weight": (32, 32),
    "stages.0.blocks.0.attn.kv.weight": (64, 32),
    "stages.0.blocks.0.attn.proj.weight": (32, 32),
    "stages.0.blocks.0.attn.sr.weight": (32, 32, 8, 8),
    "stages.0.blocks.0.attn.norm.weight": (32,),
    "stages.0.blocks.1.norm2.weight": (32,),
    "stages.0.blocks.1.mlp.fc1.weight": (256, 32),
    "stages.0.blocks.1.mlp.dwconv.weight": (256, 1, 3, 3),
    "stages.0.blocks.1.mlp.fc2.weight": (32, 256),
    "stages.0.norm.weight": (32,),
    "stages.1.downsample.proj.weight": (64, 32, 3, 3),
    "stages.1.downsample.norm.weight": (64,),
    "stages.3.blocks.1.mlp.fc1.weight": (1024, 256),
    "stages.3.norm.bias": (256,),
}


def to_transformers(state):
    """Our (timm's) names and joint keys and values as transformers' PvtV2 has them."""
    rules = [
        (r"^patch_embed\.", "stages.0.downsample."),
        (r"^stages\.(\d)\.downsample\.norm", r"encoder.layers.\1.patch_embedding.layer_norm"),
        (r"^stages\.(\d)\.downsample", r"encoder.layers.\1.patch_embedding"),
        (r"^stages\.(\d)\.norm", r"encoder.layers.\1.layer_norm"),
        (r"^stages\.(\d)\.", r"encoder.layers.\1."),
        (r"\.norm([12])\.", r".layer_norm_\1."),
        (r"\.attn\.q\.", ".attention.query."),
        (r"\.attn\.sr\.", ".attention.spatial_reduction."),
        (r"\.attn\.norm\.", ".attention.layer_norm."),
        (r"\.attn\.", ".attention."),
        (r"\.mlp\.fc", ".mlp.dense"),
        (r"\.mlp\.dwconv\.", ".mlp.dwconv.dwconv."),
    ]
    renamed = {}
    for name, value in state.items():
        for pattern, replacement in rules:
            name = re.sub(pattern, replacement, name)
        if ".attention.kv." in name:
            renamed[name.replace(".kv.", ".key.")], renamed[name.replace(".kv.", ".value.")] = (
                value.chunk(2)
            )
        else:
            renamed[name] = value
    return renamed


def test_backbone_equals_transformers():
    """In double precision to rounding, with every parameter random, so that no layer can be left
    out."""
    oracle_module = pytest.importorskip("transformers.models.pvt_v2.modeling_pvt_v2")
    configuration = pytest.importorskip("transformers").PvtV2Config(
        hidden_sizes=[32, 64, 160, 256],
        depths=[2, 2, 2, 2],
        num_attention_heads=[1, 2, 5, 8],
        sr_ratios=[8, 4, 2, 1],
        mlp_ratios=[8, 8, 4, 4],
        drop_path_rate=0.0,
        layer_norm_eps=1e-6,
    )
    ours = PyramidVisionTransformer("b0").double().eval()
    oracle = oracle_module.PvtV2Model(configuration).double().eval()
    with torch.no_grad():
        for parameter in ours.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
        for name, module in oracle.named_modules():
            if isinstance(module, torch.nn.LayerNorm) and (
                "patch_embedding" in name or "attention" in name
            ):
                # as whai362/PVT and timm, where the weights come from; transformers has 1e-6 there
                module.eps = 1e-5
        oracle.load_state_dict(to_transformers(ours.state_dict()))
        photo = torch.randn(2, 3, 64, 96, dtype=torch.float64)
        expected = oracle(photo, output_hidden_states=True).hidden_states
        features = ours(photo)
    for feature, other in zip(features, expected, strict=True):
        torch.testing.assert_close(feature, other, rtol=1e-9, atol=1e-9)


# -- aggregation ----------------------------------------------------------------------------------


def test_local_emphasis_keeps_a_constant_where_the_border_does_not_reach():
    emphasis = LocalEmphasis(3, 5)
    up = emphasis(torch.full((1, 3, 16, 16), 0.7), (64, 64))
    assert up.shape == (1, 5, 64, 64)
    assert up.min() >= 0
    inner = up[
        :, :, 16:48, 16:48
    ]  # zero padding reaches 2 feature pixels, 8 here, and upsampling one more
    torch.testing.assert_close(inner, inner[:, :, :1, :1].expand_as(inner))


def test_aggregation_goes_from_coarse_to_fine():
    """Widths of one, so that equation 4 can be done by hand: z_s = relu(a_s z_{s+1} + b_s f_s)."""
    aggregation = StepwiseAggregation(4, 1)
    weights = {1: (1.0, 10.0), 2: (2.0, -1.0), 3: (3.0, 1.0)}
    with torch.no_grad():
        for s, pair in weights.items():
            aggregation.joins[s - 1].weight.copy_(torch.tensor(pair).view(1, 2, 1, 1))
            aggregation.joins[s - 1].bias.zero_()
    f1, f2, f3, f4 = (torch.full((1, 1, 2, 2), value) for value in (0.5, 4.0, 1.0, 2.0))
    # z3 = 3*2 + 1 = 7; z2 = 2*7 - 4 = 10; z1 = 10 + 5 = 15
    torch.testing.assert_close(aggregation([f1, f2, f3, f4]), torch.full((1, 1, 2, 2), 15.0))
    # z2 = relu(2*7 - 100) = 0
    torch.testing.assert_close(aggregation([f1, 25 * f2, f3, f4]), torch.full((1, 1, 2, 2), 5.0))


def test_one_scale_needs_no_aggregation():
    feature = torch.randn(1, 4, 2, 2)
    assert torch.equal(StepwiseAggregation(1, 4)([feature]), feature)


# -- physics maps ---------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [1, 3])
def test_physics_encoder_keeps_the_grid_and_knows_the_place(depth):
    encoder = GridUNet(2, 16, depth).eval()
    with torch.no_grad():
        features = encoder(torch.zeros(1, 2, 64, 64))
        assert features.shape == (1, 16, 64, 64)
        inner = features[:, :, 24:40, 24:40]
        assert inner.std(dim=(2, 3)).min() > 1e-3  # equal maps, other places, other features


def test_physics_encoder_is_cheap():
    with torch.device("meta"), FlopCounterMode(display=False) as counter:
        GridUNet(8, 48, 3)(torch.zeros(1, 8, 64, 64))
    assert counter.get_total_flops() / 2 < 1e9


def test_every_place_reaches_every_other_through_attention():
    encoder = GridUNet(1, 16, 3).eval()
    maps = torch.zeros(1, 1, 64, 64, requires_grad=True)
    encoder(maps)[0, :, 0, 0].square().sum().backward()
    assert maps.grad.abs().min() > 0


def test_physics_maps_of_another_shape_are_refused():
    with pytest.raises(
        ValueError, match=r"^maps has shape \(1, 2, 32, 32\); it must be \(B, 2, 64, 64\)"
    ):
        GridUNet(2, 16, 1)(torch.zeros(1, 2, 32, 32))


# -- denoiser -------------------------------------------------------------------------------------


SMALL = NetworkConfig(denoiser_width=16)


def test_timestep_embedding_is_made_of_phases():
    waves = timestep_embedding(torch.arange(1000), 128)
    torch.testing.assert_close(waves[0], torch.cat([torch.ones(64), torch.zeros(64)]))
    torch.testing.assert_close(
        waves[:, :64].square() + waves[:, 64:].square(), torch.ones(1000, 64)
    )
    assert waves[7, 64].item() == pytest.approx(math.sin(7), abs=1e-5)
    assert waves[7, 127].item() == pytest.approx(math.sin(7 * 10_000 ** (-63 / 64)), abs=1e-6)
    assert (
        torch.cdist(waves, waves).fill_diagonal_(1).min() > 0.1
    )  # every timestep is told from every other


@pytest.mark.parametrize("outputs", [1, 2])
def test_denoiser_starts_from_the_paths_share(outputs):
    denoiser = Denoiser(8, replace(SMALL, dwell=outputs == 2))
    x_t = torch.randn(2, 1, 64, 96)
    condition = torch.randn(2, 8, 16, 24)
    logits = denoiser(x_t, torch.tensor([0, 999]), condition)
    assert logits.shape == (2, outputs, 64, 96)
    assert 0.005 < logits[:, 0].sigmoid().mean() < 0.02


def test_no_connection_skips_the_mid_layer():
    denoiser = Denoiser(8, SMALL).eval()
    condition = torch.randn(1, 8, 16, 16)
    t = torch.tensor([10])
    with torch.no_grad():
        first, second = (denoiser(torch.randn(1, 1, 64, 64), t, condition) for _ in range(2))
        assert not torch.allclose(first, second)
        denoiser.mid.weight[:, :16] = 0  # what comes from the encoding block
        first, second = (denoiser(torch.randn(1, 1, 64, 64), t, condition) for _ in range(2))
    assert torch.equal(first, second)


@pytest.mark.parametrize("view", [0, 1])
def test_a_denoiser_with_a_global_view_sees_the_whole_map(view):
    """Without one a change of the noisy map tells on the logits near by; with one, everywhere."""
    denoiser = Denoiser(8, replace(SMALL, denoiser_view=view)).eval()
    if denoiser.view is not None:
        torch.nn.init.normal_(denoiser.view.out[-1].weight)
    x_t = torch.randn(1, 1, 256, 256, requires_grad=True)
    denoiser(x_t, torch.tensor([500]), torch.randn(1, 8, 64, 64))[0, 0, 128, 128].backward()
    rows = x_t.grad[0, 0].any(dim=1).nonzero()
    reach = (128 - int(rows.min()), int(rows.max()) - 128)
    assert reach == (128, 127) if view else max(reach) <= 20


def test_a_global_view_changes_nothing_until_it_is_trained():
    plain = Denoiser(8, SMALL).eval()
    wide = Denoiser(8, replace(SMALL, denoiser_view=2)).eval()
    wide.load_state_dict(wide.state_dict() | plain.state_dict())
    given = torch.randn(1, 1, 256, 256), torch.tensor([500]), torch.randn(1, 8, 64, 64)
    assert torch.equal(wide(*given), plain(*given))


@pytest.mark.parametrize("silenced", ["residual.modulation", "mid_modulation"])
def test_the_timestep_enters_at_two_places(silenced):
    """Each alone makes the output depend on the timestep; without both it does not."""
    denoiser = Denoiser(8, SMALL).eval()
    x_t = torch.randn(1, 1, 64, 64)
    condition = torch.randn(1, 8, 16, 16)

    def at(t):
        with torch.no_grad():
            return denoiser(x_t, torch.tensor([t]), condition)

    torch.nn.init.zeros_(denoiser.get_submodule(silenced).linear.weight)
    assert not torch.equal(at(0), at(500))
    for place in (denoiser.residual.modulation, denoiser.mid_modulation):
        torch.nn.init.zeros_(place.linear.weight)
    assert torch.equal(at(0), at(500))


# -- the whole ------------------------------------------------------------------------------------


WHOLE = {
    "paper": NetworkConfig(),
    "f2": NetworkConfig(features="f2"),
    "f4": NetworkConfig(features="f4"),
    "physics": NetworkConfig(backbone="none", physics_channels=5),
    "both": NetworkConfig(physics_channels=5, width=24, dwell=True),
    "halved": NetworkConfig(physics_channels=5, photo_pool=2),
    "global": NetworkConfig(backbone="none", physics_channels=5, denoiser_view=1),
}
EACH = pytest.mark.parametrize("config", WHOLE.values(), ids=WHOLE.keys())


@EACH
def test_the_condition_serves_many_steps(config):
    """Computed once and used twice it gives what computing all each time gives."""
    network = MotDiffNetwork(config).eval()
    given = inputs(config)
    with torch.no_grad():
        condition = network.condition(given["photo"], given["physics"])
        channels = config.physics_width if config.physics_channels else config.width
        assert condition.shape == (2, channels, *(side // 4 for side in given["x_t"].shape[-2:]))
        for t in (given["t"], given["t"] + 90):
            logits = network.denoiser(given["x_t"], t, condition)
            assert logits.shape == (2, 1 + config.dwell, *given["x_t"].shape[-2:])
            torch.testing.assert_close(logits, network(**{**given, "t": t}))


@EACH
def test_gradients_reach_every_parameter(config):
    network = MotDiffNetwork(config)
    if network.fusion is not None:
        torch.nn.init.normal_(network.fusion.weight)
    if network.denoiser.view is not None:
        torch.nn.init.normal_(network.denoiser.view.out[-1].weight)
    network(**inputs(config, batch=1)).square().mean().backward()
    without = [
        name for name, p in network.named_parameters() if p.grad is None or not p.grad.any()
    ]
    assert without == []


@pytest.mark.parametrize("name", ["both", "halved"])
def test_a_photo_encoder_changes_nothing_until_it_is_trained(name):
    """The condition is at first that of the physics maps, bit for bit; one update of the fusion
    alone lets it speak."""
    network = MotDiffNetwork(WHOLE[name]).eval()
    given = inputs(WHOLE[name])
    with torch.no_grad():
        alone = network.physics(given["physics"])
    condition = network.condition(given["photo"], given["physics"])
    assert torch.equal(condition, alone)
    condition.square().mean().backward()
    assert network.fusion.weight.grad.any()
    with torch.no_grad():
        network.fusion.weight -= network.fusion.weight.grad
        assert not torch.equal(network.condition(given["photo"], given["physics"]), alone)


def test_a_pooled_encoder_sees_means_of_four_pixels():
    encoder = PhotoEncoder(NetworkConfig(photo_pool=2)).eval()
    photo = torch.rand(1, 3, 128, 64)
    means = (
        torch.nn.functional.avg_pool2d(photo, 2).repeat_interleave(2, 2).repeat_interleave(2, 3)
    )
    with torch.no_grad():
        z1 = encoder(photo)
        assert z1.shape == (1, 64, 32, 16)
        torch.testing.assert_close(encoder(means), z1)
    with pytest.raises(ValueError, match=r"multiples of 64"):
        encoder(torch.rand(1, 3, 96, 64))


def test_photos_of_a_batch_do_not_meet():
    config = NetworkConfig()
    network = MotDiffNetwork(config).double().eval()
    given = {
        k: v.double() if v is not None and v.is_floating_point() else v
        for k, v in inputs(config).items()
    }
    with torch.no_grad():
        together = network(**given)
        alone = [
            network(**{k: None if v is None else v[i : i + 1] for k, v in given.items()})
            for i in range(2)
        ]
    torch.testing.assert_close(together, torch.cat(alone))


def test_photo_is_normalised_as_imagenet():
    """A photo of ImageNet's mean colour is zero to the backbone."""
    network = MotDiffNetwork(NetworkConfig()).eval()
    seen = []
    network.photo.backbone.register_forward_pre_hook(lambda module, args: seen.append(args[0]))
    mean = torch.tensor([0.485, 0.456, 0.406])[None, :, None, None].expand(1, 3, 64, 64)
    std = torch.tensor([0.229, 0.224, 0.225])[None, :, None, None]
    with torch.no_grad():
        network.condition(mean, None)
        network.condition(mean + std, None)
    torch.testing.assert_close(seen[0], torch.zeros(1, 3, 64, 64))
    torch.testing.assert_close(seen[1], torch.ones(1, 3, 64, 64))
    assert not [name for name in network.state_dict() if "mean" in name and "running" not in name]


def test_half_precision_autocast_agrees():
    config = NetworkConfig()
    network = MotDiffNetwork(config).eval()
    given = inputs(config)
    with torch.no_grad():
        exact = network(**given)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            coarse = network(**given)
    assert (coarse.float() - exact).abs().max() < 0.1


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((1, 3, 250, 256), r"photo has shape \(1, 3, 250, 256\); .*multiples of 32"),
        ((1, 1, 64, 64), r"photo has shape \(1, 1, 64, 64\); it must be \(B, 3, H, W\)"),
        ((3, 64, 64), r"photo has shape \(3, 64, 64\); it must be \(B, 3, H, W\)"),
    ],
)
def test_photos_of_another_shape_are_named(shape, message):
    with torch.device("meta"):
        network = MotDiffNetwork(WHOLE["paper"])
        photo = torch.zeros(shape)
    with pytest.raises(ValueError, match=f"^{message}"):
        network.condition(photo, None)


# -- configuration --------------------------------------------------------------------------------


def test_config_survives_json():
    config = NetworkConfig(backbone="b2", decoder_widths=(24, 8), physics_channels=3, dwell=True)
    assert NetworkConfig.from_dict(json.loads(json.dumps(asdict(config)))) == config
    with pytest.raises(ValueError, match=r"^values has unknown fields depth, wdith"):
        NetworkConfig.from_dict({"wdith": 64, "depth": 2})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("backbone", "b6"),
        ("features", "f1"),
        ("photo_pool", 3),
        ("width", 0),
        ("width", 64.0),
        ("denoiser_width", 62),
        ("denoiser_view", 3),
        ("decoder_widths", (30, 16)),
        ("decoder_widths", (32,)),
        ("decoder_widths", (32, 0)),
        ("dropout", 1.0),
        ("dropout", float("nan")),
        ("physics_channels", -1),
        ("physics_width", 44),
        ("physics_depth", 0),
        ("dwell", "yes"),
        ("time_width", 127),
    ],
)
def test_config_errors_name_the_field(field, value):
    with pytest.raises(ValueError, match=f"^{field}") as caught:
        NetworkConfig(**{field: value})
    assert "\n" not in str(caught.value)


def test_a_network_needs_some_input():
    with pytest.raises(ValueError, match=r"^physics_channels is 0"):
        NetworkConfig(backbone="none")


def test_the_network_does_without_torchvision():
    code = "import sys, motdiff.network.denoiser; sys.exit('torchvision' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
