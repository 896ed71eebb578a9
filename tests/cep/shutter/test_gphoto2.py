"""Photo cameras on libgphoto2's own virtual one, a Nikon without a bulb, and one with faults."""

import importlib.util
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from emulators.tools import give_up, require_simavr

from cep.files.images import read_code_values
from cep.optics.code import ShutterCode
from cep.shutter.cameras import CAMERAS
from cep.shutter.exposure_plan import Release, ShotSettings
from cep.shutter.gphoto2 import Gphoto2Camera
from cep.shutter.rig import Rig
from hw.cameras import open_camera
from hw.cameras.camera import CameraError, CameraSettings, FrameLostError, Trigger
from hw.drivers.cxp import Controller
from hw.emulation.uno import EmulatedUno


@pytest.fixture
def photo(tmp_path, monkeypatch):
    """The file that the virtual camera delivers."""
    if importlib.util.find_spec("gphoto2") is None:
        give_up("gphoto2 not installed: see .ci/tools")
    import gphoto2

    virtual = Path(gphoto2.__file__).parent / "libgphoto2" / "vusb"
    if not virtual.is_dir():
        give_up("this gphoto2 has no virtual camera")
    monkeypatch.setenv("IOLIBS", str(virtual))
    monkeypatch.setenv("VCAMERADIR", str(tmp_path))
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    file = tmp_path / "photo.jpg"
    cv2.imwrite(str(file), picture)
    return file


@pytest.fixture
def camera(photo):
    with open_camera("gphoto2:", CAMERAS) as camera:
        yield camera


def speed(camera):
    return camera._device.get_single_config("shutterspeed").get_value()


def test_the_camera_delivers_its_photo(camera, photo):
    took = camera.configure(CameraSettings(exposure_s=0.03))
    assert took.exposure_s == 0.05  # the shortest listed speed that holds it
    assert speed(camera) == "0.0500s"
    for number in (1, 2):
        camera.arm()
        camera.wait_ready(1)
        camera.fire()
        frame = camera.read(5)
        np.testing.assert_array_equal(frame.values, read_code_values(photo)[0])
        assert (frame.frame_id, frame.exposure_s, frame.gamma) == (number, 0.05, "srgb")
    with pytest.raises(FrameLostError, match=r"no photo within 0\.2 s"):
        camera.read(0.2)


def test_a_second_file_of_a_photo_is_no_second_frame(camera, monkeypatch):
    camera.configure(CameraSettings(exposure_s=0.01))
    camera.arm()
    device = camera._device
    events = []

    class Twice:
        def __getattr__(self, name):
            return getattr(device, name)

        def wait_for_event(self, timeout_ms):
            event = device.wait_for_event(timeout_ms)
            if event[0] == gphoto2.GP_EVENT_FILE_ADDED:
                events.append(event)
            elif len(events) == 1:
                events.append(events[0])  # as the JPEG beside a RAW file
                return events[0]
            return event

    import gphoto2

    monkeypatch.setattr(camera, "_device", Twice())
    camera.fire()
    assert camera.read(5).frame_id == 1
    with pytest.raises(FrameLostError):
        camera.read(0.5)
    assert len(events) == 2


def test_a_photo_that_was_not_read_is_not_the_next(camera):
    camera.configure(CameraSettings(exposure_s=0.01))
    camera.fire()
    camera.arm()
    with pytest.raises(FrameLostError):
        camera.read(0.2)


def test_the_speed_is_put_back(photo):
    with open_camera("gphoto2:usb:001,001", CAMERAS) as camera:
        before = speed(camera)
        camera.configure(CameraSettings(exposure_s=1.0))
        assert speed(camera) != before
        device = camera._device
        device_exit, device.exit = device.exit, lambda: None
        camera.close()
        assert speed(camera) == before
        device_exit()


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"exposure_s": 2.0}, r"has 0\.0001 to 1 s and no bulb, got 2 s"),
        ({"trigger": Trigger.LINE}, "fired by this computer"),
        ({"gain_db": 3.0}, "set ISO at"),
    ],
)
def test_what_the_camera_cannot_take_is_one_line(camera, settings, line):
    with pytest.raises(ValueError, match=line):
        camera.configure(CameraSettings(**({"exposure_s": 0.01} | settings)))


def test_an_address_of_no_camera_lists_those_seen(photo):
    with pytest.raises(
        ValueError, match=r"gphoto2:EOS: there is no such .*; seen: Nikon DSC D750"
    ):
        open_camera("gphoto2:EOS", CAMERAS)


def test_a_missing_library_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "gphoto2", None)
    with pytest.raises(ValueError, match=r"pip install coded-exposure\[gphoto2\]"):
        open_camera("gphoto2:", CAMERAS)


class BulbDevice:
    """A camera with a bulb, which the virtual one lacks: what was set, and when."""

    def __init__(self, *, stuck=False):
        self.changes = []
        self.stuck = stuck
        self.values = {"shutterspeed": "1/100", "bulb": 0}

    def get_single_config(self, name):
        import gphoto2

        if name not in self.values:
            raise gphoto2.GPhoto2Error(-2)
        return Widget(self.values[name])

    def set_single_config(self, name, widget):
        import gphoto2

        if self.stuck and name == "bulb" and not widget.value:
            raise gphoto2.GPhoto2Error(-1)
        self.values[name] = widget.value
        self.changes.append((name, widget.value, time.monotonic()))

    def wait_for_event(self, wait_ms):
        import gphoto2

        time.sleep(wait_ms * 1e-3)
        return gphoto2.GP_EVENT_TIMEOUT, None

    def exit(self):
        self.changes.append(("exit", None, time.monotonic()))


class Widget:
    choices = ("1/100", "1/10", "bulb")

    def __init__(self, value):
        self.value = value

    def get_value(self):
        return self.value

    def set_value(self, value):
        self.value = value

    def count_choices(self):
        return len(self.choices)

    def get_choice(self, index):
        return self.choices[index]


def test_a_bulb_is_open_for_the_exposure_and_closed_at_the_end(photo):
    device = BulbDevice()
    with Gphoto2Camera(device, model="EOS", port="usb:1") as camera:
        assert camera.configure(CameraSettings(exposure_s=0.4)).exposure_s == 0.4
        camera.fire()
        with pytest.raises(FrameLostError):
            camera.read(0.5)
    names = [(name, value) for name, value, _ in device.changes]
    assert names == [
        ("shutterspeed", "bulb"),
        ("bulb", 1),
        ("bulb", 0),
        ("shutterspeed", "1/100"),
        ("exit", None),
    ]
    assert device.changes[2][2] - device.changes[1][2] >= 0.4


def test_a_bulb_is_closed_when_the_photo_is_given_up(photo):
    device = BulbDevice()
    with Gphoto2Camera(device, model="EOS", port="u") as camera:
        camera.configure(CameraSettings(exposure_s=30.0))
        camera.fire()  # and nothing is read, as when Ctrl-C ends the wait
    assert ("bulb", 0) in [(name, value) for name, value, _ in device.changes]


def test_a_bulb_that_does_not_close_is_an_error(photo):
    device = BulbDevice(stuck=True)
    with Gphoto2Camera(device, model="EOS", port="u") as camera:
        camera.configure(CameraSettings(exposure_s=0.2))
        camera.fire()
        with pytest.raises(CameraError, match="does not end, switch it off"):
            camera.read(1)
    assert device.changes[-1][0] == "exit"


def test_a_photo_through_a_code_counts(photo):
    require_simavr()
    code = ShutterCode("1011001110100110", 400_000)
    with (
        EmulatedUno() as uno,
        Controller.open(uno.port) as controller,
        open_camera("gphoto2:", CAMERAS) as camera,
    ):
        rig = Rig(camera, controller)
        rig.prepare(code, ShotSettings(release=Release.HOST, lead_in_s=0.05))
        shot = rig.shoot()
    assert shot.counts
    assert shot.frame.exposure_s in (0.1, 1.0)  # the listed speeds that hold code and lead-in
    np.testing.assert_array_equal(shot.frame.values, read_code_values(photo)[0])
