"""A video as a virtual shutter: against the direct simulation, and its limits."""

import cv2
import numpy as np
import pytest

from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.restoration.restore import restore
from cep.shutter.burst import BurstCamera
from cep.shutter.exposure_plan import ShotSettings
from cep.shutter.shoot import shoot
from hw.cameras.camera import CameraError
from motdiff.metrics import psnr
from motdiff.photo_values import to_display
from motdiff.simulate import blur_valid
from motdiff.trajectory import Trajectory

FPS = 240
CODE = ShutterCode("1101001011001110", 1_000_000)
PATH = Trajectory.from_samples([[0, 0], [9, 4], [16, 3]], direction="known")
SIZE = PATH.frame_size() | 1
SCENE = np.kron(np.random.default_rng(1).uniform(0.05, 0.9, (16, 16)), np.ones((8, 8)))


def write_video(path, frames, *, codec="FFV1", fps=FPS):
    height, width = frames[0].shape[:2]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), fps, (width, height))
    assert video.isOpened()
    for frame in frames:
        codes = np.rint(255 * to_display(np.clip(frame, 0, 1))).astype(np.uint8)
        video.write(np.dstack([codes] * 3) if codes.ndim == 2 else codes[:, :, ::-1])
    video.release()
    return path


def moving_frames(chips):
    """Frames of a camera that exposes all the time: each is blurred by its slice of the path."""
    slices = PATH.slice_psfs(np.linspace(0, 1, chips + 1), SIZE)
    return [blur_valid(SCENE, chips * psf) for psf in slices]


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    folder = tmp_path_factory.mktemp("video")
    return write_video(folder / "slow.mkv", moving_frames(CODE.chips))


def test_the_sum_is_the_photo_through_the_code(video):
    (shot,) = shoot(f"burst:{video}", CODE, settings=ShotSettings(motion=PATH))
    assert shot.counts
    photo = shot.record.light(shot.frame.values)
    direct = blur_valid(SCENE, coded_psf(PATH, CODE, size=SIZE))
    # frames of 8 bits: their rounding, of up to 1/255 in sRGB, is all that differs
    assert np.abs(photo - direct).max() < 0.004
    scene = SCENE[SIZE // 2 : -(SIZE // 2), SIZE // 2 : -(SIZE // 2)]
    noise = np.random.default_rng(0).normal(0, 0.002, direct.shape)
    gains_db = [
        psnr(np.clip(sharp.image, 0, 1)[16:-16, 16:-16], scene[16:-16, 16:-16])
        for sharp in (
            restore(light + noise, code=CODE, trajectory=PATH) for light in (photo, direct)
        )
    ]
    assert gains_db[0] == pytest.approx(gains_db[1], abs=0.3)


def test_chips_are_whole_frames(video):
    with BurstCamera.open(f"{video}") as camera:
        assert camera.plays(CODE).chip_ns == pytest.approx(1e9 / FPS, rel=1e-3)
        slow = ShutterCode("101", round(2.1e9 / FPS))
        assert camera.plays(slow).chip_ns == pytest.approx(2e9 / FPS, rel=1e-3)


def test_a_photo_begins_where_it_is_told_and_the_next_follows(tmp_path):
    levels = np.linspace(0.1, 0.8, 8)
    path = write_video(tmp_path / "steps.mkv", [np.full((32, 32), level) for level in levels])
    start_s = 2 / FPS
    shots = shoot(f"burst:{path}#t={start_s}", ShutterCode("101", 1000), count=2)
    means = [shot.record.light(shot.frame.values).mean() for shot in shots]
    # frames 2, 3, 4 and then 5, 6, 7: the middle one of each is shut
    expected = [(levels[2] + levels[4]) / 3, (levels[5] + levels[7]) / 3]
    assert means == pytest.approx(expected, abs=0.003)


def test_colours_are_linearised_each(tmp_path):
    frame = np.zeros((32, 32, 3))
    frame[...] = (0.2, 0.5, 0.8)
    path = write_video(tmp_path / "colours.mkv", [frame] * 3, codec="MJPG")
    (shot,) = shoot(f"burst:{path}", ShutterCode("11", 1000))
    assert shot.record.light(shot.frame.values).mean(axis=(0, 1)) == pytest.approx(
        [0.2, 0.5, 0.8], abs=0.02
    )


def test_a_video_that_is_linear_is_read_so(tmp_path):
    path = write_video(tmp_path / "grey.mkv", [np.full((32, 32), 0.2)] * 3)
    (shot,) = shoot(f"burst:{path}#gamma=linear", ShutterCode("11", 1000))
    display = np.rint(255 * to_display(0.2)) / 255
    assert shot.record.light(shot.frame.values).mean() == pytest.approx(display, abs=0.003)


def test_its_limits_are_said(video):
    (shot,) = shoot(f"burst:{video}", CODE)
    assert "light between them is lost" in shot.warnings[0]
    assert "plays" in shot.record.details
    assert shot.record.details["plays"] is None


def test_white_frames_are_said_where_the_sum_is_not_white(tmp_path):
    path = write_video(tmp_path / "white.mkv", [np.full((32, 32), 1.0)] * 4)
    (shot,) = shoot(f"burst:{path}", ShutterCode("1001", 1000))
    assert any("are white" in warning for warning in shot.warnings)


def test_missing_frames_are_refused(video):
    with BurstCamera.open(str(video)) as camera:
        camera.plays(CODE)
        with pytest.raises(CameraError, match="1 frames are missing within the code"):
            camera._doubts(np.array([4.0, 4.0, 8.0, 4.0]), 0.0)
        (_limits, uneven) = camera._doubts(np.array([4.0, 5.0, 4.0, 3.0]), 0.0)
        assert "vary by" in uneven


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("", "a path is needed"),
        ("no.mp4", "there is no such video"),
        ("{video}#t=-1", "t must be seconds"),
        ("{video}#t=soon", "t must be seconds"),
        ("{video}#gamma=9", "gamma: must be"),
        ("{text}", "is no video that OpenCV can read"),
    ],
)
def test_a_wrong_address_is_refused(video, tmp_path, address, words):
    text = tmp_path / "text.mp4"
    text.write_text("no video")
    with pytest.raises(ValueError, match=words):
        BurstCamera.open(address.format(video=video, text=text))


@pytest.mark.parametrize("start", ["0", "0.05"])
def test_a_video_that_is_too_short_is_refused(video, start):
    code = ShutterCode("10" * 20, 1000)
    with pytest.raises(ValueError, match=r"frames from the start on, the code takes 40: 40 chips"):
        shoot(f"burst:{video}#t={start}", code)
