"""DCE's training: it lowers the loss, keeps the code a code, goes on exactly where it stopped, and
exports."""

import csv
import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from cep.files.images import write_image
from cep.optics.code import ShutterCode
from lab.trainings.dce.__main__ import run
from lab.trainings.dce.samples import SIGMA_MAX, Samples, motion_mix
from lab.trainings.dce.training import START, CodeTrainer, Settings, train
from lab.trainings.dce.weights import SCHEMA, export_weights, load_network, read_card, restore
from motdiff.training.checkpoint import Checkpoint, read_checkpoint, write_checkpoint

TINY = Settings(start="1101000101", batch=2, crop_px=16, rate=2e-3, code_rate=0.02)


def samples(photos, settings=TINY):
    chips = len(settings.start)
    return Samples(
        photos, motion_mix(None), chips=chips, crop_px=settings.crop_px, seed=settings.seed
    )


@pytest.fixture(scope="module")
def trained(photos, tmp_path_factory):
    """A run of 8 steps in one go, and its folder."""
    folder = tmp_path_factory.mktemp("run")
    trainer = CodeTrainer(TINY)
    train(trainer, samples(photos), folder, steps=8)
    return trainer, folder


def refused(call, said):
    with pytest.raises(ValueError, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)


# ---- samples


def test_a_batch_depends_on_the_seed_and_its_step_alone(photos):
    first = samples(photos).batch(3, 2)
    again = samples(photos).batch(3, 2)
    other = samples(photos).batch(4, 2)
    for name in ("scenes", "sharp", "chip_psfs", "noise"):
        assert torch.equal(getattr(first, name), getattr(again, name))
        assert not torch.equal(getattr(first, name), getattr(other, name))


def test_a_sample_is_a_photo_its_frames_and_its_noise(photos):
    batch = samples(photos).batch(0, 6)
    assert batch.scenes.shape == (6, 1, 79, 79)
    assert torch.equal(batch.sharp, batch.scenes[..., 31:47, 31:47])
    torch.testing.assert_close(
        batch.chip_psfs.sum(dim=(1, 2, 3)), torch.ones(6), rtol=0, atol=1e-5
    )
    torch.testing.assert_close(
        batch.chip_psfs.sum(dim=(2, 3)), torch.full((6, 10), 0.1), rtol=0, atol=1e-5
    )
    deviations = batch.noise.std(dim=(1, 2, 3))
    assert deviations.max() < 1.2 * SIGMA_MAX
    assert deviations.max() > 1.5 * deviations.min()


# ---- updates


def test_the_same_batch_is_restored_better_and_better(photos):
    trainer = CodeTrainer(TINY)
    batch = samples(photos).batch(0, 2)
    losses = [trainer.update(batch, progress=0.0) for _ in range(30)]
    assert losses[-1] < 0.8 * losses[0]


def test_the_code_is_learned_in_the_middle_half_alone(photos):
    trainer = CodeTrainer(TINY)
    source = samples(photos)
    before = trainer.weights.detach().clone()
    for step, (progress, learns) in enumerate(
        [(0.0, False), (0.24, False), (0.25, True), (0.74, True), (0.75, False)]
    ):
        trainer.update(source.batch(step, 2), progress=progress)
        assert torch.equal(trainer.weights.detach(), before) is not learns
        before = trainer.weights.detach().clone()


def test_the_code_stays_a_code_however_hard_it_is_pushed(photos):
    trainer = CodeTrainer(Settings(start="1101", batch=2, crop_px=16, code_rate=0.5))
    source = samples(photos)
    source = Samples(photos, motion_mix(None), chips=4, crop_px=16, seed=0)
    for step in range(12):
        trainer.update(source.batch(step, 2), progress=0.5)
        weights = trainer.weights.detach()
        assert ((weights >= 0) & (weights <= 1)).all()
        assert trainer.code.open_chips >= 1


def test_a_loss_that_is_no_number_stops_the_run(photos):
    trainer = CodeTrainer(TINY)
    batch = samples(photos).batch(0, 2)
    batch.noise.fill_(torch.nan)
    with pytest.raises(FloatingPointError, match="loss: is nan at step 0"):
        trainer.update(batch, progress=0.0)


# ---- pieces


def test_two_pieces_give_what_one_gives(trained, photos, tmp_path):
    whole, _ = trained
    first = CodeTrainer(TINY)
    source = samples(photos)
    for step in range(5):  # the code is being learned
        first.update(source.batch(step, TINY.batch), progress=step / 8)
    first.save(tmp_path / "checkpoint")
    second = CodeTrainer(TINY)
    train(second, source, tmp_path, steps=8)
    assert second.step == whole.step == 8
    assert torch.equal(second.weights, whole.weights)
    assert not torch.equal(whole.weights, CodeTrainer(TINY).weights)
    for one, other in zip(second.network.parameters(), whole.network.parameters(), strict=True):
        assert torch.equal(one, other)


def test_a_piece_ends_when_its_time_is_over_and_is_kept(photos, tmp_path):
    train(CodeTrainer(TINY), samples(photos), tmp_path, steps=8, minutes=1e-9)
    assert read_checkpoint(tmp_path / "checkpoint").step == 1
    train(CodeTrainer(TINY), samples(photos), tmp_path, steps=8, minutes=0)
    assert read_checkpoint(tmp_path / "checkpoint").step == 1


def test_the_log_says_how_the_code_went(photos, tmp_path):
    train(CodeTrainer(TINY), samples(photos), tmp_path, steps=20)
    with (tmp_path / "log.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == [10, 20]
    for row in rows:
        assert int(row["open_chips"]) == row["bits"].count("1")
        assert int(row["flips"]) == sum(
            a != b for a, b in zip(row["bits"], TINY.start, strict=True)
        )


def test_another_run_s_checkpoint_is_refused(trained):
    _, folder = trained
    other = Settings(**(TINY.__dict__ | {"seed": 7}))
    refused(
        lambda: CodeTrainer(other).resume(folder / "checkpoint"),
        "^seed: the run in .* has 0, got 7",
    )


# ---- weights


def test_weights_come_back_to_half_precision_with_their_code(trained, tmp_path):
    trainer, folder = trained
    file = tmp_path / "w.safetensors"
    assert (
        export_weights(folder / "checkpoint", file, notes={"photos": "blocks"})
        == file.stat().st_size
    )
    for name, tensor in load_network(file).state_dict().items():
        torch.testing.assert_close(
            tensor, trainer.network.state_dict()[name], rtol=2**-11, atol=2**-24
        )
    card = read_card(file)
    assert card.code == trainer.code
    assert card.start == ShutterCode(TINY.start)
    assert (card.steps, card.notes) == (8, {"photos": "blocks"})
    before = file.read_bytes()
    export_weights(folder / "checkpoint", file, notes={"photos": "blocks"})
    assert file.read_bytes() == before


def test_a_restoration_is_the_network_s_channel_by_channel(trained, tmp_path):
    trainer, folder = trained
    file = tmp_path / "w.safetensors"
    export_weights(folder / "checkpoint", file)
    photo = 0.4 * np.random.default_rng(0).random((21, 30, 3))
    found = restore(photo, path=file)
    with torch.no_grad():
        green = trainer.network(
            torch.from_numpy(photo[None, None, :, :, 1]).float() / trainer.code.duty
        )
    np.testing.assert_allclose(found[..., 1], green[0, 0], atol=1e-3)
    np.testing.assert_array_equal(found[..., 1], restore(photo[..., 1], path=file))
    half = ShutterCode("10")
    np.testing.assert_allclose(
        restore(photo * 0.5 / trainer.code.duty, code=half, path=file), found, atol=1e-5
    )


def test_what_are_no_weights_is_refused_in_one_line(trained, tmp_path):
    _, folder = trained
    file = tmp_path / "w.safetensors"
    bad = tmp_path / "bad.safetensors"
    export_weights(folder / "checkpoint", file)
    for call in (read_card, load_network):
        refused(lambda call=call: call(tmp_path / "none"), "none: cannot be read as weights")
    save_file({"a": torch.ones(1)}, bad)
    refused(
        lambda: load_network(bad), f"bad.safetensors: is no {SCHEMA} file, its header has nothing"
    )
    for card in (json.dumps({"bits": "10"}), "[" * 100_000, "9" * 5000):
        save_file(load_file(file), bad, {SCHEMA: card})
        refused(lambda: read_card(bad), "bad.safetensors: its header is not whole")
    tensors = load_file(file)
    tensors.pop("stem.bias")
    card = json.dumps(
        {"bits": "10", "settings": {"start": "10"}, "steps": 1, "seconds": 1, "notes": {}}
    )
    save_file(tensors, bad, {SCHEMA: card})
    refused(lambda: load_network(bad), "bad.safetensors: its tensors do not fit")


def test_a_run_that_cannot_be_exported_is_refused(tmp_path):
    refused(lambda: export_weights(tmp_path / "none", tmp_path / "w"), "none: holds no checkpoint")
    huge = Checkpoint(1, {"model.a": torch.tensor([7e4]), "code": torch.ones(2)}, {})
    write_checkpoint(tmp_path / "checkpoint", huge)
    refused(
        lambda: export_weights(tmp_path / "checkpoint", tmp_path / "w"),
        "a holds values that float16 cannot",
    )
    assert not (tmp_path / "w").exists()


# ---- the command line


def test_train_export_and_evaluate(tmp_path, capsys):
    rng = np.random.default_rng(0)
    (tmp_path / "photos").mkdir()
    for name in ("a.png", "b.png"):
        write_image(
            tmp_path / "photos" / name, np.kron(rng.random((25, 25, 3)), np.ones((8, 8, 1)))
        )
    where = str(tmp_path / "photos")
    file = str(tmp_path / "w.safetensors")
    (tmp_path / "notes.json").write_text('{"photos": "blocks"}')
    assert (
        run(["train", where, "-o", str(tmp_path / "run"), "--start", "11010", "--steps", "1"]) == 0
    )
    assert (
        run(["export", str(tmp_path / "run"), "-o", file, "--notes", str(tmp_path / "notes.json")])
        == 0
    )
    assert run(["evaluate", where, "--weights", file, "--count", "2"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["name"] for row in rows] == ["learned", "start", "open shutter"]
    assert rows[0] == rows[1] | {"name": "learned"}  # one step does not reach the code
    for row in rows:
        assert row["network_db"] == pytest.approx(row["as_taken_db"], abs=1.5)  # nor the network
        assert row["wiener_db"] > row["as_taken_db"] + 1  # it is told the motion
    assert [row["code"] for row in rows] == ["11010", "11010", "11111"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["train", "none", "-o", "run"], "none: must be a folder of photos"),
        (["train", "none", "-o", "run", "--start", "1020"], "bits: only 0 and 1"),
        (["train", "photos", "-o", "run", "--steps", "0"], "steps: must be at least 1, got 0"),
        (
            ["evaluate", "photos", "--weights", "w", "--count", "0"],
            "count: must be at least 1, got 0",
        ),
        (["evaluate", "photos", "--weights", "w"], "w: cannot be read as weights"),
        (["export", "none", "-o", "w"], "holds no checkpoint"),
        (["evaluate", "none", "--weights", "w"], "none: must be a folder of photos"),
    ],
)
def test_bad_input_ends_with_one_line(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "photos").mkdir()
    write_image("photos/a.png", np.full((200, 200, 3), 0.5))
    assert run(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert said in error
    assert error.count("\n") == 1


def test_dce_starts_from_its_published_code():
    assert Settings().start == START == "11110001110011010100010010001101"
