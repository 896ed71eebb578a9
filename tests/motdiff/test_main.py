"""``python -m motdiff``: the whole way from photos to weights, and one line and exit code 2 for
what can be mended."""

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from lab.evaluation.methods import named_estimators
from motdiff.__main__ import run
from motdiff.blind_search.coarse_to_fine import Start
from motdiff.network.physics_maps import quick_kernels
from motdiff.training import prepared as prepared_module
from motdiff.training import samples as samples_module
from motdiff.training.checkpoint import read_checkpoint
from motdiff.training.config import read_config
from motdiff.training.log import read_log
from motdiff.weights import load_network, read_network_card

ROOT = Path(__file__).resolve().parents[2]
PHYSICS = """
[motions]
max_length_px = 12
[network]
backbone = "none"
physics_channels = 8
physics_width = 8
physics_depth = 1
physics_patch = 2
denoiser_width = 8
decoder_widths = [8, 4]
time_width = 16
[optimiser]
steps = 2
batch = 2
window = 8
"""
LIVE = """
[data]
photos = "photos"
held_out = 2
motions = 3
validation = 1
[motions]
max_length_px = 12
[network]
features = "f2"
width = 8
denoiser_width = 8
decoder_widths = [8, 4]
[optimiser]
steps = 1
batch = 1
window = 8
"""
PREPARED = (
    '[data]\nphotos = "photos.zip"\nheld_out = 2\nprepared = "seen"\nprepared_validation ='
    ' "unseen"\n' + PHYSICS
)


@pytest.fixture(autouse=True)
def small_world(tmp_path, monkeypatch):
    """Run in a folder of its own, in this process, with searches and shards that take no time."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    starts = tuple(Start(size, 1.0) for size in (9, 11, 13))
    monkeypatch.setattr(
        samples_module, "quick_kernels", partial(quick_kernels, starts=starts, iterations=1)
    )
    monkeypatch.setattr(prepared_module, "SHARD_SAMPLES", 2)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    monkeypatch.chdir(tmp_path)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def photos(tmp_path):
    rng = np.random.default_rng(0)
    (tmp_path / "photos").mkdir()
    for i in range(4):
        blocks = rng.integers(0, 256, (34, 33, 3)).astype(np.uint8).repeat(10, 0).repeat(10, 1)
        cv2.imwrite(str(tmp_path / "photos" / f"photo{i}.png"), blocks)


@pytest.fixture
def motdiff(capsys):
    """Run a command; its exit code and what it printed."""

    def call(*arguments):
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        told = capsys.readouterr()
        assert told.out == ""
        return code, told.err

    return call


def write(name, text):
    Path(name).write_text(text)
    return name


def assert_mendable(outcome, said):
    code, told = outcome
    assert code == 2, told
    (line,) = told.splitlines()
    assert line.startswith("error: ")
    assert re.search(said, line), line


# ---- the whole way


def test_from_photos_to_weights(photos, motdiff):
    code, told = motdiff("pack", "photos", "photos.zip", "--side", 330, "--quality", 80)
    assert code == 0
    assert re.fullmatch(r"photos\.zip: \d+\.\d MiB\n", told)
    assert len(zipfile.ZipFile("photos.zip").namelist()) == 4
    write("run.toml", PREPARED)
    code, told = motdiff("prepare", "run.toml", "-o", "seen", "--shards", "0:3:2")
    assert code == 0
    assert told.splitlines()[-1].startswith("shard 2 of 3")
    assert motdiff("prepare", "run.toml", "-o", "unseen", "--shards", "0:1", "--held-out")[0] == 0
    assert sorted(path.name for path in Path("seen").iterdir()) == [
        "shard_00000.npz",
        "shard_00002.npz",
    ]
    code, told = motdiff("train", "run.toml", "-o", "run", "--device", "cpu", "--minutes", 0)
    assert code == 0
    assert "new run, from step 0 of 2" in told
    code, told = motdiff("train", "run.toml", "-o", "run", "--device", "cpu")
    assert code == 0
    assert "resumed at step 1 of 2" in told
    assert read_checkpoint("run/checkpoint").step == 2
    assert 0 <= read_log("run/log.csv")[-1]["validation_mnc"] <= 1
    code, told = motdiff("export", "run", "-o", "weights.safetensors")
    assert code == 0
    score = read_log("run/log.csv")[-1]["validation_mnc"]
    assert re.fullmatch(
        r"weights\.safetensors: [\d.]+ MiB; 4 samples in 0\.0 h, 1 run, validation MNC"
        rf" {score:.3f}\n",
        told,
    )
    assert read_network_card("weights.safetensors")["run"]["steps"] == 2
    assert load_network("weights.safetensors").config.physics_channels == 8


def test_training_on_simulated_photos(photos, motdiff):
    code, told = motdiff(
        "train", write("run.toml", LIVE), "-o", "run", "--device", "cpu", "--validate-every", 1
    )
    assert code == 0, told
    assert {path.name for path in Path("run").iterdir()} == {
        "checkpoint",
        "log.csv",
        "progress.png",
    }


def small(name, **changes):
    """Text of a shipped configuration with changed entries: every key and value that stays is the
    shipped one."""
    table = tomllib.loads(
        (ROOT / "motdiff" / "configs" / f"{name}.toml").read_text(encoding="utf-8")
    )
    for section, entries in changes.items():
        table[section] |= entries
    return "".join(
        f"[{section}]\n"
        + "".join(f"{key} = {json.dumps(value)}\n" for key, value in entries.items())
        for section, entries in table.items()
    )


def first_minute(motdiff, text):
    """Weights of a run: photos packed, trained in two pieces, exported."""
    assert motdiff("pack", "photos", "photos.zip", "--side", 400, "--quality", 88)[0] == 0
    train = ("train", write("run.toml", text), "-o", "run", "--device", "cpu", "--minutes", 0)
    for steps in (1, 2):
        code, told = motdiff(*train)
        assert code == 0, told
        assert read_checkpoint("run/checkpoint").step == steps
    assert "resumed at step 1 of 2" in told
    assert 0 <= read_log("run/log.csv")[-1]["validation_mnc"] <= 1
    assert motdiff("export", "run", "-o", "w.safetensors", "--offset", 1.8)[0] == 0
    network = load_network("w.safetensors")
    assert network.config == read_config("run.toml").network
    assert network.config.backbone == "b0"
    return network


SMALL = {
    "data": {"photos": "photos.zip", "motions": 8, "held_out": 2, "validation": 1},
    "network": {
        "width": 8,
        "physics_width": 8,
        "denoiser_width": 8,
        "decoder_widths": [8, 4],
        "time_width": 16,
    },
    "optimiser": {"steps": 2, "batch": 2, "warm_up": 1},
}


def test_the_papers_first_minute_on_a_gpu(photos, motdiff):
    network = first_minute(motdiff, small("paper", **SMALL))
    assert network.physics is None


@pytest.mark.slow(reason="a training with classical searches")
def test_a_gpus_first_minute(photos, motdiff):
    """gpu.toml in small sizes, from photos to a sheet of draws and an estimate with the exported
    weights."""
    shakes = np.cumsum(np.random.default_rng(0).standard_normal((1500, 3)), axis=0)
    rows = [
        f"{i / 200},{x},{y},{z}"
        for i, (x, y, z) in enumerate(0.01 * (shakes - shakes.mean(axis=0)))
    ]
    trace = write("gyro.csv", "\n".join(["t_s,x,y,z", *rows]))
    network = first_minute(motdiff, small("gpu", **SMALL, motions={"gyro_trace": trace}))
    assert network.config.denoiser_view == 2
    photo = cv2.imread("photos/photo0.png")[:256, :256]
    cv2.imwrite("blurred.png", photo)
    sample = (
        "sample",
        "blurred.png",
        "-o",
        "o.png",
        "--weights",
        "w.safetensors",
        "--count",
        2,
        "--steps",
        2,
    )
    assert motdiff(*sample)[0] == 0
    height, width = cv2.imread("o.png").shape[:2]
    assert width > 4 * height  # a row of the photo, three kernels and two draws, under titles
    (estimator,) = named_estimators(["network@w.safetensors"]).values()
    assert estimator.estimate(photo[:96, :96] / 255).psf.sum() == pytest.approx(1)


def test_held_out_samples_are_of_other_photos(photos, motdiff, monkeypatch):
    used = []
    monkeypatch.setattr(
        prepared_module,
        "prepare",
        lambda _folder, source, *, shards, **_: used.append((source, shards)),
    )
    write("run.toml", PREPARED)
    motdiff("pack", "photos", "photos.zip")
    for extra in ([], ["--held-out"]):
        assert motdiff("prepare", "run.toml", "-o", "samples", "--shards", "2:9:3", *extra)[0] == 0
    (training, shards), (held_out, _) = used
    assert [len(source.scenes) for source in (training, held_out)] == [2, 2]
    assert not any(torch.equal(a, b) for a in training.scenes for b in held_out.scenes)
    assert training.seed != held_out.seed
    assert shards == range(2, 9, 3)


def test_it_is_a_module_with_help():
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    shown = subprocess.run(
        [sys.executable, "-m", "motdiff", "--help"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    for command in ("train", "prepare", "pack", "export"):
        assert command in shown.stdout


def test_help_needs_no_torch():
    code = (
        "import sys; from motdiff.__main__ import run\ntry: run(['train', '--help'])\nexcept"
        " SystemExit: pass\n"
    )
    code += "print('torch' in sys.modules, file=sys.stderr)"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stderr.strip() == "False"


# ---- what can be mended: one line, exit code 2

CONFIGS = {
    "broken TOML": ("[data\n", "run.toml: not a TOML file"),
    "no data": ("", r"needs a section \[data\]"),
    "unknown entry": (
        '[data]\nphotos = "photos"\n[optimiser]\nepochs = 3\n',
        r"optimiser\.epochs: is not known",
    ),
    "wrong type": (
        '[data]\nphotos = "photos"\n[optimiser]\nsteps = "3"\n',
        r"optimiser\.steps: must be of type int",
    ),
    "wrong value": (
        '[data]\nphotos = "photos"\n[network]\nbackbone = "b9"\n',
        r"network\.backbone is 'b9'",
    ),
    "no such photos": (
        LIVE.replace('"photos"', '"nowhere"'),
        r"run\.toml: data\.photos: there is no 'nowhere' here; .*BSDS500$",
    ),
    "no such pack": (
        LIVE.replace('"photos"', '"photos.zip"'),
        r"run\.toml: data\.photos: there is no 'photos\.zip' here",
    ),
    "an empty folder": (
        LIVE.replace('"photos"', '"empty"'),
        r"run\.toml: data\.photos: empty: holds no photo",
    ),
    "too few photos": (
        LIVE.replace("held_out = 2", "held_out = 99"),
        r"run\.toml: data\.held_out: must lie within",
    ),
    "no such samples": (PREPARED, r"run\.toml: data\.prepared: seen: holds no prepared samples"),
    "no such recording": (
        LIVE.replace("max_length_px = 12", 'gyro = 1.0\ngyro_trace = "gyro.txt"'),
        r"run\.toml: motions\.gyro_trace: there is no 'gyro\.txt' here; .*motions\.gyro = 0$",
    ),
    "physics maps that are not there": (
        LIVE.replace("[network]", "[network]\nphysics_channels = 3"),
        r"run\.toml: network\.physics_channels: must be 8",
    ),
}


@pytest.mark.parametrize("case", CONFIGS)
def test_a_configuration_that_can_be_mended(case, photos, motdiff):
    text, said = CONFIGS[case]
    Path("empty").mkdir()
    outcome = motdiff("train", write("run.toml", text), "-o", "run", "--device", "cpu")
    lines = [
        line for line in outcome[1].splitlines(keepends=True) if not line.startswith("new run")
    ]
    assert_mendable((outcome[0], "".join(lines)), said)
    assert not Path("run/checkpoint").exists()


@pytest.mark.parametrize(
    "case", ["no such photos", "an empty folder", "too few photos", "no such recording"]
)
def test_preparing_names_the_entry_and_its_file_too(case, photos, motdiff):
    text, said = CONFIGS[case]
    Path("empty").mkdir()
    assert_mendable(motdiff("prepare", write("run.toml", text), "-o", "samples"), said)
    assert not Path("samples").exists() or not list(Path("samples").iterdir())


@pytest.mark.parametrize(
    "shards", ["five", "0", "1:2:3:4", "0:9:0", "1.5:3", "", ":3", "3:3", "5:2", "0:-4"]
)
def test_shards_that_are_no_range(shards, motdiff):
    write("run.toml", PREPARED)
    assert_mendable(
        motdiff("prepare", "run.toml", "-o", "seen", "--shards", shards), f"--shards: .*'{shards}'"
    )
    assert not Path("seen").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["train", "none.toml", "-o", "run"], r"none\.toml: No such file or directory$"),
        (["train", ".", "-o", "run"], r"error: \.: is a folder, a regular file is needed$"),
        (["prepare", "none.toml", "-o", "seen"], r"none\.toml"),
        (["prepare", "no_photos.toml", "-o", "seen"], "data.photos is needed"),
        (["pack", "nowhere", "photos.zip"], "nowhere: must be a folder"),
        (["pack", "empty", "photos.zip"], "empty: holds no photo"),
        (["pack", "photos", "no/such/folder/photos.zip"], r"photos\.zip: there is no folder"),
        (["export", "nowhere", "-o", "w.safetensors"], "holds no checkpoint"),
        (["train", "run.toml", "-o", "run", "--minutes", "-1"], "minutes: must be at least 0"),
        (
            ["train", "run.toml", "-o", "run", "--validate-every", "0"],
            "validate_steps: must be at least 1",
        ),
        (["train", "run.toml", "-o", "run", "--save-every", "nan"], "save_s: must be at least 0"),
        (["train", "run.toml", "-o", "photos/photo0.png", "--device", "cpu"], "photo0.png"),
        (["train", "run.toml", "-o", "run", "--device", "tpu"], "--device: must be cpu, cuda"),
        (["train", "run.toml", "-o", "run", "--device", "cuda:x"], "--device: must be cpu, cuda"),
        (
            ["train", "run.toml", "-o", "run", "--device", "cuda:99"],
            "--device: there is no GPU cuda:99",
        ),
        (["sample", "none.png", "-o", "o.png"], r"none\.png: No such file or directory$"),
        (["sample", "photos", "-o", "o.png"], "photos: is a folder, a regular file is needed$"),
        (["sample", "empty.png", "-o", "o.png"], r"empty\.png: the file is empty"),
        (["sample", "run.toml", "-o", "o.png"], r"run\.toml: not a PNG, JPEG, TIFF or WebP image"),
        (
            ["export", "nowhere", "-o", "w.safetensors", "--card", "run.toml"],
            r"run\.toml: not a JSON file",
        ),
    ],
)
def test_arguments_that_can_be_mended(arguments, said, photos, motdiff):
    Path("empty").mkdir()
    Path("empty.png").touch()
    write("run.toml", LIVE)
    write("no_photos.toml", PREPARED.replace('photos = "photos.zip"', ""))
    assert_mendable(motdiff(*arguments), said)


def test_a_missing_gpu_is_told(motdiff, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    write("run.toml", LIVE)
    assert_mendable(
        motdiff("train", "run.toml", "-o", "run", "--device", "cuda"),
        "no GPU cuda:0 here, use --device cpu",
    )


@pytest.mark.parametrize(
    ("wanted", "rank", "name"),
    [
        ("", "0", "cuda:0"),
        ("cuda", "0", "cuda:0"),
        ("cuda", "1", "cuda:1"),
        ("cuda:1", "0", "cuda:1"),
        ("cpu", "0", "cpu"),
    ],
)
def test_each_process_takes_its_own_gpu(wanted, rank, name, photos, motdiff, monkeypatch):
    taken = []
    devices = []
    monkeypatch.setenv("LOCAL_RANK", rank)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "set_device", taken.append)
    monkeypatch.setattr(
        "motdiff.training.run_piece.train", lambda *_, device, **__: devices.append(device)
    )
    assert motdiff("train", write("run.toml", LIVE), "-o", "run", "--device", wanted)[0] == 0
    assert devices == [name]
    assert taken == ([] if name == "cpu" else [name])


def test_a_run_of_another_network_is_left_alone(photos, motdiff):
    assert motdiff("train", write("run.toml", LIVE), "-o", "run", "--device", "cpu")[0] == 0
    other = write("other.toml", LIVE.replace("denoiser_width = 8", "denoiser_width = 16"))
    assert_mendable(
        motdiff("train", other, "-o", "run", "--device", "cpu"), "network of another configuration"
    )
    assert read_checkpoint("run/checkpoint").config["network"]["denoiser_width"] == 8


@pytest.mark.parametrize(
    ("arguments", "helper"),
    [
        ([], "motdiff"),
        (["paint"], "motdiff"),
        (["train"], "motdiff train"),
        (["train", "run.toml"], "motdiff train"),
        (["pack", "photos"], "motdiff pack"),
    ],
)
def test_a_wrong_command_line_is_told_in_one_line(arguments, helper, capsys):
    with pytest.raises(SystemExit) as caught:
        run(arguments)
    assert_mendable(
        (caught.value.code, capsys.readouterr().err), rf"\(see python -m {helper} --help\)$"
    )


# ---- failures and Ctrl-C


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (ValueError("steps: wrong\nand more"), 2, "steps: wrong"),
        (ValueError(), 2, "ValueError"),
        (OSError(28, "No space left on device", "run"), 1, "run: No space left on device"),
        (FloatingPointError("the loss became nan"), 1, "the loss became nan"),
        (KeyboardInterrupt(), 130, "stopped"),
    ],
)
def test_each_end_has_its_exit_code(error, code, line, motdiff, monkeypatch):
    def failing(*_arguments, **_options):
        raise error

    monkeypatch.setattr("motdiff.training.photos.pack_photos", failing)
    assert motdiff("pack", "photos", "photos.zip") == (code, f"error: {line}\n")


def test_a_loss_that_is_not_finite_is_a_failure(photos, motdiff, monkeypatch):
    monkeypatch.setattr(
        "motdiff.training.trainer.loss_of",
        lambda *_, **__: (torch.tensor(float("nan"), requires_grad=True),) * 2,
    )
    code, told = motdiff("train", write("run.toml", LIVE), "-o", "run", "--device", "cpu")
    assert code == 1
    assert told.splitlines()[-1] == "error: the loss became nan at step 1; lower optimiser.rate"
    assert not Path("run/checkpoint").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("pack", "none", "OUT.zip"),
        ("export", "none", "-o", "OUT.safetensors"),
        ("sample", "none.png", "-o", "OUT.png"),
        ("prepare", "none.toml", "-o", "OUT"),
        ("train", "run.toml", "-o", "OUT"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_outputs_that_cannot_be_written_are_told_before_inputs_are_read(motdiff, arguments):
    write("run.toml", LIVE)  # its photos do not exist
    write("file", "precious")
    files = arguments[0] in ("pack", "export", "sample")
    for place in ("file/out", "nowhere/out") if files else ("file/out", "file"):
        said = "nowhere" if place == "nowhere/out" else "file"
        assert_mendable(
            motdiff(*(part.replace("OUT", place) for part in arguments)), rf"error: {said}\b.*"
        )
    assert sorted(path.name for path in Path().iterdir()) == ["file", "run.toml"]
    assert Path("file").read_text() == "precious"
