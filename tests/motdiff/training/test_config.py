"""A run's TOML file: what is left out has its default, and one line names the section and entry
that is wrong."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from motdiff.network.config import NetworkConfig
from motdiff.training.config import (
    DataConfig,
    LossConfig,
    OptimiserConfig,
    TrainingConfig,
    read_config,
)

SHIPPED = sorted((Path(__file__).parents[3] / "motdiff" / "configs").glob("*.toml"))


def read(tmp_path, text, *, data='photos = "photos"'):
    file = tmp_path / "run.toml"
    file.write_text(f"[data]\n{data}\n{text}\n", encoding="utf-8")
    return read_config(file)


def refused(tmp_path, text, **options):
    with pytest.raises(ValueError, match=r"run\.toml: ") as caught:
        read(tmp_path, text, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message.partition("run.toml: ")[2]


def test_the_mark_of_windows_editors_is_read_over(tmp_path):
    plain = read(tmp_path, "")
    file = tmp_path / "run.toml"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert read_config(file) == plain


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.name)
def test_a_shipped_configuration_reads(file):
    config = read_config(file)
    assert config.data.photos
    assert config.optimiser.steps > config.optimiser.warm_up


def test_there_are_shipped_configurations():
    assert "cpu.toml" in [file.name for file in SHIPPED]


def test_what_a_file_leaves_out_has_its_default(tmp_path):
    assert read(tmp_path, "") == TrainingConfig(DataConfig(photos="photos"))


def test_every_kind_of_entry_is_read(tmp_path):
    config = read(
        tmp_path,
        """
        [motions]
        exposure_s = [0.1, 0.2]
        [photography]
        borders = "symmetric"
        [network]
        decoder_widths = [16, 8]
        dwell = true
        [optimiser]
        rate = 2e-3
        steps = 7
        """,
    )
    assert config.motions.exposure_s == (0.1, 0.2)
    assert config.photography.borders == "symmetric"
    assert config.network == NetworkConfig(decoder_widths=(16, 8), dwell=True)
    assert config.optimiser == OptimiserConfig(rate=2e-3, steps=7)


def test_a_whole_number_stands_for_a_float(tmp_path):
    config = read(
        tmp_path,
        "[loss]\npath_weight = 3\n[photography]\nqualities = [50, 90]\n[motions]\ngyro = 0",
    )
    values = [config.loss.path_weight, *config.photography.qualities, config.motions.gyro]
    assert values == [3.0, 50.0, 90.0, 0.0]
    assert all(type(value) is float for value in values)


def test_a_configuration_is_json_and_back(tmp_path):
    config = read(
        tmp_path, "[network]\ndecoder_widths = [16, 8]\n[motions]\nexposure_s = [0.1, 0.2]"
    )
    back = json.loads(json.dumps(asdict(config), allow_nan=False))
    assert back["data"]["photos"] == "photos"
    assert back["motions"]["exposure_s"] == [0.1, 0.2]
    assert NetworkConfig.from_dict(back["network"]) == config.network
    assert OptimiserConfig(**back["optimiser"]) == config.optimiser
    assert LossConfig(**back["loss"]) == config.loss


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[optimizer]\nsteps = 3", "unknown section [optimizer]"),
        ("[optimiser]\nepochs = 3", "optimiser.epochs: is not known"),
        ("[motions]\nspiral = 1.0", "motions.spiral: is not known"),
        ("[network]\nlayers = 3", "network.layers: is not known"),
        # types
        ('[optimiser]\nsteps = "many"', "optimiser.steps: must be of type int"),
        ("[optimiser]\nsteps = 3.0", "optimiser.steps: must be of type int"),
        ("[optimiser]\nsteps = true", "optimiser.steps: must be of type int"),
        ("[optimiser]\nrate = true", "optimiser.rate: must be of type float"),
        ("[optimiser]\ncompile = 1", "optimiser.compile: must be of type bool"),
        ("[optimiser]\nrate = [1e-3]", "optimiser.rate: must be of type float"),
        ("[loss]\nkind = 3", "loss.kind: must be of type str"),
        ("[network]\ndwell = 1", "network.dwell: must be of type bool"),
        ("[motions]\ngyro_trace = 5", "motions.gyro_trace: must be of type str"),
        ("[photography]\ngammas = 2.2", "photography.gammas: must be a list of 2 numbers"),
        ("[photography]\ngammas = [2.2]", "photography.gammas: must be a list of 2 numbers"),
        (
            "[photography]\ngammas = [1.0, 2.0, 3.0]",
            "photography.gammas: must be a list of 2 numbers",
        ),
        ('[photography]\ngammas = ["low", "high"]', "photography.gammas: must be of type float"),
        ("[network]\ndecoder_widths = [16.0, 8.0]", "network.decoder_widths: must be of type int"),
        ("[motions]\nexposure_s = [0.1, true]", "motions.exposure_s: must be of type float"),
        # values
        ("[optimiser]\nsteps = 0", "optimiser.steps: must be at least 1"),
        ("[optimiser]\nbatch = -1", "optimiser.batch: must be at least 1"),
        ("[optimiser]\nrate = 0", "optimiser.rate: must be above 0"),
        ("[optimiser]\nrate = nan", "optimiser.rate: must be a finite number"),
        ("[optimiser]\nlast_rate = -1e-6", "optimiser.last_rate: must be at least 0"),
        ("[optimiser]\nwarm_up = -1", "optimiser.warm_up: must be at least 0"),
        ("[optimiser]\nema = 1.0", "optimiser.ema: must be at least 0 and below 1"),
        ("[optimiser]\nclip = 0", "optimiser.clip: must be above 0"),
        ('[optimiser]\nprecision = "fp64"', 'optimiser.precision: must be "fp32" or "bf16"'),
        ('[optimiser]\nonly = "encoder"', 'optimiser.only: must be "photo"'),
        ('[optimiser]\nonly = "photo"', "optimiser.only: needs weights to start from"),
        (
            (
                '[network]\nbackbone = "none"\nphysics_channels = 8\n[optimiser]\nonly ='
                ' "photo"\nstart = "w"'
            ),
            'optimiser.only: must be "" for a network without a photo encoder',
        ),
        ("[optimiser]\nwindow = 65", "optimiser.window: must lie within 8..64"),
        ("[optimiser]\nwindow = 7", "optimiser.window: must lie within 8..64"),
        ("[optimiser]\nseed = -1", "optimiser.seed: must lie within"),
        ("[optimiser]\nseed = 36893488147419103232", "optimiser.seed: must lie within"),
        ('[loss]\nkind = "focal"', 'loss.kind: must be "structure" or "denoising"'),
        ("[loss]\nstpd = 1.0", "loss.stpd: must be at least 0 and below 1"),
        ("[loss]\npath_weight = -1", "loss.path_weight: must be at least 0"),
        ("[loss]\niou = -0.1", "loss.iou: must be at least 0"),
        ("[loss]\ndwell = inf", "loss.dwell: must be a finite number"),
        ('[network]\nbackbone = "resnet"', "network.backbone is 'resnet'"),
        ("[network]\ndecoder_widths = [15, 8]", "network.decoder_widths[0] is 15"),
        (
            "[network]\ndenoiser_view = 1\n[optimiser]\nwindow = 32",
            "optimiser.window: must be 64 for a denoiser",
        ),
        ("[network]\nphoto_pool = 3", "network.photo_pool is 3"),
        ('[network]\nbackbone = "none"', "network.physics_channels is 0"),
        ("[motions]\ngyro = 0.5", "motions.gyro_trace: "),
        ("[motions]\nmin_length_px = 70", "motions.min_length_px: "),
        ("[motions]\nboracchi_foi = 0", "motions: the shares"),
        ('[photography]\nborders = "periodic"', "photography.borders: must be"),
        ("[photography]\nmost_noise = 1", "photography.most_noise: "),
    ],
)
def test_one_line_names_what_is_wrong(tmp_path, text, said):
    assert refused(tmp_path, text).startswith(said)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ("", "data: needs photos"),
        ("photos = 3", "data.photos: must be of type str"),
        ('photos = "p"\nheld_out = 1', "data.held_out: must be at least 2"),
        ('photos = "p"\nvalidation = 0', "data.validation: must be at least 1"),
        ('photos = "p"\nmotions = 0', "data.motions: must be at least 1"),
        (
            'photos = "p"\nphysics_dropout = 1',
            "data.physics_dropout: must be at least 0 and below 1",
        ),
        ('prepared = "p"', "data.prepared_validation: "),
    ],
)
def test_one_line_names_what_is_wrong_with_the_data(tmp_path, data, said):
    assert refused(tmp_path, "", data=data).startswith(said)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"[data\n", "not a TOML file"),
        (b"[data]\nphotos = 'p'\nphotos = 'q'\n", "not a TOML file"),
        (b"[data]\nphotos = '\xff'\n", "not a TOML file"),
        (b"", "needs a section [data]"),
        (b"steps = 3\n", "unknown section [steps]"),
        (b"data = 3\n", "data: must be a section"),
    ],
)
def test_a_broken_file_is_told_in_one_line(tmp_path, content, said):
    file = tmp_path / "run.toml"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"run\.toml: ") as caught:
        read_config(file)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_motions_may_be_drawn_anew_for_prepared_samples():
    data = DataConfig(photos="photos", prepared="p", prepared_validation="v", motions=0)
    config = TrainingConfig(data, network=NetworkConfig(backbone="none", physics_channels=8))
    assert replace(config, loss=LossConfig(kind="denoising")).data.motions == 0
