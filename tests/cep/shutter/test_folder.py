"""The next photo that another program saves."""

import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from emulators.tools import require_simavr

from cep.optics.code import ShutterCode
from cep.shutter.exposure_plan import Release, ShotSettings
from cep.shutter.folder import FolderCamera
from cep.shutter.shoot import shoot
from hw.cameras.camera import CameraError, CameraSettings, FrameLostError
from hw.emulation.uno import EmulatedUno

VALUES = np.random.default_rng(0).integers(0, 4096, (40, 50)).astype(np.uint16)


def encoded(values, suffix=".png"):
    return cv2.imencode(suffix, values)[1].tobytes()


def later(function, *arguments, after_s=0.1):
    timer = threading.Timer(after_s, function, arguments)
    timer.start()
    return timer


def test_photos_that_are_there_are_passed_over(tmp_path):
    (tmp_path / "old.png").write_bytes(encoded(VALUES // 2))
    with FolderCamera.open(f"{tmp_path}#gamma=linear") as camera:
        camera.arm()
        later(tmp_path.joinpath("new.png").write_bytes, encoded(VALUES))
        frame = camera.read(10)
    assert (frame.values == VALUES).all()
    assert (frame.bits, frame.gamma, frame.camera, frame.frame_id) == (12, "linear", "new.png", 1)
    assert frame.exposure_s is None


def test_a_photo_is_read_when_it_is_whole(tmp_path):
    data = encoded(VALUES)
    path = tmp_path / "slow.png"

    def write():
        with path.open("wb") as file:
            for start in range(0, len(data), len(data) // 5):
                file.write(data[start : start + len(data) // 5])
                file.flush()
                time.sleep(0.1)

    with FolderCamera.open(str(tmp_path)) as camera:
        camera.arm()
        writer = later(write)
        frame = camera.read(20)
        writer.join()
    assert (frame.values == VALUES).all()


def test_a_file_that_its_program_renames_is_no_failure(tmp_path, monkeypatch):
    looked_at = Path.stat

    def gone(path, **how):
        if path.name == "part.png":
            raise FileNotFoundError(path)
        return looked_at(path, **how)

    with FolderCamera.open(f"{tmp_path}#gamma=linear") as camera:
        camera.arm()
        (tmp_path / "part.png").write_bytes(encoded(VALUES // 2))
        (tmp_path / "whole.png").write_bytes(encoded(VALUES))
        monkeypatch.setattr(Path, "stat", gone)
        assert camera.read(10).camera == "whole.png"


def test_a_photo_that_stays_damaged_is_named(tmp_path):
    with FolderCamera.open(str(tmp_path)) as camera:
        camera.arm()
        (tmp_path / "half.png").write_bytes(encoded(VALUES)[:200])
        with pytest.raises(FrameLostError, match=r"half\.png"):
            camera.read(0.6)


def test_a_second_photo_is_a_second_frame_and_a_second_format_is_not(tmp_path):
    with FolderCamera.open(str(tmp_path)) as camera:
        camera.arm()
        (tmp_path / "a.png").write_bytes(encoded(VALUES))
        camera.read(5)
        (tmp_path / "a.jpg").write_bytes(encoded(VALUES.astype(np.uint8), ".jpg"))
        with pytest.raises(FrameLostError, match="no photo was saved"):
            camera.read(0.0)
        (tmp_path / "b.png").write_bytes(encoded(VALUES))
        assert camera.read(0.0).frame_id == 2


def test_hidden_and_other_files_are_no_photos(tmp_path):
    with FolderCamera.open(str(tmp_path)) as camera:
        camera.arm()
        (tmp_path / ".part.png").write_bytes(encoded(VALUES))
        (tmp_path / "notes.txt").write_text("exposure 20 ms")
        with pytest.raises(FrameLostError):
            camera.read(0.4)


def test_a_folder_that_goes_is_a_camera_that_is_gone(tmp_path):
    folder = tmp_path / "card"
    folder.mkdir()
    with FolderCamera.open(str(folder)) as camera:
        camera.configure(CameraSettings(exposure_s=0.1))
        camera.arm()
        later(folder.rmdir)
        with pytest.raises(CameraError, match="cannot be read"):
            camera.read(10)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("", "a path is needed"),
        ("/no/such/folder", "is no folder"),
        ("#gamma=linear", "a path is needed"),
        (".#gamma=3", "gamma must be srgb or linear"),
        (".#speed=3", "known are gamma="),
    ],
)
def test_a_wrong_address_is_refused(address, words):
    with pytest.raises(ValueError, match=words):
        FolderCamera.open(address)


def test_the_shutter_plays_while_another_program_takes_the_photo(tmp_path):
    require_simavr()
    with EmulatedUno() as uno:
        later(tmp_path.joinpath("new.png").write_bytes, encoded(VALUES), after_s=0.5)
        code = ShutterCode("1011", 1_000_000)
        (shot,) = shoot(
            f"folder:{tmp_path}",
            code,
            port=uno.port,
            settings=ShotSettings(release=Release.SHUTTER),
        )
        assert len(uno.edges()) == 4
    assert shot.counts
    assert (shot.frame.values == VALUES).all()
    assert shot.warnings[-1].startswith("the camera does not state its exposure")
