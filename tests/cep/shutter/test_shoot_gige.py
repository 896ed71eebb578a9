"""The whole set-up over real protocols: GigE Vision on loopback, CXP1 on a pseudo-terminal."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from emulators.gige_camera import only_camera
from emulators.tools import give_up, require_simavr

from cep.files.images import write_image
from cep.optics.code import ShutterCode
from cep.shutter.exposure_plan import Release, ShotSettings
from cep.shutter.rig import Rig
from hw.cameras import aravis, open_camera
from hw.drivers.cxp import Controller

TESTS = Path(__file__).resolve().parents[2]
CODE = ShutterCode("1011001110100110", 400_000)
LENGTH_PX = 16
LEAD_NS = 20_000 + 3 * CODE.chip_ns  # the firmware's, and a lead-in of 1 ms in whole chips


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    require_simavr()
    try:
        aravis._library()
    except ValueError as error:
        give_up(f"{error}: see .ci/tools")
    scene = tmp_path_factory.mktemp("scene") / "scene.png"
    blocks = np.random.default_rng(0).uniform(0.1, 0.8, (12, 12))
    write_image(scene, np.kron(blocks, np.ones((8, 8))), bits=16)
    words = [TESTS / "emulators" / "gige_twin.py", scene, LEAD_NS, CODE.duration_ns, LENGTH_PX]
    with (
        only_camera(),
        subprocess.Popen(
            [sys.executable, *map(str, words)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": f"{TESTS.parent}{os.pathsep}{TESTS}"},
        ) as process,
    ):
        line = process.stdout.readline()
        assert line, "it did not start"
        yield process, *line.split()
        process.stdin.close()


@pytest.mark.parametrize(
    "count", [3, pytest.param(200, marks=pytest.mark.slow(reason="200 exposures and readouts"))]
)
def test_every_frame_is_the_twins_own_to_the_last_bit(server, count):
    process, port, side_px = server
    with open_camera("aravis:") as camera, Controller.open(port) as controller:
        for name in ("Width", "Height"):
            camera.features.set(name, int(side_px))
        rig = Rig(camera, controller)
        rig.prepare(CODE, ShotSettings(release=Release.CAMERA))
        shots = rig.series(count, keep=lambda _shot: None)
        own = [np.load(process.stdout.readline().strip()) for _ in shots]
    assert [shot.record.problems for shot in shots] == [()] * count
    assert [shot.record.details["plays"] for shot in shots] == [1] * count
    for shot, values in zip(shots, own, strict=True):
        np.testing.assert_array_equal(shot.frame.values, values)
    assert shots[0].frame.values.std() > 100
    assert shots[0].frame.exposure_s >= shots[0].record.details["lead_in_ns"] * 1e-9
