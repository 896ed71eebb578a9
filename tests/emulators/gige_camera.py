"""Aravis's emulated GigE Vision camera on the loopback network, with pictures of ours.

As a program it serves the array of a ``.npy`` file until it is killed, and prints the exposure and
the gain of each frame: ``python gige_camera.py picture.npy``.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import select
import subprocess
import sys
import tempfile
import time
from ctypes import c_char_p, c_size_t, c_uint32, c_void_p
from pathlib import Path

import numpy as np

ADDRESS = "127.0.0.1"
SERIAL = "CX03"
_FILL = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, c_uint32, c_uint32, c_uint32)
_START_S = 20


def serve(fill, *, address=ADDRESS, serial=SERIAL):
    """Start the camera in this process; keep what is returned as long as it shall live.

    ``fill(width, height, exposure_us, gain) -> bytes`` is called for each frame.
    """
    library = ctypes.CDLL("libaravis-0.8.so.0")

    def function(name, result, *arguments):
        call = getattr(library, f"arv_{name}")
        call.restype = result
        call.argtypes = arguments
        return call

    data_of = function("buffer_get_data", c_void_p, c_void_p, ctypes.POINTER(c_size_t))
    width_of = function("buffer_get_image_width", ctypes.c_int, c_void_p)
    height_of = function("buffer_get_image_height", ctypes.c_int, c_void_p)

    @_FILL
    def callback(buffer, _, exposure_us, gain, pixel_format):
        width, height = width_of(buffer), height_of(buffer)
        frame = fill(width, height, exposure_us, gain)
        bits = pixel_format >> 16 & 0xFF  # of a pixel, in every number of a format
        ctypes.memmove(data_of(buffer, None), frame, min(len(frame), width * height * bits // 8))

    new = function("gv_fake_camera_new", c_void_p, c_char_p, c_char_p)
    server = new(address.encode(), serial.encode())
    camera = function("gv_fake_camera_get_fake_camera", c_void_p, c_void_p)(server)
    function("fake_camera_set_fill_pattern", None, c_void_p, _FILL, c_void_p)(
        camera, callback, None
    )
    return server, callback


@contextlib.contextmanager
def only_camera():
    """Wait for tests of other processes: the port number is GigE Vision's own."""
    with Path(tempfile.gettempdir(), "coded-exposure-gige-camera.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


class GigeCamera:
    """The camera in a process of its own, which can be killed; one at a time on this machine."""

    def __init__(self, picture):
        self._resources = contextlib.ExitStack()
        self._picture = picture
        self.process = None

    def __enter__(self):
        self._resources.enter_context(only_camera())
        folder = Path(self._resources.enter_context(tempfile.TemporaryDirectory()))
        np.save(folder / "picture.npy", self._picture)
        self.process = subprocess.Popen(
            [sys.executable, __file__, folder / "picture.npy"],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert select.select([self.process.stdout], [], [], _START_S)[0], "it did not start"
        assert self.process.stdout.readline() == "ready\n"
        return self

    def frame(self):
        """Exposure, us, and gain of the next frame that was filled."""
        return tuple(int(word) for word in self.process.stdout.readline().split())

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        self._resources.close()


if __name__ == "__main__":
    bytes_of_picture = np.load(sys.argv[1]).tobytes()

    def fill_with_picture(width, height, exposure_us, gain):
        sys.stdout.write(f"{exposure_us} {gain}\n")
        sys.stdout.flush()
        time.sleep(exposure_us * 1e-6)  # Aravis's own delivers at once
        return bytes_of_picture

    camera_lives = serve(fill_with_picture)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    select.select([], [], [])
