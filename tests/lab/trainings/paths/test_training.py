"""Diffusion of paths: rendering, symmetries, registration, one update, draws and command line."""

import numpy as np
import pytest
import torch

from cep.files.images import write_image
from lab.trainings.paths import samples as samples_module
from lab.trainings.paths.__main__ import run
from lab.trainings.paths.batches import Batches
from lab.trainings.paths.evaluation import figures
from lab.trainings.paths.network import POINTS, UNIT_PX, PathDenoiser, draw, rendered
from lab.trainings.paths.samples import (
    PathSamples,
    clean_points,
    described_paths,
    forward_in_time,
    peaks,
    read_samples,
    turned,
)
from lab.trainings.paths.training import DrawnPathTrainer, Settings, train
from motdiff.blind_search.grids import SYMMETRIES, mirrored
from motdiff.motions import boracchi_foi
from motdiff.training.motion_bank import MotionMix
from motdiff.weights_io import read_card, read_tensors

MIX = MotionMix(max_length_px=25)
SMALL = {"channels": 32, "layers": 2, "width": 8}


def walk(seed):
    return boracchi_foi(np.random.default_rng(seed), max_length_px=30)


def some_samples(count=6):
    motions = [walk(seed) for seed in range(count)]
    psfs = torch.from_numpy(np.stack([motion.psf(64) for motion in motions])).float()
    times = np.linspace(0, 1, POINTS)
    points = torch.from_numpy(np.stack([motion.at(times) for motion in motions])).float()
    return described_paths(psfs[:, None].repeat(1, 3, 1, 1), psfs.clone(), points, psfs)


def test_a_rendered_path_is_its_psf():
    for seed in range(4):
        motion = walk(seed)
        points = torch.from_numpy(motion.at(np.linspace(0, 1, POINTS))).float()
        exact = torch.from_numpy(motion.psf(64)).float()
        assert peaks(rendered(points[None])[None], exact[None, None])[0] > 0.99
    outside = rendered(torch.full((1, POINTS, 2), 40.0))
    assert float(outside.sum()) == 0


@pytest.mark.parametrize("symmetry", range(SYMMETRIES))
def test_maps_and_points_turn_alike(symmetry):
    points = torch.from_numpy(walk(1).at(np.linspace(0, 1, POINTS))).float()[None]
    maps, turned_points = turned(rendered(points)[:, None], points, symmetry)
    torch.testing.assert_close(maps[:, 0], rendered(turned_points), atol=1e-6, rtol=0)
    torch.testing.assert_close(maps, mirrored(rendered(points)[:, None], symmetry, pitch=1))


def test_points_are_laid_on_kernels_to_a_part_of_a_pixel():
    motion = walk(3)
    points = torch.from_numpy(motion.at(np.linspace(0, 1, POINTS))).float()[None]
    shift = torch.tensor([2.3, -1.4])
    kernels = rendered(points + shift)[:, None].repeat(1, 3, 1, 1)
    kernels[:, 1] = kernels[:, 1].roll((3, -5), (1, 2))
    laid = described_paths(kernels, kernels[:, 0], points, rendered(points))
    maps = laid.maps.float()
    torch.testing.assert_close(maps[:, 1], maps[:, 0])
    again = rendered(laid.points)
    assert peaks(again[:, None], maps[:, :1].square())[1].abs().max() < 0.2
    assert float(laid.alike[0]) > 0.8  # over whole pixels only


def test_time_runs_one_way_for_a_path_and_its_reverse():
    points = torch.randn(9, POINTS, 2, generator=torch.Generator().manual_seed(0)).cumsum(1)
    torch.testing.assert_close(forward_in_time(points), forward_in_time(points.flip(1)))


def test_a_path_with_hardly_any_noise_stays_as_it_is():
    network = PathDenoiser(32, 2, 8)
    torch.nn.init.normal_(network.out.weight)
    samples = some_samples(2)
    x = samples.points / UNIT_PX
    condition = network.condition(samples.maps.float() / 127)
    denoised = network(x, torch.full((2,), 1e-4), condition)
    assert float((denoised - x).detach().abs().max()) < 0.01


def test_training_brings_the_loss_down_and_throws_exploding_updates_away():
    samples = some_samples()
    trainer = DrawnPathTrainer(Settings(**SMALL, batch=8, rate=3e-3, clean=0.25))
    batches = Batches(samples, samples.points, generator=trainer.generator)
    losses = [trainer.update(*batches.batch(8, 0.25), share=0.1) for _ in range(80)]
    assert np.mean(losses[-30:]) < 0.85 * np.mean(losses[:10])
    before = [value.clone() for value in trainer.network.parameters()]
    maps, points = batches.batch(8, 0.0)
    trainer.update(maps, points * float("nan"), share=0.1)
    assert trainer.thrown_away == 1
    assert all(map(torch.equal, before, trainer.network.parameters()))


def test_draws_follow_from_the_generator_alone():
    network = PathDenoiser(32, 2, 8).eval()
    maps = some_samples(2).maps.float() / 127
    first, again = (
        draw(network, maps, count=3, steps=4, generator=torch.Generator().manual_seed(7))
        for _ in range(2)
    )
    assert first.shape == (2, 3, POINTS, 2)
    assert torch.equal(first, again)
    assert not torch.equal(first[:, 0], first[:, 1])


class Oracle(PathDenoiser):
    """Denoises every path to the truth."""

    def __init__(self, points):
        super().__init__(32, 1, 8)
        self.truth = points / UNIT_PX

    def forward(self, x, sigma, condition):
        return self.truth.repeat_interleave(len(x) // len(self.truth), dim=0)


def test_figures_of_true_draws_are_perfect():
    samples = some_samples(4)
    reversed_in_time = PathSamples(
        samples.maps, samples.points.flip(1), samples.psfs, samples.alike
    )
    result = figures(
        Oracle(samples.points),
        reversed_in_time,
        draws=2,
        generator=torch.Generator().manual_seed(0),
    )
    assert result.draw > 0.97
    assert result.best >= result.draw
    assert result.error_px < 0.01
    assert result.alike == pytest.approx(1, abs=1e-5)


def test_a_file_holds_the_best_weights(tmp_path):
    ticks = iter(range(1000))
    lines = []
    samples = some_samples(4)
    train(
        samples,
        samples,
        clean_points(MIX, count=3, seed=1),
        tmp_path / "p.safetensors",
        settings=Settings(**SMALL, minutes=0.1, batch=4),
        validate_s=2,
        clock=lambda: float(next(ticks)),
        report=lines.append,
    )
    card = read_card(tmp_path / "p.safetensors", "lab.paths/1")
    best = max(float(line.split(" draw ")[1][:5]) for line in lines)
    assert card["figures"]["draw"] <= best + 1e-3
    network = Settings(**SMALL).network()
    network.load_state_dict(read_tensors(tmp_path / "p.safetensors"))


def test_the_commands_prepare_and_train(tmp_path, monkeypatch, capsys):
    rng = np.random.default_rng(0)
    (tmp_path / "photos").mkdir()
    for i in range(12):
        write_image(tmp_path / "photos" / f"{i:02d}.png", rng.random((330, 330, 3)))
    config = tmp_path / "run.toml"
    config.write_text(
        f'[data]\nphotos = "{tmp_path / "photos"}"\n[motions]\nmax_length_px = 25.0\n',
        encoding="utf-8",
    )
    monkeypatch.setattr(samples_module, "SHARD_PHOTOS", 2)
    monkeypatch.setattr(
        samples_module,
        "photo_kernels",
        lambda photos, _: (torch.rand(2, 3, 64, 64), torch.randn(2, 64, 64)),
    )
    prepare = ["prepare", str(config), "-o"]
    assert run([*prepare, str(tmp_path / "a"), "--shards", "0:2"]) == 0
    assert run([*prepare, str(tmp_path / "b"), "--shards", "0:1", "--held-out"]) == 0
    assert len(read_samples(tmp_path / "a")) == 4
    target = tmp_path / "p.safetensors"
    words = ["train", str(tmp_path / "a"), str(tmp_path / "b"), str(config), "-o", str(target)]
    assert run([*words, "--minutes", "0"]) == 2
    assert run(["train", str(tmp_path), *words[2:]]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert errors[-2] == "error: minutes: must be positive, got 0.0"
    assert "python -m lab.trainings.paths prepare" in errors[-1]
    assert not target.exists()
