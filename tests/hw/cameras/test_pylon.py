"""Basler cameras on Basler's own emulation: frames bit-exact, none lost, settings put back."""

import importlib.util
import os
import sys
import time

import cv2
import numpy as np
import pytest
from emulators.tools import give_up

from hw.cameras import genicam, open_camera
from hw.cameras.camera import CameraError, CameraSettings, FrameLostError, Trigger
from hw.cameras.genicam import pixel_format

os.environ["PYLON_CAMEMU"] = "2"  # read once, when pypylon lists its cameras for the first time
SETTINGS = CameraSettings(exposure_s=0.005)


@pytest.fixture(autouse=True)
def _pypylon():
    if importlib.util.find_spec("pypylon") is None:
        give_up("pypylon not installed: see .ci/tools")


@pytest.fixture
def camera():
    with open_camera("pylon:0815-0000") as camera:
        yield camera


def shoot(camera):
    camera.arm()
    camera.wait_ready(1)
    camera.fire()
    return camera.read(2)


def test_a_picture_of_ours_comes_back_bit_for_bit(camera, tmp_path, monkeypatch):
    monkeypatch.setattr(genicam, "deepest", lambda names: pixel_format("Mono8"))
    picture = np.random.default_rng(0).integers(0, 256, (48, 64), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "picture.png"), picture)
    features = camera.features
    for name, value in (
        ("Width", 64),
        ("Height", 48),
        ("TestImageSelector", "Off"),
        ("ImageFilename", str(tmp_path)),
        ("ImageFileMode", "On"),
    ):
        features.set(name, value)
    camera.configure(SETTINGS)
    frame = shoot(camera)
    np.testing.assert_array_equal(frame.values, picture)
    assert (frame.bits, frame.bayer, frame.serial) == (8, None, "0815-0000")


def test_the_deepest_format_is_taken_and_the_exposure_read_back(camera):
    took = camera.configure(CameraSettings(exposure_s=0.0333, gain_db=6.0))
    frame = shoot(camera)
    assert camera.features.get("PixelFormat") == "Mono16"
    assert frame.values.dtype == np.uint16
    assert frame.exposure_s == pytest.approx(0.0333, abs=1e-6)
    # the camera's gain has steps: it states the nearest
    assert frame.gain_db == took.gain_db == pytest.approx(6, abs=0.05)
    assert frame.timestamp_ns is None  # the emulated one has no clock


def test_no_trigger_is_lost_right_after_the_start():
    ids = []
    for _ in range(10):
        with open_camera("pylon:0815-0001") as camera:
            camera.configure(SETTINGS)
            ids += [shoot(camera).frame_id, shoot(camera).frame_id]
    assert ids == [0, 1] * 10


def test_no_frame_comes_before_the_trigger(camera):
    camera.configure(SETTINGS)
    camera.arm()
    camera.wait_ready(1)
    with pytest.raises(FrameLostError, match=r"no frame within 0\.2 s"):
        camera.read(0.2)
    camera.fire()
    assert camera.read(2).frame_id == 0


def test_an_incomplete_frame_is_lost_and_the_next_is_not(camera):
    camera.configure(SETTINGS)
    camera.features.set("ForceFailedBufferCount", 1)
    camera.features.execute("ForceFailedBuffer")
    with pytest.raises(FrameLostError, match="incompletely grabbed"):
        shoot(camera)
    assert shoot(camera).values.any()


def test_a_frame_that_was_not_read_leaves_a_gap_in_the_ids(camera):
    camera.configure(SETTINGS)
    assert [shoot(camera).frame_id for _ in range(2)] == [0, 1]
    camera.wait_ready(1)  # a trigger that comes before the camera is ready is lost
    camera.fire()
    camera.wait_ready(1)  # its frame has been exposed, and is never read
    time.sleep(0.1)
    assert shoot(camera).frame_id == 3


SETTING_NAMES = (
    "PixelFormat",
    "ExposureTime",
    "ExposureMode",
    "ExposureAuto",
    "Gain",
    "GainAuto",
    "AcquisitionMode",
    "AcquisitionFrameRateEnable",
    "TriggerSelector",
    "TriggerMode",
    "TriggerSource",
    "TriggerActivation",
)


def states(device):
    """Value of every setting that can be read, the trigger's for each of its selectors."""
    from pypylon import genicam

    def settings():
        return {
            name: device.GetNodeMap().GetNode(name).Value
            for name in SETTING_NAMES
            if genicam.IsReadable(device.GetNodeMap().GetNode(name))
        }

    before = settings()
    triggers = {}
    for selector in device.TriggerSelector.Symbolics:
        device.TriggerSelector.Value = selector
        triggers[selector] = settings()
    device.TriggerSelector.Value = before["TriggerSelector"]
    return before, triggers


@pytest.mark.parametrize("trigger", list(Trigger))
def test_the_settings_are_put_back_at_close(trigger, monkeypatch):
    from pypylon import pylon

    factory = pylon.TlFactory.GetInstance()
    device = pylon.InstantCamera(factory.CreateDevice(factory.EnumerateDevices()[0]))
    device.Open()
    device.TriggerSelector.Value = "FrameBurstStart"
    device.TriggerMode.Value = "On"
    device.ExposureTime.Value = 1234.0
    device.GainAuto.Value = "Continuous"
    device.PixelFormat.Value = "BayerGB12"
    before = states(device)
    device.Close()
    # an emulated camera keeps its settings for one handle only
    monkeypatch.setattr(pylon, "InstantCamera", lambda created: device)
    with open_camera("pylon:0815-0000") as camera:
        assert states(device) == before
        camera.configure(CameraSettings(exposure_s=0.01, trigger=trigger, gain_db=3))
        camera.arm()
        assert states(device) != before
    device.Open()
    assert states(device) == before
    device.Close()


def test_a_line_is_kept_that_the_user_had_chosen(camera):
    camera.features.set("TriggerSource", "Line3")
    camera.features.set("TriggerActivation", "FallingEdge")
    camera.configure(CameraSettings(exposure_s=0.01, trigger=Trigger.LINE))
    assert camera.features.get("TriggerSource") == "Line3"
    assert camera.features.get("TriggerActivation") == "RisingEdge"  # as the shutter's output
    assert camera.features.get("ExposureMode") == "Timed"


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"exposure_s": 11.0}, r"exposure: Basler Emulation takes 1e-06 to 10 s, got 11 s"),
        ({"gain_db": 50.0}, r"gain: Basler Emulation takes 0 to 48 dB, got 50"),
    ],
)
def test_what_the_camera_cannot_take_is_one_line(camera, settings, line):
    with pytest.raises(ValueError, match=line) as error:
        camera.configure(CameraSettings(**({"exposure_s": 0.01} | settings)))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("access", "arguments"),
    [
        ("get", ("Flavour",)),
        ("set", ("Flavour", 1)),
        ("entries", ("Flavour",)),
        ("bounds", ("Flavour",)),
        ("unit", ("Flavour",)),
        ("execute", ("Flavour",)),
    ],
)
def test_a_feature_that_fails_is_one_line_of_the_camera(camera, access, arguments):
    with pytest.raises(CameraError) as error:
        getattr(camera.features, access)(*arguments)
    assert "Flavour" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("address", "line"),
    [
        (
            "",
            r"^pylon: 2 cameras fit: Emulation 0815-0000, Emulation 0815-0001; name one, as ",
        ),
        ("Emulation", "2 cameras fit"),
        ("22", r"^pylon:22: there is no such camera; seen: Emulation 0815-0000, Emulation 0815-"),
    ],
)
def test_a_camera_must_be_named_by_what_only_one_has(address, line):
    with pytest.raises(ValueError, match=line):
        open_camera(f"pylon:{address}")


def test_a_camera_of_another_program_is_said_to_be(monkeypatch):
    from pypylon import genicam, pylon

    def refuse(device):
        raise genicam.RuntimeException("The device is controlled by another application.")

    monkeypatch.setattr(pylon.InstantCamera, "Open", refuse)
    with pytest.raises(ValueError, match=r"0000 cannot be opened, close .* by another"):
        open_camera("pylon:0815-0000")


def test_a_missing_library_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pypylon", None)
    with pytest.raises(ValueError, match=r"pip install coded-exposure\[pylon\]"):
        open_camera("pylon:")
