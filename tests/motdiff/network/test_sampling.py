"""Drawing trajectories: the layout, the randomness and the cost of it, and PSFs of maps against
exact ones."""

import numpy as np
import pytest
import torch

from motdiff.metrics import mnc_subpixel
from motdiff.network.config import NetworkConfig
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.diffusion import cosine_schedule
from motdiff.network.sampling import PathSamples, psfs_of_maps, sample_paths
from motdiff.trajectory import Trajectory


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def draw(network, condition, **options):
    given = {
        "count": 1,
        "schedule": cosine_schedule(),
        "steps": 4,
        "generator": seeded(),
    } | options
    return sample_paths(network, condition, **given)


class Oracle:
    """Knows the map of each condition, which is a constant that numbers its photo; notes what it
    is asked."""

    pitch = 4
    denoiser = property(lambda network: network)

    def __init__(self, maps, dwell=None):
        self.maps = maps
        self.dwell = dwell
        self.calls = []

    def __call__(self, x_t, t, condition):
        self.calls.append((x_t, t, condition))
        index = condition[:, 0, 0, 0].long()
        logits = 40 * (2 * self.maps[index] - 1)
        if self.dwell is None:
            return logits
        return torch.cat(
            [logits, torch.log(torch.expm1(self.dwell[index]))], dim=1
        )  # softplus undoes it


def numbered(count, *, channels=3, side=16):
    return torch.arange(float(count)).view(-1, 1, 1, 1).expand(count, channels, side, side)


@pytest.fixture(scope="module")
def maps():
    return (torch.rand(3, 1, 64, 64, generator=seeded(1)) > 0.9).float()


# ---- sampling


@pytest.mark.parametrize("method", ["ddim", "ddpm", "dpm++2m"])
def test_an_oracle_s_truth_is_drawn(maps, method):
    drawn = draw(Oracle(maps), numbered(3), method=method)
    assert drawn.path.shape == drawn.dwell.shape == (3, 1, 64, 64)
    torch.testing.assert_close(drawn.path, maps, atol=1e-6, rtol=0)
    assert (drawn.dwell == 1).all()


def test_the_draws_of_a_photo_lie_side_by_side(maps):
    drawn = draw(Oracle(maps), numbered(3), count=4)
    assert drawn.path.shape == (3, 4, 64, 64)
    torch.testing.assert_close(drawn.path, maps.expand(3, 4, 64, 64), atol=1e-6, rtol=0)


def test_the_dwell_is_the_network_s(maps):
    dwell = 0.2 + torch.rand(3, 1, 64, 64, generator=seeded(2))
    drawn = draw(Oracle(maps, dwell), numbered(3), count=2)
    torch.testing.assert_close(drawn.dwell, dwell.expand(3, 2, 64, 64))
    torch.testing.assert_close(drawn.path, maps.expand(3, 2, 64, 64), atol=1e-6, rtol=0)
    torch.testing.assert_close(drawn.psfs(), psfs_of_maps((maps * dwell).expand(3, 2, 64, 64)))


def test_every_step_is_one_call_for_all_draws(maps):
    oracle = Oracle(maps)
    draw(oracle, numbered(3), count=2, steps=5)
    assert [x_t.shape for x_t, _, _ in oracle.calls] == [(6, 1, 64, 64)] * 5
    assert [set(t.tolist()) for _, t, _ in oracle.calls] == [{999}, {799}, {599}, {399}, {199}]
    assert oracle.calls[0][2][:, 0, 0, 0].tolist() == [0, 0, 1, 1, 2, 2]
    noise = oracle.calls[0][0]
    assert len(noise.flatten(1).unique(dim=0)) == 6


def real_network():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        config = NetworkConfig(
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
        return MotDiffNetwork(config).eval()


def test_a_real_network_s_draws_follow_from_the_generator(monkeypatch):
    network = real_network()
    physics = torch.randn(2, 2, 64, 64, generator=seeded(4))
    calls = []
    real = network.physics.forward
    monkeypatch.setattr(network.physics, "forward", lambda maps: calls.append(maps) or real(maps))

    def drawn(seed):
        with torch.no_grad():
            return draw(
                network,
                network.condition(None, physics),
                count=2,
                generator=seeded(seed),
                method="ddpm",
            )

    first = drawn(0)
    again = drawn(0)
    other = drawn(1)
    assert len(calls) == 3  # once per condition, however many steps and draws
    assert first.path.shape == (2, 2, 256, 256)
    assert torch.equal(first.path, again.path)
    assert torch.equal(first.dwell, again.dwell)
    assert not torch.equal(first.path, other.path)
    assert not torch.equal(first.path[:, 0], first.path[:, 1])
    assert 0 <= first.path.min() <= first.path.max() <= 1
    assert first.dwell.min() > 0
    assert not first.path.requires_grad


def test_a_half_precision_condition_gives_full_precision_maps(maps):
    drawn = draw(Oracle(maps.bfloat16(), 0.5 * maps.bfloat16() + 0.5), numbered(3).bfloat16())
    assert drawn.path.dtype == drawn.dwell.dtype == torch.float32


# ---- PSFs of maps


@pytest.mark.parametrize("angle_rad", [0.0, 0.4, np.pi / 4, 2.0])
@pytest.mark.parametrize("length_px", [8.0, 21.0, 40.0])
def test_the_map_of_a_straight_motion_has_its_psf(length_px, angle_rad):
    motion = Trajectory.straight(length_px, angle_rad=angle_rad)
    psf = psfs_of_maps(torch.from_numpy(motion.hr_map()).double())
    assert psf.shape == (64, 64)
    assert psf.sum() == pytest.approx(1)
    assert psf.min() >= 0
    assert mnc_subpixel(psf.numpy(), motion.psf()) > 0.98
    index = torch.arange(64, dtype=torch.float64) - 32
    centroid = [float((psf.sum(dim=axis) * index).sum()) for axis in (0, 1)]
    assert centroid == pytest.approx([0, 0], abs=0.26)  # a map pixel


def test_psfs_are_maps_seen_through_bilinear_hats():
    maps = torch.rand(2, 3, 256, 256, generator=seeded(), dtype=torch.float64)
    psfs = psfs_of_maps(maps)
    displacement_px = (torch.arange(256, dtype=torch.float64) - 129.5) / 4
    pixel_px = torch.arange(64, dtype=torch.float64) - 32
    hat = (1 - (displacement_px - pixel_px[:, None]).abs()).clamp(min=0)  # (64, 256)
    seen = hat @ maps @ hat.T
    torch.testing.assert_close(psfs, seen / seen.sum(dim=(2, 3), keepdim=True))


def test_the_scale_of_a_map_does_not_matter():
    maps = torch.rand(2, 256, 256, generator=seeded())
    torch.testing.assert_close(psfs_of_maps(maps), psfs_of_maps(3 * maps))


def test_an_empty_map_is_a_point():
    maps = torch.zeros(2, 2, 256, 256)
    maps[1, 1, 40:60, 200:220] = 1
    psfs = psfs_of_maps(maps)
    point = torch.zeros(64, 64)
    point[32, 32] = 1
    assert torch.equal(psfs[0, 0], point)
    assert torch.equal(psfs[1, 0], point)
    assert psfs[1, 1, :20, 46:].sum() == pytest.approx(1)
    assert torch.equal(PathSamples(maps, torch.zeros_like(maps)).psfs()[1, 1], point)
