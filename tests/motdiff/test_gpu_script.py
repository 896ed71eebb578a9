"""``motdiff/configs/gpu.sh``: from photos to weights in pieces, rehearsed on the CPU."""

import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from lab.evaluation.methods import named_estimators
from motdiff.training.checkpoint import read_checkpoint
from motdiff.training.log import last_validation
from motdiff.weights import load_network

SCRIPT = Path(__file__).resolve().parents[2] / "motdiff" / "configs" / "gpu.sh"


def gpu_sh(*arguments, **settings):
    """Run the script in this Python; its exit code and what it told on both streams."""
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "CUDA_VISIBLE_DEVICES": "",
    }
    done = subprocess.run(
        ["bash", SCRIPT, *map(str, arguments)],
        env=environment | settings,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.slow(reason="three trainings in processes of their own, with classical searches")
def test_a_rehearsal_in_two_calls_ends_with_weights_that_estimate(tmp_path):
    code, _, told = gpu_sh("--rehearse", tmp_path, CALLS="1", MINUTES="0.15")
    assert code == 0, told
    assert re.search(r"step \d+: validation MNC 0\.\d", told)
    first = read_checkpoint(tmp_path / "run" / "checkpoint").step
    packed = (tmp_path / "photos.zip").stat()
    code, _, told = gpu_sh("--rehearse", tmp_path, CALLS="1")
    assert code == 0, told
    assert told.startswith(f"resumed at step {first} of ")
    assert (tmp_path / "photos.zip").stat() == packed
    assert read_checkpoint(tmp_path / "run" / "checkpoint").step > first
    assert 0 <= last_validation(tmp_path / "run" / "log.csv") <= 1
    code, said, told = gpu_sh("--rehearse", tmp_path, CALLS="0")
    assert (code, told) == (0, "")  # nothing to do
    assert re.search(r"step \d+ of \d+; weights.safetensors ", said)

    weights = tmp_path / "weights.safetensors"
    pieces = sorted(tmp_path.glob("weights.safetensors.*"))
    assert len(pieces) > 1
    assert b"".join(piece.read_bytes() for piece in pieces) == weights.read_bytes()
    assert load_network(weights).config.denoiser_view == 2
    photo = cv2.imread(str(tmp_path / "photos" / "astronaut.png"))[:96, :96] / 255
    (estimator,) = named_estimators([f"network@{weights}"]).values()
    estimate = estimator.estimate(photo)
    assert estimate.psf.sum() == pytest.approx(1)


def test_a_pack_that_does_not_travel_is_refused(tmp_path):
    with (tmp_path / "photos.zip").open("wb") as pack:
        pack.truncate(40_000_001)
    code, _, told = gpu_sh("photos", __file__, tmp_path)
    assert code == 2
    assert re.fullmatch("error: photos: must have at most 40000000 bytes .* 40000001.*\n", told)
    assert not (tmp_path / "photos.zip").exists()


@pytest.mark.parametrize(
    ("arguments", "settings", "named"),
    [
        ((), {}, "PHOTOS GYRO OUT"),
        (("photos", "no_such_file", "out"), {}, "no_such_file"),
        (("photos", __file__, "out"), {"MINUTES": "nine"}, "MINUTES"),
        (("photos", __file__, "out"), {"CALLS": "-1"}, "CALLS"),
    ],
)
def test_what_can_be_mended_is_one_line(arguments, settings, named):
    code, _, told = gpu_sh(*arguments, **settings)
    assert code == 2
    assert re.fullmatch(f"error: .*{named}.*\n", told)
