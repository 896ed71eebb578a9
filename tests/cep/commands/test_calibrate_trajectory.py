"""``cep calibrate --trajectory``, and ``cep deblur`` without a trajectory."""

import json
from pathlib import Path

import numpy as np
import pytest

from cep.files.code_files import StoredCode, write_code
from cep.files.images import read_image, write_image
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from motdiff.files.trajectories import StoredMotion, read_motion, write_motion
from motdiff.metrics import timed_distance_px
from motdiff.trajectory import Trajectory

PATH = Trajectory.from_samples([[0, 0], [5, 0], [9, 2], [11, 6], [11, 11]])
CODES = ("1101000101101110", "1111111100000000")


@pytest.fixture
def photos(tmp_path, monkeypatch):
    """Two photos of a scene along a bent path, through two codes, and the path."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    scene = 0.1 + 0.8 * np.kron(rng.random((22, 22)), np.ones((8, 8)))
    for name, code in zip(("one.png", "two.png"), CODES, strict=True):
        write_image(name, capture(scene, PATH, ShutterCode(code), rng=rng), bits=16)
    write_motion(
        "trajectory.json",
        StoredMotion(PATH, source={"method": "test", "path_uncertainty_px": 0.5}),
    )
    return tmp_path


@pytest.mark.slow(reason="two blind searches and fits from all orders")
def test_refine_writes_a_trajectory_that_says_how_sure_it_is(cep, photos):
    codes = ("--code", CODES[0], "--code", CODES[1])
    times = np.linspace(0, 1, 101)
    wave = np.stack([np.sin(2 * np.pi * times), np.cos(2 * np.pi * times)], axis=1)  # 1 px rms
    rough = Trajectory.from_samples(PATH.at(times) + wave, t=times)
    write_motion(
        "rough.json", StoredMotion(rough, source={"method": "test", "path_uncertainty_px": 1.0})
    )
    found = cep.succeeds(
        "calibrate",
        "one.png",
        "two.png",
        *codes,
        "--trajectory",
        "rough.json",
        "-o",
        "better.json",
    )
    assert {
        "trajectory",
        "kept",
        "confidence",
        "path_uncertainty_px",
        "direction",
        "seconds",
        "warnings",
    } <= set(found)
    stored = read_motion("better.json")
    assert stored.source["codes"] == list(CODES)
    assert stored.source["path_uncertainty_px"] == found["path_uncertainty_px"] < 1.0
    assert (found["kept"], found["confidence"]) == ("refined", None)
    assert stored.trajectory.direction == found["direction"] == "known"
    assert timed_distance_px(stored.trajectory, PATH) < 0.4 < timed_distance_px(rough, PATH)


def test_deblur_without_a_trajectory_says_first_what_was_restored(cep, photos):
    cep("deblur", "one.png", "--code", CODES[0])
    assert cep.code == 0
    assert cep.out.startswith("one_sharp.png: restored with the PSF found in this photo alone")
    assert read_image("one_sharp.png").shape == read_image("one.png").shape


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["one.png", "--code", CODES[0], "--trajectory", "trajectory.json", "--method", "pmp"],
            ["--method: not valid with --trajectory"],
        ),
        (["one.png", "--trajectory", "trajectory.json"], ["--code", "needed"]),
        (
            ["one.png", "two.png", "--code", CODES[0], "--trajectory", "trajectory.json"],
            ["--code", "1 for 2 photos"],
        ),
        (["one.png", "--code", CODES[0], "--trajectory", "missing.json"], ["missing.json"]),
        (["missing.png", "--code", CODES[0], "--trajectory", "trajectory.json"], ["missing.png"]),
        (
            ["flat.png", "--code", CODES[0], "--trajectory", "trajectory.json"],
            ["cep: flat.png: is the same all over"],
        ),
        (
            [
                "one.png",
                "flat.png",
                "--code",
                CODES[0],
                "--code",
                CODES[1],
                "--trajectory",
                "trajectory.json",
            ],
            ["cep: flat.png: is the same all over"],
        ),
        (
            [
                "one.png",
                "two.png",
                "--code",
                "code.json",
                "--code",
                "slow.json",
                "--trajectory",
                "trajectory.json",
            ],
            ["code 2: its chips last 500000 ns"],
        ),
        (
            [
                "one.png",
                "--code",
                "slow.json",
                "--trajectory",
                "trajectory.json",
                "--force",
                "-o",
                "slow.json",
            ],
            ["slow.json: is what is read"],
        ),
        (
            ["one.png", "--code", "open", "--trajectory", "trajectory.json"],
            ["order cannot be known"],
        ),
        (
            ["one.png", "--code", CODES[0], "--trajectory", "trajectory.json", "-o", "one.png"],
            ["one.png", "is what is"],
        ),
        (
            ["one.png", "--code", CODES[0], "--trajectory", "odd.json"],
            ["odd.json", "path_uncertainty_px"],
        ),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(cep, photos, arguments, words):
    write_image("flat.png", np.full((80, 80), 0.4))
    write_code("code.json", StoredCode(ShutterCode(CODES[0], 250_000)))
    write_code("slow.json", StoredCode(ShutterCode(CODES[1], 500_000)))
    odd = json.loads(Path("trajectory.json").read_text())
    odd["source"]["path_uncertainty_px"] = "much"
    Path("odd.json").write_text(json.dumps(odd))
    before = sorted(photos.rglob("*"))
    line = cep.refuses("calibrate", *arguments)
    assert all(word in line for word in words), line
    assert sorted(photos.rglob("*")) == before


@pytest.mark.parametrize(
    ("photo", "words"), [("small.png", "at least 48 x 48 px"), ("flat.png", "the same all over")]
)
def test_a_photo_that_shows_no_motion_is_refused_before_the_search(cep, photos, photo, words):
    write_image("small.png", np.random.default_rng(0).random((40, 60)))
    write_image("flat.png", np.full((80, 80), 0.4))
    line = cep.refuses("deblur", photo, "--code", CODES[0])
    assert line.startswith(f"cep: {photo}: ")
    assert words in line
