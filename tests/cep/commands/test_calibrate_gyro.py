"""``cep calibrate --method gyro``: the path of the blur, whatever the axes of the recording, and
how it was read."""

import re
from pathlib import Path

import numpy as np
import pytest

from cep.commands.code_options import exposure_seconds
from cep.files.images import read_image, write_image
from motdiff.files.trajectories import read_motion

FOCAL_PX = 800.0
START_S = 0.2
EXPOSURE_S = 0.04
PAN_RAD_S = 0.5
SHAKE_RAD_S = 0.6
SHAKE_HZ = 30.0
GYRO = (
    "--method",
    "gyro",
    "--gyro",
    "gyro.csv",
    "--focal",
    FOCAL_PX,
    "--start",
    START_S,
    "--exposure",
    EXPOSURE_S,
)


def rates_about(*names):
    """Rates (N, 3) about axes of these directions of a camera that pans right and shakes in tilt,
    and times (N,)."""
    t = np.arange(0, 0.5, 0.002)
    turn = {
        "right": SHAKE_RAD_S * np.cos(2 * np.pi * SHAKE_HZ * (t - START_S)),
        "down": PAN_RAD_S + 0 * t,
    }
    turn |= {"left": -turn["right"], "up": -turn["down"], "forward": 0 * t, "back": 0 * t}
    return t, np.stack([turn[name] for name in names], axis=1)


def path_of_the_image(share):
    """Closed form (N, 2), px: of a camera that pans right the image runs left; of one that tilts
    up it runs down."""
    time_s = EXPOSURE_S * share
    turn = 2 * np.pi * SHAKE_HZ
    xy = FOCAL_PX * np.stack(
        [-PAN_RAD_S * time_s, SHAKE_RAD_S / turn * np.sin(turn * time_s)], axis=1
    )
    return xy - xy.mean(axis=0)


@pytest.fixture(scope="module")
def sharp_and_blurred():
    """A scene, and its photo under that motion with circular borders."""
    rng = np.random.default_rng(0)
    sharp = np.kron(rng.random((24, 24)), np.ones((8, 8)))
    xy = path_of_the_image((np.arange(400) + 0.5) / 400)
    rows, columns = (
        np.exp(-2j * np.pi * np.outer(np.fft.fftfreq(side), at))
        for side, at in zip(sharp.shape, xy.T[::-1], strict=True)
    )
    otf = rows @ columns.T / len(xy)
    blurred = np.fft.ifft2(np.fft.fft2(sharp) * otf).real + 0.002 * rng.standard_normal(
        sharp.shape
    )
    return sharp, np.clip(blurred, 0, 1)


@pytest.fixture
def scene(workplace, sharp_and_blurred):
    """Write blurred.png and return its scene."""
    sharp, blurred = sharp_and_blurred
    write_image("blurred.png", blurred, bits=16)
    return sharp


def write_log(t, rates, *, header="t_s,wx_rad_s,wy_rad_s,wz_rad_s"):
    np.savetxt(
        "gyro.csv",
        np.column_stack([t, rates]),
        fmt="%.9f",
        delimiter=",",
        header=header,
        comments="",
    )


def rms_px(file):
    share = np.linspace(0, 1, 200)
    found = read_motion(file).trajectory.at(share)
    return float(
        np.sqrt(
            np.mean(np.sum((found - found.mean(axis=0) - path_of_the_image(share)) ** 2, axis=1))
        )
    )


# one turned in the image's plane, one out of it; all 24 in tests/motdiff/test_gyro.py
@pytest.mark.parametrize("axes", ["up,left,back", "forward,right,down"])
def test_the_path_is_that_of_the_blur_and_restores_it(cep, scene, axes):
    write_log(*rates_about(*axes.split(",")))
    found = cep.succeeds("calibrate", "blurred.png", *GYRO, "--gyro-axes", axes, "-o", "m")
    assert found["warnings"] == []
    assert found["details"]["axes"] == axes
    assert rms_px("m/trajectory.json") < 0.1
    cep.succeeds(
        "deblur", "blurred.png", "--trajectory", "m/trajectory.json", "-o", "restored.png"
    )

    def psnr_db(file):
        return -10 * np.log10(np.mean((read_image(file) - scene) ** 2))

    assert psnr_db("restored.png") > psnr_db("blurred.png") + 1


def test_axes_that_were_not_given_are_those_of_the_camera_and_the_user_is_told(cep, scene):
    write_log(*rates_about("right", "down", "forward"))
    found = cep.succeeds("calibrate", "blurred.png", *GYRO, "-o", "m")
    assert rms_px("m/trajectory.json") < 0.1
    assert any(
        line.startswith("--gyro-axes: taken as right,down,forward") for line in found["warnings"]
    )
    page = cep("calibrate", "blurred.png", *GYRO, "-o", "told")
    assert (
        "gyro.csv: time: t_s, in s; rates: wx_rad_s, wy_rad_s, wz_rad_s, in rad/s; axes:"
        " right,down," in page.out
    )
    assert "warning: --gyro-axes: taken as right,down,forward" in page.err


@pytest.mark.parametrize("axes", ["right,up,forward", "right,down", "x,y,z", ""])
def test_axes_that_are_none_are_refused(cep, scene, axes):
    write_log(*rates_about("right", "down", "forward"))
    assert cep.refuses(
        "calibrate", "blurred.png", *GYRO, "--gyro-axes", axes, "-o", "m"
    ).startswith("cep: --gyro-axes: must be ")
    assert not Path("m").exists()


def test_axes_go_with_a_recording(cep, scene):
    line = cep.refuses("calibrate", "blurred.png", "--gyro-axes", "right,up,back")
    assert line.startswith("cep: --gyro-axes: not valid with --method motdiff")


def test_only_the_gyroscope_of_several_sensors_is_read(cep, scene):
    t, rates = rates_about("right", "down", "forward")
    rows = [
        f"{s:.4f},gyroscope,{x:.6f},{y:.6f},{z:.6f}" for s, (x, y, z) in zip(t, rates, strict=True)
    ]
    others = [f"{s + 0.001:.4f},accelerometer,0.1,9.81,0.2" for s in t]
    pairs = [line for pair in zip(rows, others, strict=True) for line in pair]
    Path("gyro.csv").write_text("\n".join(["time,sensor,x,y,z", *pairs]))
    found = cep.succeeds("calibrate", "blurred.png", *GYRO, "-o", "m")
    assert rms_px("m/trajectory.json") < 0.1
    assert "sensor: gyroscope" in found["details"]["columns"]


def test_the_time_may_stand_last(cep, scene):
    t, rates = rates_about("right", "down", "forward")
    rows = [
        f"{x:.6f},{y:.6f},{z:.6f},{round(1e9 * s)}" for s, (x, y, z) in zip(t, rates, strict=True)
    ]
    Path("gyro.csv").write_text("\n".join(rows))
    found = cep.succeeds("calibrate", "blurred.png", *GYRO, "-o", "m")
    assert rms_px("m/trajectory.json") < 0.1
    assert any(
        re.search("gyro.csv: not stated .* column 4 is the time", line)
        for line in found["warnings"]
    )


@pytest.mark.parametrize("text", ["1/25", "40ms", "0.04 s", "40000us"])
def test_one_exposure_has_several_spellings(text):
    assert exposure_seconds(text) == pytest.approx(EXPOSURE_S, rel=1e-12)


def test_the_exposure_is_read_as_everywhere(cep, scene):
    write_log(*rates_about("right", "down", "forward"))
    cep.succeeds("calibrate", "blurred.png", *GYRO[:-1], "40ms", "-o", "m")
    assert rms_px("m/trajectory.json") < 0.1
    line = cep.refuses("calibrate", "blurred.png", *GYRO[:-1], "a while", "-o", "n")
    assert line.startswith(
        "cep: --exposure: must be a time above 0 as 1/30, 0.02, 20ms or 500us, got 'a while'"
    )


def test_the_unit_of_rates_is_refused_wherever_no_recording_is_read(cep, workplace):
    Path("shots").mkdir()
    Path("shots/blurred.png").write_bytes(Path("blurred.png").read_bytes())
    for arguments in (
        ("blurred.png",),
        ("shots",),
        ("blurred.png", "--code", "1101", "--trajectory", "trajectory.json"),
    ):
        line = cep.refuses("calibrate", *arguments, "--gyro-unit", "deg")
        assert line.startswith("cep: --gyro-unit: not valid with --")
