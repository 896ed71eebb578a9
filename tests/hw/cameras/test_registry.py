"""Names of cameras: kind, colon, address; nothing heavy is imported before a kind is named."""

import subprocess
import sys

import pytest

from hw.cameras import CAMERAS, camera_class, open_camera
from hw.cameras.camera import Camera


class Recorder:
    @classmethod
    def open(cls, address):
        return address


KINDS = {"recorder": f"{__name__}:Recorder", "absent": "hw.no_such_module:Camera"}


@pytest.mark.parametrize("address", ["", "22845317", "192.168.1.7:3956", "C:\\photos", "a b"])
def test_the_address_is_all_behind_the_first_colon(address):
    assert open_camera(f"recorder:{address}", KINDS) == address


def test_an_unknown_kind_lists_those_that_are_known():
    with pytest.raises(ValueError, match=r"'leica' is not known; known are absent:, recorder:$"):
        open_camera("leica:1", KINDS)


def test_a_name_without_a_colon_says_how_it_is_written():
    with pytest.raises(ValueError, match="kind:address"):
        open_camera("recorder", KINDS)


@pytest.mark.parametrize("kind", sorted(CAMERAS))
def test_an_adapter_has_its_kind_and_loads_without_its_library(kind):
    code = (
        "import sys; from hw.cameras import camera_class;"
        f"adapter = camera_class({kind!r});"
        f"assert adapter.name == {kind!r} and adapter.summary and adapter.triggers;"
        "heavy = {'pypylon', 'gi', 'gphoto2', 'harvesters', 'cv2', 'numpy', 'torch'};"
        "print(*sorted(heavy & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""


def test_camera_class_is_typed_by_the_protocol():
    assert camera_class("recorder", KINDS) is Recorder


def test_a_camera_of_its_own_needs_the_port_of_a_controller():
    class Adapter(Camera):
        name = "adapter"

    camera = Adapter()
    assert camera.controller_port("COM3") == "COM3"
    with pytest.raises(ValueError, match="port: camera adapter: needs a controller"):
        camera.controller_port(None)
