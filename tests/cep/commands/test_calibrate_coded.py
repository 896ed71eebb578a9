"""``cep calibrate P1 P2 --code C1 --code C2``: photos of one motion through known codes."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from cep.calibration.calibrate import Calibration
from cep.files.code_files import StoredCode, read_code, write_code
from cep.files.images import write_image
from cep.optics.capture import capture
from cep.optics.code import ShutterCode
from motdiff.estimators.base import MotionEstimate
from motdiff.files.trajectories import read_motion
from motdiff.trajectory import Trajectory

PATH = Trajectory.from_samples([[0, 0], [5, 0], [9, 2], [11, 6], [11, 11]])
CODES = ("1111111111111111", "1101000101101110")
SCENE = 0.1 + 0.8 * np.kron(np.random.default_rng(3).random((24, 24)), np.ones((8, 8)))


@pytest.fixture
def photos(tmp_path, monkeypatch):
    """Two photos of a scene along a bent path, open and coded."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    for name, code in zip(("open.png", "coded.png"), CODES, strict=True):
        write_image(name, capture(SCENE, PATH, ShutterCode(code), rng=rng), bits=16)
    return tmp_path


@pytest.mark.slow(reason="a blind search, and two with a fit")
def test_the_code_of_the_next_photo_is_chosen_and_tells_the_order(cep, photos, short_search):
    first = cep.succeeds(
        "calibrate", "open.png", "--next", "next.json", "--chips", "16", "-o", "motion"
    )
    code = read_code("next.json").code
    assert first["next"]["bits"] == code.bits
    assert len(code.bits) == 16
    write_image("second.png", capture(SCENE, PATH, code, rng=np.random.default_rng(4)), bits=16)
    two = ("open.png", "second.png", "--code", "open", "--code", "next.json")
    second = cep.succeeds(
        "calibrate", *two, "--next", "third.json", "--sure", "0.01", "-o", "motion_2"
    )
    assert second["next"] is None
    assert not Path("third.json").exists()
    assert second["direction"] == "known"
    assert 0 < second["order_confidence"] < 1
    motion = read_motion(second["trajectory"])
    times = np.linspace(0, 1, 101)
    apart = [
        path.at(times) - PATH.at(times)
        for path in (motion.trajectory, motion.trajectory.reversed())
    ]
    forward, backward = (np.sqrt(((d - d.mean(axis=0)) ** 2).sum(axis=1).mean()) for d in apart)
    assert forward < 1 < backward
    assert motion.source["codes"] == ["1" * 16, code.bits]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sure", "0.9"], "--sure: is for --next FILE, the code of the next photo"),
        (
            ["coded.png", "--next", "n.json"],
            "--next: needs the code of each photo, as --code open for the first one",
        ),
        (
            ["coded.png", "--code", CODES[1], "--code", "open", "--next", "n.json"],
            "--next: begins with a photo through an open shutter (--code open), got --code"
            f" {CODES[1]}",
        ),
        (["--next", "n.json", "--sure", "0.98"], "Invalid value for '--sure'"),
        (
            ["--next", "n.json", "--device", "mechanical", "--chip-ns", "10"],
            "mechanical",
        ),
        (
            [
                "coded.png",
                *("--method", "point", "--code", "open", "--code", CODES[1], "--next", "n.json"),
            ],
            "--next: is for photos of a scene; a light's trail through one code has an order",
        ),
        (
            ["--method", "gyro", "--next", "n.json"],
            "--next: needs --method motdiff or pmp for the first photo, and --code after it",
        ),
        (
            [
                "coded.png",
                "--code",
                "open",
                "--code",
                CODES[1],
                "--chips",
                "8",
                "--next",
                "n.json",
            ],
            "--chips: the codes given say it",
        ),
    ],
)
def test_options_of_the_next_code_that_do_not_fit_are_refused(cep, photos, arguments, message):
    assert message in cep.refuses("calibrate", "open.png", *arguments)
    assert not Path("n.json").exists()
    assert not Path("open_motion").exists()


@pytest.fixture
def known_motion(monkeypatch):
    """Estimates are the true motion, its order stated with the probability that is set here."""
    stated = {"probability": 0.5}

    def estimate(photos, **_options):
        details = {"order_confidence": stated["probability"], "path_uncertainty_px": 0.1}
        motion = MotionEstimate(
            "coded", (PATH,), (1.0,), PATH.psf(64), stated["probability"], details=details
        )
        return Calibration.of(motion, np.asarray(photos[0]))

    monkeypatch.setattr("cep.calibration.calibrate.estimate_motion", estimate)
    return stated


def test_the_command_after_the_next_photo_keeps_what_was_asked_for(cep, photos, known_motion):
    options = ("--device", "flc", "--sure", "0.9", "--gamma", "linear", "--seed", "3")
    cep("calibrate", "open.png", "--next", "a code.json", *options, "--chips", "16")
    assert cep.code == 0
    (line,) = (line for line in cep.out.splitlines() if line.startswith("then: "))
    words = shlex.split(line.removeprefix("then: "))
    second = capture(SCENE, PATH, read_code("a code.json").code, rng=np.random.default_rng(4))
    write_image("p2.png", second, bits=16)
    words[words.index("P2")] = "p2.png"
    cep(*words[1:])
    assert cep.code == 0, cep.err
    (line,) = (line for line in cep.out.splitlines() if line.startswith("then: "))
    again = shlex.split(line.removeprefix("then: "))
    for flag, value in zip(options[::2], options[1::2], strict=True):
        assert again[again.index(flag) + 1] == value


def test_once_the_order_is_sure_the_commands_that_follow_run(cep, photos, known_motion):
    known_motion["probability"] = 0.97
    two = ("open.png", "coded.png", "--code", "open", "--code", CODES[1])
    more = ("--gamma", "linear", "--device", "flc")
    cep("calibrate", *two, "--next", "next.json", "-o", "a motion", *more)
    assert cep.out.startswith("Take no other photo: "), cep.err
    assert not Path("next.json").exists()
    commands = [shlex.split(line)[1:] for line in cep.out.splitlines()[1:3]]
    trajectory = ["--trajectory", "a motion/trajectory.json"]
    timed = ["--chips", "16", "--exposure", "16ms", "--device", "flc"]
    assert commands[0] == ["cep", "optimize", *trajectory, *timed]
    assert commands[1][-2:] == ["--gamma", "linear"]
    assert Path(trajectory[1]).exists()
    assert cep(*commands[1][1:]).code == 0, cep.err


def test_a_code_that_cannot_be_chosen_does_not_cost_the_motion(
    cep, photos, known_motion, monkeypatch
):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("cep.calibration.next_code.next_code", interrupted)
    cep("calibrate", "open.png", "--next", "next.json", "-o", "motion")
    assert cep.code == 130
    assert read_motion("motion/trajectory.json").trajectory.length_px == pytest.approx(
        PATH.length_px
    )


@pytest.mark.slow(reason="the fit of a trail")
def test_a_small_light_s_trail_has_its_order_in_time(cep, tmp_path, monkeypatch, short_search):
    monkeypatch.chdir(tmp_path)
    code = "1011011101011110110101110011"
    angle = np.linspace(0, 2, 100)
    arc = Trajectory.from_samples(15 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    chips = arc.slice_psfs(np.linspace(0, 1, len(code) + 1), 65)
    trail = ndimage.gaussian_filter(chips[np.array(list(code)) == "1"].sum(axis=0), 0.6)
    light = (
        0.03
        + 0.8 * trail / trail.max()
        + 0.003 * np.random.default_rng(0).standard_normal(trail.shape)
    )
    write_image("light.png", np.clip(light, 0, 1), bits=16)
    found = cep.succeeds(
        "calibrate", "light.png", "--method", "point", "--code", code, "-o", "motion"
    )
    assert (found["method"], found["direction"]) == ("point", "known")
    assert 0 < found["path_uncertainty_px"] < 1
    times = np.linspace(0, 1, 101)
    path = read_motion(found["trajectory"]).trajectory
    apart = [one.at(times) - arc.at(times) for one in (path, path.reversed())]
    forward, backward = (np.sqrt(((d - d.mean(axis=0)) ** 2).sum(axis=1).mean()) for d in apart)
    assert forward < 1 < backward


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["open.png", "coded.png", "--code", "open"], ["--code", "1 for 2 photos"]),
        (["open.png", "coded.png", "--code", "open", "--code", "open"], ["order cannot be known"]),
        (
            ["open.png", "coded.png", "--code", "1101", "--code", CODES[1]],
            ["--code 2", "16 chips", "4"],
        ),
        (["open.png", "coded.png", "--code", "open", "--code", "0" * 16], ["open"]),
        (["open.png", "coded.png", "--code", "open", "--code", "nothing"], ["nothing", "no code"]),
        (
            ["open.png", "small.png", "--code", "open", "--code", CODES[1]],
            ["cep: small.png: ", "px"],
        ),
        (["open.png", "missing.png", "--code", "open", "--code", CODES[1]], ["missing.png"]),
        (["coded.png", "--code", CODES[1], "--method", "pmp"], ["code", "pmp"]),
        (["coded.png", "--code", CODES[1], "--method", "motdiff"], ["code", "motdiff"]),
        (
            ["open.png", "coded.png", "--code", "slow.json", "--code", "fast.json"],
            ["--code 2", "500000", "250000"],
        ),
        (["coded.png", "--method", "coded"], ["code", "needed"]),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(cep, photos, arguments, words):
    write_image("small.png", np.random.default_rng(0).random((100, 90)))
    for name, code, chip_ns in (
        ("slow.json", CODES[0], 500_000),
        ("fast.json", CODES[1], 250_000),
    ):
        write_code(name, StoredCode(ShutterCode(code, chip_ns)))
    before = sorted(photos.rglob("*"))
    line = cep.refuses("calibrate", *arguments)
    assert all(word in line for word in words), line
    assert sorted(photos.rglob("*")) == before
