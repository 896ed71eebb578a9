"""GigE Vision on the loopback network: Aravis's emulated camera with pictures of ours."""

import ctypes
import time

import numpy as np
import pytest
from emulators.gige_camera import ADDRESS, SERIAL, GigeCamera
from emulators.tools import give_up

from hw.cameras import aravis, genicam, open_camera
from hw.cameras.camera import CameraError, CameraSettings, FrameLostError, Trigger
from hw.cameras.genicam import pixel_format

PICTURE = np.random.default_rng(0).integers(0, 2**16, (64, 80), dtype=np.uint16)
SETTINGS = CameraSettings(exposure_s=0.01)


@pytest.fixture(autouse=True)
def _library():
    try:
        aravis._library()
    except ValueError as error:
        give_up(f"{error}: see .ci/tools")


@pytest.fixture(scope="module")
def server():
    with GigeCamera(PICTURE) as server:
        yield server


def opened(address=""):
    camera = open_camera(f"aravis:{address}")
    for name, value in (("Width", 80), ("Height", 64)):
        camera.features.set(name, value)
    return camera


def shoot(camera):
    camera.arm()
    camera.wait_ready(1)
    camera.fire()
    return camera.read(3)


@pytest.mark.parametrize("address", ["", SERIAL, ADDRESS])
def test_a_picture_of_ours_comes_over_the_network_bit_for_bit(server, address):
    with opened(address) as camera:
        took = camera.configure(CameraSettings(exposure_s=0.0123))
        before_ns = time.time_ns()
        frame = shoot(camera)
        assert server.frame() == (12_300, 0)  # as the camera itself was set
    np.testing.assert_array_equal(frame.values, PICTURE)
    assert (frame.bits, frame.bayer) == (16, None)  # the deepest of its formats, Mono16
    assert (frame.camera, frame.serial) == ("Aravis Fake", SERIAL)
    assert frame.exposure_s == took.exposure_s == pytest.approx(0.0123)
    assert frame.gain_db is None  # it has steps only
    # the emulated camera's clock is this computer's
    assert abs(frame.timestamp_ns - before_ns) < 5e9


def test_bayer_pictures_have_their_pattern(server, monkeypatch):
    monkeypatch.setattr(genicam, "deepest", lambda names: pixel_format("BayerGB8"))
    with opened() as camera:
        camera.configure(CameraSettings(exposure_s=0.01))
        frame = shoot(camera)
        server.frame()
    assert (frame.bayer, frame.bits, frame.values.dtype) == ("GBRG", 8, np.uint8)
    np.testing.assert_array_equal(
        frame.values.reshape(-1), np.frombuffer(PICTURE.tobytes(), np.uint8)[: 64 * 80]
    )


@pytest.mark.slow(reason="150 frames, of which the emulated camera delivers 25 a second")
def test_every_trigger_gives_one_frame_and_ids_go_on_where_their_16_bits_end(server):
    with opened() as camera:
        camera.configure(CameraSettings(exposure_s=0.001))
        frames = [shoot(camera) for _ in range(150)]
        with pytest.raises(FrameLostError, match=r"no frame within 0\.2 s"):
            camera.read(0.2)
        for _ in frames:
            server.frame()
    first = frames[0].frame_id
    assert [frame.frame_id - first for frame in frames] == list(range(150))
    assert first < 65_535 < frames[-1].frame_id  # Aravis begins near the end on purpose
    assert np.all(np.diff([frame.timestamp_ns for frame in frames]) > 1e6)


def test_no_trigger_is_lost_right_after_the_start(server):
    with opened() as camera:
        for _ in range(10):
            camera.configure(SETTINGS)
            shoot(camera)
            server.frame()


def test_a_frame_that_was_not_read_leaves_a_gap_in_the_ids(server):
    with opened() as camera:
        camera.configure(SETTINGS)
        first = shoot(camera)
        camera.fire()
        server.frame(), server.frame()
        time.sleep(0.2)
        third = shoot(camera)
        server.frame()
    assert third.frame_id - first.frame_id == 2


def test_the_settings_are_put_back_at_close(server):
    names = ("PixelFormat", "ExposureTimeAbs", "TriggerMode", "TriggerSource")
    values = ("BayerRG8", 4321.0, "Off", "Line0")
    with opened() as camera:
        for name, value in zip(names, values, strict=True):
            camera.features.set(name, value)
    with opened() as camera:
        camera.configure(CameraSettings(exposure_s=0.02))
        shoot(camera)
        server.frame()
        assert camera.features.get("TriggerMode") == "On"
    with opened() as camera:
        assert tuple(camera.features.get(name) for name in names) == values


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"exposure_s": 20.0}, r"exposure: Aravis Fake takes 1e-05 to 10 s, got 20 s"),
        ({"gain_db": 3.0}, r"gain: Aravis Fake does not state its gain in dB"),
    ],
)
def test_what_the_camera_cannot_take_is_one_line(server, settings, line):
    with opened() as camera, pytest.raises(ValueError, match=line) as error:
        camera.configure(CameraSettings(**({"exposure_s": 0.01} | settings)))
    assert "\n" not in str(error.value)


def test_a_line_trigger_waits_for_its_line(server):
    with opened() as camera:
        camera.configure(CameraSettings(exposure_s=0.01, trigger=Trigger.LINE))
        camera.arm()
        camera.wait_ready(1)
        with pytest.raises(ValueError, match="software trigger only"):
            camera.fire()
        with pytest.raises(FrameLostError, match="no frame"):
            camera.read(0.2)


@pytest.mark.slow(reason="Aravis asks a camera five times before it gives up")
def test_a_camera_in_use_and_one_that_is_not_there(server):
    with opened(), pytest.raises(ValueError, match=r"Fake CX03 is used by another program"):
        open_camera("aravis:")
    with pytest.raises(ValueError, match=r"^aravis:10\.1\.2\.3: there is no such .* seen: Aravis"):
        open_camera("aravis:10.1.2.3")


@pytest.mark.slow(reason="Aravis asks a camera five times before it gives up")
def test_a_camera_that_dies_in_mid_exposure_is_an_error_and_closes_at_once(server):
    # the last test of this module: its camera is gone
    with opened() as camera:
        camera.configure(CameraSettings(exposure_s=2.0))
        camera.arm()
        camera.wait_ready(1)
        camera.fire()
        server.frame()  # begins to expose
        server.process.kill()
        with pytest.raises(CameraError, match=r"Aravis Fake CX03 is gone: check power") as error:
            camera.read(0.5)
        assert not isinstance(error.value, FrameLostError)
        start_s = time.monotonic()
    assert time.monotonic() - start_s < 1  # not the seconds of Aravis's own time-outs
    with pytest.raises(ValueError, match="no camera is seen"):
        open_camera("aravis:")


def test_a_missing_library_says_how_to_install_it(monkeypatch):
    def absent(name):
        raise OSError(name)

    monkeypatch.setattr(ctypes, "CDLL", absent)
    aravis._library.cache_clear()
    with pytest.raises(ValueError, match=r"not installed: sudo apt-get install libaravis"):
        open_camera("aravis:")
    aravis._library.cache_clear()
