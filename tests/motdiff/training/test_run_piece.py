"""Whole pieces of a training run: what they leave behind, how they end, and that several processes
agree."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from children import child

from motdiff.blind_search.coarse_to_fine import Start
from motdiff.network.config import NetworkConfig
from motdiff.network.physics_maps import quick_kernels
from motdiff.training import prepared as prepared_module
from motdiff.training import samples as samples_module
from motdiff.training.batches import LiveSource, PreparedSource, Sources, make_sources
from motdiff.training.checkpoint import read_checkpoint
from motdiff.training.config import DataConfig, OptimiserConfig, TrainingConfig
from motdiff.training.log import read_log
from motdiff.training.motion_bank import MotionMix
from motdiff.training.prepared import Source, prepare, read_shards
from motdiff.training.run_piece import Pace, train, validation_mnc
from motdiff.training.simulation import Photography
from motdiff.training.trainer import Losses, Trainer

ROOT = Path(__file__).resolve().parents[3]
SHORT = MotionMix(max_length_px=12)
PLAIN = Photography(most_noise=0.0, gammas=(1.0, 1.0), wrong_gamma=0.0, gains=(1.0, 1.0), jpeg=0.0)
PHYSICS = NetworkConfig(
    backbone="none",
    physics_channels=8,
    physics_width=8,
    physics_depth=1,
    physics_patch=2,
    denoiser_width=8,
    decoder_widths=(8, 4),
    dropout=0.0,
    dwell=True,
    time_width=16,
)
ONCE = OptimiserConfig(steps=1, batch=2, window=8, seed=3)


@pytest.fixture(autouse=True, scope="module")
def small_search():
    """Small frames instead of the three of the training, and one thread."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    starts = tuple(Start(size, 1.0) for size in (9, 11, 13))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            samples_module, "quick_kernels", partial(quick_kernels, starts=starts, iterations=1)
        )
        yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Six photos: every third one dark, the others bright."""
    folder = tmp_path_factory.mktemp("photos")
    rng = np.random.default_rng(0)
    for i in range(6):
        blocks = rng.integers(0, 80, (33, 33, 3)) + (10 if i % 3 == 0 else 170)
        cv2.imwrite(str(folder / f"{i}.png"), blocks.astype(np.uint8).repeat(10, 0).repeat(10, 1))
    return folder


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """Folders of eight samples to learn from and of four to validate on."""
    folder = tmp_path_factory.mktemp("prepared")
    blocks = torch.randint(0, 256, (3, 33, 33), generator=torch.Generator().manual_seed(0)).to(
        torch.uint8
    )
    scene = blocks.repeat_interleave(10, 1).repeat_interleave(10, 2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prepared_module, "SHARD_SAMPLES", 4)
        for name, shards, seed in (("samples", 2, 1), ("validation", 1, 2)):
            target = folder / name
            prepare(target, Source([scene], SHORT, PLAIN, seed), shards=range(shards))
    return folder


def from_prepared(folder, *, network=PHYSICS, optimiser=ONCE, validation=2):
    data = DataConfig(
        prepared=str(folder / "samples"),
        prepared_validation=str(folder / "validation"),
        validation=validation,
    )
    return TrainingConfig(data, network=network, optimiser=optimiser)


def live(photos, *, network=PHYSICS, validation=2, optimiser=ONCE):
    data = DataConfig(photos=str(photos), held_out=3, motions=5, validation=validation)
    return TrainingConfig(
        data, motions=SHORT, photography=PLAIN, network=network, optimiser=optimiser
    )


def toml(config):
    """The entries of a prepared run as a file for the command."""
    data = config.data
    network = config.network
    optimiser = config.optimiser
    return f"""
[data]
prepared = "{data.prepared}"
prepared_validation = "{data.prepared_validation}"
validation = {data.validation}
[network]
backbone = "none"
physics_channels = 8
physics_width = {network.physics_width}
physics_depth = 1
physics_patch = 2
denoiser_width = {network.denoiser_width}
decoder_widths = {list(network.decoder_widths)}
dwell = true
time_width = 16
[optimiser]
steps = {optimiser.steps}
batch = {optimiser.batch}
window = {optimiser.window}
seed = {optimiser.seed}
"""


def alone():
    """Environment of a process with one thread and no GPU."""
    return os.environ | {
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "CUDA_VISIBLE_DEVICES": "",
    }


# ---- one piece


def assert_left_behind(folder, *, step):
    checkpoint = read_checkpoint(folder / "checkpoint")
    assert checkpoint.step == step
    rows = read_log(folder / "log.csv")
    assert rows[-1]["step"] == step
    assert 0 <= rows[-1]["validation_mnc"] <= 1
    assert (folder / "progress.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in folder.iterdir()) == [
        "checkpoint",
        "log.csv",
        "progress.png",
    ]


def test_a_run_from_prepared_samples(prepared, tmp_path, capsys):
    config = from_prepared(prepared, optimiser=replace(ONCE, steps=3))
    trainer = train(config, tmp_path / "deep" / "run", pace=Pace(validate_steps=2))
    assert trainer.step == 3
    assert_left_behind(tmp_path / "deep" / "run", step=3)
    assert [row["step"] for row in read_log(tmp_path / "deep" / "run" / "log.csv")] == [
        2,
        3,
    ]  # the end only once
    assert "new run, from step 0 of 3" in capsys.readouterr().err


@pytest.mark.parametrize("channels", [0, 8])
def test_a_run_from_prepared_samples_with_a_photo_encoder(prepared, tmp_path, channels):
    network = replace(PHYSICS, backbone="b0", photo_pool=2, width=8, physics_channels=channels)
    train(from_prepared(prepared, network=network, validation=1), tmp_path)
    assert_left_behind(tmp_path, step=1)


def test_a_run_from_photos_with_physics_maps(photos, tmp_path):
    train(live(photos), tmp_path, pace=Pace(minutes=0))
    assert_left_behind(tmp_path, step=1)


def test_a_run_from_photos_with_a_photo_encoder(photos, tmp_path):
    network = NetworkConfig(
        backbone="b0", features="f2", width=8, denoiser_width=8, decoder_widths=(8, 4)
    )
    train(live(photos, network=network, validation=1), tmp_path, pace=Pace(minutes=0))
    assert_left_behind(tmp_path, step=1)


def test_no_minutes_are_one_step_and_the_next_piece_goes_on(prepared, tmp_path, capsys):
    config = from_prepared(prepared, optimiser=replace(ONCE, steps=4))
    for step in (1, 2):
        train(config, tmp_path, pace=Pace(minutes=0))
        assert_left_behind(tmp_path, step=step)
    assert "resumed at step 1 of 4" in capsys.readouterr().err
    whole = tmp_path / "whole"
    train(replace(config, optimiser=replace(ONCE, steps=4)), whole)
    train(config, tmp_path)
    pieces, expected = (
        read_checkpoint(folder / "checkpoint").tensors for folder in (tmp_path, whole)
    )
    assert all(torch.equal(pieces[name], tensor) for name, tensor in expected.items())


class Photos:
    """So many photos to validate on, which nobody looks at."""

    def __init__(self, count):
        self.count = count

    def __len__(self):
        return self.count

    def split(self, size):
        return [Photos(min(size, self.count - first)) for first in range(0, self.count, size)]


@pytest.fixture
def on_a_clock(monkeypatch):
    """Trainings by a clock of their own: 20 s for the samples, 4 s an update, 256 photos to
    validate on."""
    clock = SimpleNamespace(seconds=0.0, photo_s=0.0, monotonic=lambda: clock.seconds)

    def sources(*_arguments, **_options):
        clock.seconds += 20
        return Sources(training=None, validation=(Photos(32),) * 8)

    def update(trainer, _source):
        clock.seconds += 4
        trainer.step += 1
        return Losses(1.0, 1.0, 0.0, 1.0, 1.0)

    def scores(_trainer, batches, **_options):
        photos = sum(map(len, batches))
        clock.seconds += clock.photo_s * photos
        return np.full(photos, 0.5)

    monkeypatch.setattr("motdiff.training.run_piece.time", clock)
    monkeypatch.setattr("motdiff.training.run_piece.make_sources", sources)
    monkeypatch.setattr("motdiff.training.run_piece.Trainer.update", update)
    monkeypatch.setattr("motdiff.training.run_piece.validation_scores", scores)
    return clock


@pytest.mark.parametrize(
    ("minutes", "photo_s", "validated"),
    [(1, 1.0, False), (1, 0.05, True), (10, 1.0, True), (4, 1.0, False), (0, 1.0, False)],
)
def test_the_minutes_count_all_that_a_piece_does(
    prepared, tmp_path, on_a_clock, minutes, photo_s, validated
):
    on_a_clock.photo_s = photo_s
    config = from_prepared(prepared, optimiser=replace(ONCE, steps=1_000_000))
    trainer = train(config, tmp_path, pace=Pace(minutes=minutes))
    assert trainer.step >= 1
    if minutes:
        assert 60 * minutes - 8 <= on_a_clock.seconds <= 60 * minutes + 5
    assert (tmp_path / "progress.png").exists() == validated


def test_a_validation_each_minute(prepared, tmp_path, on_a_clock):
    """Of 15 updates of 4 s, besides those of the steps and the one at the end of a piece."""
    config = from_prepared(prepared, optimiser=replace(ONCE, steps=1_000_000))
    train(config, tmp_path, pace=Pace(minutes=5, validate_steps=20, validate_minutes=1))
    assert [
        row["step"] for row in read_log(tmp_path / "log.csv") if row["validation_mnc"] == 0.5
    ] == [
        15,
        20,
        35,
        40,
        55,
        60,
        70,
    ]


@pytest.fixture
def row_each_step(monkeypatch):
    monkeypatch.setattr("motdiff.training.log._EVERY_STEPS", 1)


def without_rates(folder):
    """The log's rows but for the one column that is a time."""
    with (folder / "log.csv").open(newline="") as file:
        return [{**row, "samples_per_s": None} for row in csv.DictReader(file)]


def test_the_log_of_pieces_is_that_of_one_run(prepared, tmp_path, row_each_step):
    """Ended after each step, killed after a checkpoint, finished and started again: the same rows,
    the same loss."""
    config = from_prepared(prepared, optimiser=replace(ONCE, steps=5))
    pace = Pace(validate_steps=2)
    train(config, tmp_path / "whole", pace=pace)
    expected = without_rates(tmp_path / "whole")
    assert [row["step"] for row in expected] == ["1", "2", "2", "3", "4", "4", "5", "5"]
    pieces = tmp_path / "pieces"
    for _ in range(3):
        train(config, pieces, pace=replace(pace, minutes=0))
    shutil.copy(pieces / "checkpoint", tmp_path / "checkpoint")
    train(config, pieces, pace=replace(pace, minutes=0))
    # what followed was lost
    shutil.copy(tmp_path / "checkpoint", pieces / "checkpoint")
    for _ in range(2):
        train(config, pieces, pace=pace)
        assert without_rates(pieces) == expected


def test_a_validation_that_a_kill_prevented_is_made_up_for(prepared, tmp_path, row_each_step):
    config = from_prepared(prepared, optimiser=replace(ONCE, steps=3))
    pace = Pace(validate_steps=2)
    train(config, tmp_path / "whole", pace=pace)
    pieces = tmp_path / "pieces"
    for _ in range(2):
        train(config, pieces, pace=replace(pace, minutes=0))
    lines = (pieces / "log.csv").read_text().splitlines(keepends=True)
    assert lines[-1].startswith("2,,")
    (pieces / "log.csv").write_text("".join(lines[:-1]))
    train(config, pieces, pace=pace)
    assert without_rates(pieces) == without_rates(tmp_path / "whole")


def test_a_finished_run_stays_as_it_is(prepared, tmp_path):
    config = from_prepared(prepared)
    train(config, tmp_path)
    before = read_checkpoint(tmp_path / "checkpoint")
    trainer = train(config, tmp_path)
    assert trainer.step == 1
    after = read_checkpoint(tmp_path / "checkpoint")
    assert after.seconds == before.seconds
    assert all(torch.equal(after.tensors[name], tensor) for name, tensor in before.tensors.items())


def test_a_piece_saves_as_often_as_asked(prepared, tmp_path, monkeypatch):
    saves = []
    monkeypatch.setattr(
        "motdiff.training.run_piece.Trainer.save",
        lambda trainer, _folder: saves.append(trainer.step),
    )
    config = from_prepared(prepared, optimiser=replace(ONCE, steps=3))
    train(config, tmp_path, pace=Pace(save_s=0))
    assert saves == [1, 2, 3, 3]
    saves.clear()
    train(config, tmp_path)
    assert saves == [3]


def test_a_signal_ends_a_piece_with_a_checkpoint(prepared, tmp_path):
    config = from_prepared(prepared, optimiser=replace(ONCE, steps=1_000_000))
    (tmp_path / "run.toml").write_text(toml(config))
    command = [
        sys.executable,
        "-m",
        "motdiff",
        "train",
        "run.toml",
        "-o",
        "run",
        "--save-every",
        "0",
        "--device",
        "cpu",
    ]
    with child(command, cwd=tmp_path, env=alone(), stderr=subprocess.PIPE) as process:
        until = time.monotonic() + 120
        while not (tmp_path / "run" / "checkpoint").exists():  # from now on the signals are noted
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < until
            time.sleep(0.05)
        process.send_signal(signal.SIGTERM)
        _, told = process.communicate(timeout=60)
    assert process.returncode == 0, told
    assert "Traceback" not in told
    step = read_checkpoint(tmp_path / "run" / "checkpoint").step
    assert step >= 1
    assert_left_behind(tmp_path / "run", step=step)


def test_signals_have_their_own_meaning_again_after_a_piece(prepared, tmp_path):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    train(from_prepared(prepared), tmp_path)
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_second_signal_does_not_wait(prepared, tmp_path, monkeypatch):
    def impatient(_trainer, _source):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("motdiff.training.run_piece.Trainer.update", impatient)
    with pytest.raises(KeyboardInterrupt):
        train(from_prepared(prepared), tmp_path)


@pytest.mark.parametrize(
    "pace",
    [
        {"minutes": -1.0},
        {"minutes": float("nan")},
        {"save_s": -1.0},
        {"validate_steps": 0},
        {"validate_minutes": -1.0},
    ],
)
def test_an_impossible_pace_is_refused(pace):
    (name,) = pace
    with pytest.raises(ValueError, match=f"^{name}: must be at least"):
        Pace(**pace)


# ---- sources


def test_validation_is_on_held_out_photos(photos):
    sources = make_sources(live(photos, network=NetworkConfig(backbone="b0"), validation=3))
    assert isinstance(sources.training, LiveSource)
    (fixed,) = sources.validation
    assert len(fixed) == 3
    assert (fixed.photo.mean(dim=(1, 2, 3)) < 0.7).all()
    seen = sources.training.batch(0, 4).photo
    assert (seen.mean(dim=(1, 2, 3)) > 0.7).all()


def test_validation_is_on_other_motions_and_always_the_same(photos):
    config = live(photos, network=NetworkConfig(backbone="b0"), validation=3)
    first, second = (make_sources(config).validation[0] for _ in range(2))
    assert torch.equal(first.photo, second.photo)
    assert torch.equal(first.x0, second.x0)
    seen = make_sources(config).training.batch(0, 8).x0
    assert not any(torch.equal(a, b) for a in first.x0 for b in seen)


def test_validation_takes_each_prepared_sample_once(prepared):
    stored = read_shards(prepared / "validation").x0.float()
    for validation, count in [(3, 3), (4, 4), (256, 4)]:
        sources = make_sources(from_prepared(prepared, validation=validation))
        assert isinstance(sources.training, PreparedSource)
        maps = torch.cat([batch.x0 for batch in sources.validation])
        assert len(maps) == count
        found = [
            [torch.equal(a, b) for b in stored].index(True) for a in maps
        ]  # neither turned nor mirrored
        assert len(set(found)) == count


def test_physics_maps_must_fit_the_network(prepared, photos):
    wrong = replace(PHYSICS, physics_channels=6)
    for config in (from_prepared(prepared, network=wrong), live(photos, network=wrong)):
        with pytest.raises(ValueError, match=r"^network\.physics_channels: must be 8"):
            make_sources(config)


def test_a_perfect_network_is_validated_as_one(prepared):
    """Drawn from the truth itself, the MNC is 1; a network that has learnt nothing is far from
    it."""
    config = from_prepared(prepared, validation=4)
    sources = make_sources(config)
    trainer = Trainer(config)
    untrained = validation_mnc(trainer, sources.validation)
    (batch,) = sources.validation

    class Oracle:
        pitch = 4
        denoiser = property(lambda network: network)

        def condition(self, photo, physics):
            return torch.zeros(len(physics), 1, 64, 64)

        def __call__(self, x_t, t, condition):
            return torch.cat(
                [40 * (2 * batch.x0 - 1), torch.log(torch.expm1(batch.dwell.clamp(min=1e-4)))],
                dim=1,
            )

    trainer.average = Oracle()
    assert validation_mnc(trainer, sources.validation) == pytest.approx(1, abs=1e-3)
    assert 0 <= untrained < 0.8


# ---- several processes

TOGETHER = """
import os, signal, torch
from pathlib import Path
from motdiff.training.config import read_config
from motdiff.training.run_piece import Trainer, train

torch.set_num_threads(1)
rank = int(os.environ["RANK"])
update = Trainer.update

def stopped_after_two(trainer, source):
    losses = update(trainer, source)
    if (rank, trainer.step) == (1, 2):
        signal.raise_signal(signal.SIGTERM)
    return losses

Trainer.update = stopped_after_two
trainer = train(read_config("run.toml"), "run")
torch.save([trainer.step, list(trainer.network.parameters())], f"rank{rank}.pt")
"""


@pytest.mark.slow(reason="three processes import torch")
def test_two_processes_train_one_network_and_end_together(prepared, tmp_path):
    """Only one is asked to stop; the other would wait for its gradients for ever."""
    (tmp_path / "run.toml").write_text(
        toml(from_prepared(prepared, optimiser=replace(ONCE, steps=1000)))
    )
    (tmp_path / "together.py").write_text(TOGETHER)
    command = [
        sys.executable,
        "-m",
        "torch.distributed.run",
        "--nproc-per-node",
        "2",
        "--standalone",
        "together.py",
    ]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=alone(),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    steps, parameters = zip(
        *(torch.load(tmp_path / f"rank{rank}.pt") for rank in (0, 1)), strict=True
    )
    assert steps == (2, 2)
    assert all(torch.equal(a, b) for a, b in zip(*parameters, strict=True))
    assert all(parameter.isfinite().all() for parameter in parameters[0])
    assert done.stderr.count("new run, from step 0") == done.stderr.count("validation MNC") == 1
    assert_left_behind(tmp_path / "run", step=2)
