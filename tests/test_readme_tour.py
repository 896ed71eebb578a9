"""The commands of the README, the tour and the how-tos, run one by one on photos made here."""

import json
import shlex
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from documented_commands import command_line, commands_in, lines_of
from skimage import data

import cep
from cep.commands.main import main
from cep.files.code_files import StoredCode, write_code
from cep.studio.state import read_setting
from cep.studio.views import Views
from motdiff.__main__ import run as motdiff
from motdiff.files.trajectories import StoredMotion, write_motion

ROOT = Path(__file__).resolve().parent.parent
PAGES = [
    ROOT / "README.md",
    ROOT / "docs" / "tour.md",
    *sorted((ROOT / "docs" / "howto").glob("*.md")),
]
NOT_RUN = {
    "cep upload": (
        "needs a board; the transcript of docs/hardware.md does it with the emulated one"
    ),
    "cep hw": (
        "needs a board; the transcripts of docs/hardware.md and the tutorial do it with the"
        " emulated one"
    ),
    "cep shoot": "needs a camera; tests/cep/commands/test_shoot.py has the twin and a video",
    "cep deblur shot/photo.tif": "a photo of cep shoot; as above",
    "cep studio": "serves until it is stopped; tests/cep/studio",
    "python -m lab bench": "takes minutes to days; .ci/run runs the quick one of all tables",
    "cep calibrate open.png coded.png": "40 CPU-s; tests/cep/commands/test_calibrate_coded.py",
    "cep calibrate light.png": "as above",
    "cep deblur left.png": "a minute; tests/cep/commands/test_deblur.py",
    "cep calibration-set": "14 CPU-s; tests/cep/commands/test_calibration_set.py",
    "cep calibrate p1.png": "a minute; as above",
    "cep calibrate run1.png": "9 CPU-s; tests/cep/commands/test_calibrate_together.py",
    "cep optimize --trajectory motion/trajectory.json --device": (
        "40 CPU-s; tests/cep/commands/test_optimize.py"
    ),
    "python -m lab frames": "a minute; tests/lab/frames/test_optimum.py",
    "python -m lab design-class": "a minute; tests/lab/commands/test_design_class.py",
    "python -m lab pareto": "a minute; tests/lab/commands/test_pareto.py",
    "python -m lab prove": "a minute; tests/lab/block_proofs/test_prove.py",
    "python -m motdiff prepare": (
        "an hour; tests/motdiff/test_commands.py prepares, trains and exports a small one"
    ),
    "python -m motdiff train": "half an hour to days; as above",
    "python -m motdiff export": "exports that training; as above",
}
"""Beginnings of commands that are not run here, and why; tests/test_documented_commands.py parses
them all."""

RUN_ALTHOUGH = ("cep hw verify", "cep studio studio.json")
"""Commands that begin like those and need neither a board nor a page."""

CODE = "1011011101011110110101110011"
PATH = cep.Trajectory.from_samples([[0, 0], [9, 3], [14, 12]], direction="known")
MODULE = """
import cep

class MyEstimator:
    def estimate(self, photo):
        return cep.Trajectory.straight(10.0)

def restore(photo, psf):
    return cep.restore(photo, psf=psf, method="wiener")

def code():
    return "1011001110001111"

def figure(trajectory, code):
    return code.duty
"""


def write_inputs():
    """Write the files that the tour begins with, into the current folder."""
    rng = np.random.default_rng(0)
    camera = cep.Camera(photons_full_scale=20_000, read_noise_e=5)
    scene = (data.camera()[80:360, 120:400] / 255) ** 2.2
    chips = cep.ShutterCode(CODE, chip_ns=1_000_000)
    for name in ("sharp.png", "sharp.jpg"):
        cep.write_image(name, scene)
    Path("SHOTS").mkdir()
    photos = [
        "blurred.jpg",
        "photo.jpg",
        "open.png",
        *(f"run{n}.png" for n in "123"),
        "SHOTS/one.png",
        "SHOTS/two.png",
    ]
    for name in photos:
        cep.write_image(name, cep.capture(scene, PATH, None, camera, rng=rng))
    cep.write_image("coded.png", cep.capture(scene, PATH, chips, camera, rng=rng))
    for name, electrons in {"flat": 5000, "dark": 0}.items():
        for one in "12":
            light = rng.poisson(electrons * np.linspace(0.9, 1.1, 160), (160, 160))
            values = (light + rng.normal(0, 8, light.shape)) / 2.5 + 64
            cv2.imwrite(f"{name}{one}.png", np.clip(np.rint(values), 0, 4095).astype(np.uint16))
    times = np.arange(12, 12.6, 0.002)
    rates = [0.05 * np.cos(40 * times), 0.1 + 0 * times, 0 * times]
    log = np.stack([times, *rates], 1)
    np.savetxt(
        "gyro.csv", log, delimiter=",", header="t_s,wx_rad_s,wy_rad_s,wz_rad_s", comments=""
    )
    Path("mymodule.py").write_text(MODULE)
    Path("motion").mkdir()
    write_motion(Path("motion/trajectory.json"), StoredMotion(PATH))
    write_code(Path("code.json"), StoredCode(chips))
    setting = {
        "motion": {"kind": "example", "name": "shake"},
        "bits": CODE,
        "exposure": "20ms",
        "camera": "video-8bit",
    }
    Path("studio.json").write_text(json.dumps(Views().saved(read_setting(setting), setting)))


def blocks(page):
    """Return the commands of a page's blocks for the shell, in order."""
    lines = lines_of(page.read_text(encoding="utf-8"), "sh")
    return [shlex.join(words) for line in lines for words in commands_in(line)]


def tour(page):
    """Return those of them that are run here; one that several pages show is run for the first."""
    earlier = {one for other in PAGES[: PAGES.index(page)] for one in blocks(other)}
    return [
        one
        for one in blocks(page)
        if one not in earlier
        and (one.startswith(RUN_ALTHOUGH) or not one.startswith(tuple(NOT_RUN)))
    ]


def run(command):
    """Run a command of a tour: it shows several ways to one file, each of which replaces the
    others' here."""
    words = shlex.split(command)
    if words[0] != "cep":
        return motdiff(words[3:])
    if words[1:3] == ["hw", "verify"]:  # the code is recorded as it was exported
        assert (
            main(["export", "code.json", "--format", "vcd", "-o", "capture.vcd", "--force"]) == 0
        )
    command = command_line().commands[words[1]]
    command = getattr(command, "commands", {}).get(words[2], command)  # of a group
    offered = {option for parameter in command.params for option in parameter.opts}
    return main([*words[1:], *(["--force"] if "--force" in offered else [])])


@pytest.mark.slow(reason="the whole chain, several ways")
@pytest.mark.parametrize(
    "page", [page for page in PAGES if tour(page)], ids=lambda page: page.stem
)
def test_the_commands_of_a_tour_run_in_their_order(page, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    # of the usual 4 million moves a search takes 10 CPU-s
    monkeypatch.setattr("cep.search.code_search.standard_moves", lambda _problem: 100_000)
    write_inputs()
    for command in tour(page):
        capfd.readouterr()
        code = run(command)
        assert code == 0, f"{command}: {capfd.readouterr().err}"


def test_every_exception_is_needed():
    commands = [command for page in PAGES for command in blocks(page)]
    assert [
        start
        for start in (*NOT_RUN, *RUN_ALTHOUGH)
        if not any(one.startswith(start) for one in commands)
    ] == []
