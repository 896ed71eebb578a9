"""Training of drawn paths: shapes of motions, symmetries, the loss, a run, its command line."""

import numpy as np
import pytest
import torch

from lab.trainings.paths.__main__ import run
from lab.trainings.paths.training import (
    Motions,
    PathTrainer,
    Settings,
    denoising_loss,
    shaped,
    simulated,
    train,
    turned,
    validation_losses,
)
from motdiff.network.path_denoiser import POINTS, SIGMA_DATA, PathDenoiser
from motdiff.training.motion_bank import MotionMix
from motdiff.weights import PATH_SCHEMA, load_path_denoiser
from motdiff.weights_io import read_card

MIX = MotionMix(boracchi_foi=0.5, straight=0.5, max_length_px=25)


def some_motions(count=40):
    return simulated(MIX, count=count, seed=3)


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def points_of(shapes, radii_px):
    """Positions (N, 64, 2), px, of shapes, by the sum of cosines itself."""
    order = np.arange(1, POINTS)
    times = (np.arange(POINTS) + 0.5) / POINTS
    cosines = np.sqrt(2 / POINTS) * np.cos(np.pi * order * times[:, None])
    return radii_px.numpy()[:, None, None] * (cosines @ shapes.numpy())


def test_shapes_are_centred_paths_of_radius_1():
    points = np.cumsum(np.random.default_rng(0).standard_normal((5, POINTS, 2)), axis=1)
    motions = shaped(points.astype(np.float32))
    centred = points - points.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(points_of(motions.shapes, motions.radii_px), centred, atol=1e-4)
    np.testing.assert_allclose(
        motions.radii_px, np.sqrt((centred**2).sum(axis=2).mean(axis=1)), rtol=1e-5
    )


def test_what_hardly_moves_is_left_out():
    points = np.zeros((2, POINTS, 2), dtype=np.float32)
    points[1, :, 0] = np.linspace(0, 20, POINTS)
    assert len(shaped(points)) == 1


def test_turned_paths_have_the_same_distances_and_speeds_run_either_way():
    motions = some_motions(12)
    before = points_of(motions.shapes, motions.radii_px)
    after = points_of(turned(motions.shapes, generator()), motions.radii_px)
    speeds = [np.linalg.norm(np.diff(points, axis=1), axis=2) for points in (before, after)]
    backwards = 0
    for there, here in zip(*speeds, strict=True):
        runs = [np.allclose(here, way, atol=1e-3) for way in (there, there[::-1])]
        assert any(runs)
        backwards += not runs[0]
    assert 0 < backwards < len(before)


def test_the_loss_is_about_1_for_a_network_that_expects_the_mean():
    class Nothing(torch.nn.Module):
        def forward(self, noisy, sigma, radius_px):
            return torch.zeros_like(noisy)

    shapes = SIGMA_DATA * torch.randn((2000, POINTS - 1, 2), generator=generator(1))
    sigma = torch.full((2000,), 100.0)  # beneath such noise nothing is seen
    loss = denoising_loss(Nothing(), shapes, torch.ones(2000), sigma, generator())
    assert float(loss) == pytest.approx(1, abs=0.02)


def test_updates_lower_the_loss_and_the_variances_are_those_of_the_motions():
    motions = some_motions(200)
    trainer = PathTrainer(motions, Settings(batch=64, seed=1))
    before = validation_losses(trainer.average, motions, seed=0)
    for _ in range(30):
        trainer.update(share=0.0)
    after = validation_losses(trainer.network.eval(), motions, seed=0)
    assert sum(after.values()) < sum(before.values())
    expected = motions.shapes.square().mean(dim=(0, 2))
    torch.testing.assert_close(trainer.average.variances, expected)


def test_the_file_is_written_at_each_validation_and_holds_the_average(tmp_path):
    moments = iter(range(0, 1000, 10))
    lines = []
    file = tmp_path / "paths.safetensors"
    settings = Settings(minutes=0.5, batch=8)
    train(
        some_motions(),
        file,
        settings=settings,
        validate_s=15,
        clock=lambda: float(next(moments)),
        report=lambda line: lines.append((line, file.stat().st_mtime_ns)),
    )
    assert len(lines) == 2
    assert lines[0][1] < lines[1][1]
    assert read_card(file, PATH_SCHEMA)["step"] == 3
    assert isinstance(load_path_denoiser(file), PathDenoiser)


def test_the_same_seed_trains_the_same_network():
    first, again, other = (
        PathTrainer(some_motions(), Settings(batch=8, seed=seed)) for seed in (0, 0, 1)
    )
    losses = [trainer.update(share=0.0) for trainer in (first, again, other)]
    assert losses[0] == losses[1] != losses[2]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--minutes", "0"], "minutes: must be positive"),
        (["--batch", "0"], "batch: must be at least 1"),
        ([], "none.txt"),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, capsys, options, message):
    out = tmp_path / "paths.safetensors"
    assert run(["train", "--gyro", "none.txt", "-o", str(out), *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert not out.exists()


def test_too_few_motions_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"^motions: need at least 10 that move, got 9"):
        train(some_motions(9), tmp_path / "paths.safetensors")
    assert not any(tmp_path.iterdir())


def test_motions_are_drawn_alike_for_a_seed():
    first, again = some_motions(6), some_motions(6)
    assert isinstance(first, Motions)
    torch.testing.assert_close(first.shapes, again.shapes)
