"""Training of the denoiser: samples, loss, schedule and command line."""

import itertools
import re

import numpy as np
import pytest
import torch

from cep.files.images import write_image
from cep.restoration.denoiser.network import DenoisingNetwork
from cep.restoration.denoiser.weights import load_denoiser, read_card
from lab.trainings.denoiser.__main__ import run
from lab.trainings.denoiser.samples import SIGMAS, draw
from lab.trainings.denoiser.training import Settings, Trainer, train

TINY = Settings(batch=2, crop_px=16)


def clock(step_s):
    times = itertools.count(0.0, step_s)
    return lambda: next(times)


# ---- samples


def test_a_batch_depends_on_the_seed_and_its_step_alone(photos):
    first, again, other = (draw(photos, step, count=3, side_px=16, seed=1) for step in (3, 3, 4))
    assert torch.equal(first.noisy, again.noisy)
    assert torch.equal(first.sigma, again.sigma)
    assert not torch.equal(first.noisy, other.noisy)


def test_the_noise_is_white_and_of_the_level_told(photos):
    batch = draw(photos, 0, count=60, side_px=32, seed=0)
    assert batch.clean.min() >= 0
    assert batch.clean.max() <= 1
    assert SIGMAS[0] <= batch.sigma.min() < 3 * SIGMAS[0]
    assert SIGMAS[1] / 3 < batch.sigma.max() <= SIGMAS[1]
    noise = (batch.noisy - batch.clean) / batch.sigma.view(-1, 1, 1, 1)
    assert float(noise.std()) == pytest.approx(1, abs=0.01)
    assert float((noise[..., 1:] * noise[..., :-1]).mean()) == pytest.approx(0, abs=0.02)


# ---- training


def test_training_lowers_the_loss(photos):
    trainer = Trainer(TINY)
    batch = draw(photos, 0, count=4, side_px=16, seed=0)
    losses = [trainer.update(batch, progress=0.0) for _ in range(60)]
    assert losses[-1] < 0.6 * losses[0]


def test_the_step_size_ends_near_nothing(photos):
    batch = draw(photos, 0, count=2, side_px=16, seed=0)
    moved = []
    for progress in (0.0, 1.0):
        trainer = Trainer(TINY)
        before = trainer.network.head.weight.detach().clone()
        trainer.update(batch, progress=progress)
        moved.append(float((trainer.network.head.weight.detach() - before).abs().max()))
    assert moved[1] == pytest.approx(0.01 * moved[0], rel=0.05)


def test_a_run_is_as_long_as_its_clock_says_and_writes_as_it_goes(photos, tmp_path):
    target = tmp_path / "d.safetensors"
    lines = []
    steps = train(
        photos,
        target,
        minutes=1.0,
        settings=TINY,
        save_s=25.0,
        clock=clock(10.0),
        report=lines.append,
    )
    assert steps == 6
    assert len(lines) == 2
    assert read_card(target) == {
        "steps": 6,
        "seconds": 60,
        "settings": {"batch": 2, "crop_px": 16, "rate": 1.2e-3, "seed": 0},
    }
    again = tmp_path / "again.safetensors"
    train(photos, again, minutes=1.0, settings=TINY, clock=clock(10.0))
    assert again.read_bytes() == target.read_bytes()


def test_what_is_written_is_the_average_of_the_weights(photos, tmp_path):
    train(photos, tmp_path / "d.safetensors", minutes=1.0, settings=TINY, clock=clock(20.0))
    trainer = Trainer(TINY)
    first = trainer.network.head.weight.detach().clone()
    for step, kept in enumerate((1 / 10, 2 / 11, 3 / 12)):
        trainer.update(draw(photos, step, count=2, side_px=16, seed=0), progress=step / 3)
        first = kept * first + (1 - kept) * trainer.network.head.weight.detach()
    torch.testing.assert_close(trainer.average["head.weight"], first)
    image = np.random.default_rng(0).random((16, 16))
    network = DenoisingNetwork()
    network.load_state_dict(trainer.average)
    with torch.no_grad():
        expected = network(torch.from_numpy(image[None, None]).float(), torch.tensor([0.1]))[
            0, 0
        ].numpy()
    np.testing.assert_allclose(
        load_denoiser(tmp_path / "d.safetensors")(image, 0.1), expected, atol=2e-3
    )


def test_the_command_trains_and_evaluates(tmp_path, capsys):
    folder = tmp_path / "photos"
    folder.mkdir()
    write_image(folder / "a.png", np.random.default_rng(0).random((100, 110, 3)))
    target = tmp_path / "d.safetensors"
    assert run(["train", str(folder), "-o", str(target), "--minutes", "0.001"]) == 0
    assert read_card(target)["steps"] >= 1
    assert run(["evaluate", str(folder), "--weights", str(target)]) == 0
    assert (
        len(re.findall(r"sigma 0\.\d+: -?[\d.]+ dB -> -?[\d.]+ dB", capsys.readouterr().out)) == 4
    )


# ---- bad input


def test_bad_input_gives_one_line(photos, tmp_path, capsys):
    with pytest.raises(ValueError, match="minutes: must be above 0"):
        train(photos, tmp_path / "d.safetensors", minutes=0.0)
    assert run(["train", str(tmp_path / "nowhere"), "-o", str(tmp_path / "d.safetensors")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())
