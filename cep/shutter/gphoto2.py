"""Photo cameras on USB by libgphoto2: a listed shutter speed or bulb, and an external shutter."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, Self

from cep.shutter.folder import FolderCamera
from hw.cameras.camera import (
    Camera,
    CameraError,
    CameraSettings,
    ConnectedCamera,
    Frame,
    FrameLostError,
    Trigger,
    choose_camera,
)
from hw.errors import one_line

_SPEED = re.compile(r"(?:1/)?\d+(?:\.\d+)?s?")
_SPEED_NAMES = ("shutterspeed2", "shutterspeed")  # Nikon's first has exact fractions
_BULB = "bulb"
_EVENT_MS = 100  # some cameras answer a shorter question before they look
_DECODED_S = 2.0


class Gphoto2Camera(Camera):
    """A photo camera on USB, fired by this computer.

    Parameters
    ----------
    device : gphoto2.Camera
        Initialised, owned by the camera from now on.
    model, port : str
    """

    name: ClassVar[str] = "gphoto2"
    summary: ClassVar[str] = "photo cameras on USB: pip install coded-exposure[gphoto2]"
    triggers: ClassVar[frozenset[Trigger]] = frozenset({Trigger.SOFTWARE})

    def __init__(self, device: Any, *, model: str, port: str) -> None:
        self.camera = model
        self.port = port
        self._device = device
        self._photos = TemporaryDirectory()
        self._folder = FolderCamera.open(self._photos.name)
        self._settings = CameraSettings(exposure_s=0.0)
        self._changes: list[tuple[str, str]] = []
        self._bulb = False
        self._opened_s: float | None = None
        self._frames = 0
        self._stem = ""  # of the photo read since the camera was armed

    @classmethod
    def open(cls, address: str) -> Self:
        """Open the camera of a model or a port as ``usb:001,004``; the only one if empty."""
        try:
            import gphoto2
        except ImportError:
            raise ValueError(
                "gphoto2: its library is not installed: pip install coded-exposure[gphoto2]"
            ) from None
        listed = gphoto2.Camera.autodetect()
        ports = [
            (listed.get_name(index), listed.get_value(index)) for index in range(listed.count())
        ]
        connected = [ConnectedCamera(model, (port, model)) for model, port in ports]
        model, port = ports[choose_camera(cls.name, address, connected)]
        device = gphoto2.Camera()
        try:
            infos = gphoto2.PortInfoList()
            infos.load()
            device.set_port_info(infos[infos.lookup_path(port)])
            device.init()
        except gphoto2.GPhoto2Error as error:
            raise ValueError(
                f"gphoto2: {model} {port} cannot be opened ({one_line(error)}): close the program"
                " that uses it; a desktop's file manager does"
            ) from None
        return cls(device, model=model, port=port)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Take the shortest listed speed that is long enough, or else bulb."""
        if settings.trigger is not Trigger.SOFTWARE:
            raise ValueError(f"trigger: {self.camera} is fired by this computer, by USB, alone")
        if settings.gain_db is not None:
            raise ValueError(f"gain: set ISO at {self.camera} itself")
        with _errors():
            names = [name for name in _SPEED_NAMES if self._has(name)]
            choices = self._choices(names[0]) if names else ()
            speeds = {speed: choice for choice in choices if (speed := seconds(choice))}
            fits = [speed for speed in speeds if speed >= settings.exposure_s * (1 - 1e-3)]
            self._bulb = not fits and any(choice.lower() == _BULB for choice in choices)
            if not fits and not self._bulb:
                listed = f"{min(speeds):g} to {max(speeds):g} s" if speeds else "no speed"
                raise ValueError(
                    f"exposure: {self.camera} has {listed} and no bulb, got"
                    f" {settings.exposure_s:g} s; turn its dial to M or B"
                )
            exposure_s = settings.exposure_s if self._bulb else min(fits)
            choice = speeds.get(exposure_s) or next(
                choice for choice in choices if choice.lower() == _BULB
            )
            self._change(names[0], choice)
        self._settings = replace(settings, exposure_s=exposure_s)
        return self._settings

    def arm(self) -> None:
        """Pass over photos that the camera has announced."""
        import gphoto2

        with _errors():
            while self._device.wait_for_event(_EVENT_MS)[0] != gphoto2.GP_EVENT_TIMEOUT:
                pass
        self._folder.arm()
        self._stem = ""

    def wait_ready(self, timeout_s: float) -> None:
        """Return at once: the camera states nothing about it."""

    def fire(self) -> None:
        """Release the shutter; in bulb, open it."""
        with _errors():
            if self._bulb:
                self._set(_BULB, 1)
                self._opened_s = time.monotonic()
            else:
                self._device.trigger_capture()

    def read(self, timeout_s: float) -> Frame:
        """End a bulb exposure when its time is over, and download the photo."""
        import gphoto2

        deadline = time.monotonic() + timeout_s
        if self._opened_s is not None:
            time.sleep(max(0.0, self._opened_s + self._settings.exposure_s - time.monotonic()))
            self._close_bulb()
        with _errors():
            while time.monotonic() < deadline:
                kind, path = self._device.wait_for_event(_EVENT_MS)
                # one photo may come as a RAW file and as a JPEG: the first is taken
                if kind == gphoto2.GP_EVENT_FILE_ADDED and Path(path.name).stem != self._stem:
                    self._stem = Path(path.name).stem
                    return self._download(path)
        raise FrameLostError(f"{self.camera}: no photo within {timeout_s:g} s")

    def close(self) -> None:
        """End a bulb exposure, put the speed back, and release the camera."""
        with contextlib.suppress(CameraError):
            self._close_bulb()
        with contextlib.suppress(CameraError), _errors():
            while self._changes:
                self._set(*self._changes.pop())
        with contextlib.suppress(CameraError), _errors():
            self._device.exit()
        self._photos.cleanup()

    def _download(self, path: Any) -> Frame:
        import gphoto2

        self._frames += 1
        file = Path(self._photos.name, f"{self._frames}{Path(path.name).suffix}")
        photo = self._device.file_get(path.folder, path.name, gphoto2.GP_FILE_TYPE_NORMAL)
        photo.save(str(file))
        try:
            frame = self._folder.read(_DECODED_S)
        finally:
            file.unlink(missing_ok=True)
        return replace(
            frame,
            frame_id=self._frames,
            camera=self.camera,
            serial=self.port,
            exposure_s=self._settings.exposure_s,
        )

    def _has(self, name: str) -> bool:
        import gphoto2

        try:
            self._device.get_single_config(name)
        except gphoto2.GPhoto2Error:
            return False
        return True

    def _choices(self, name: str) -> tuple[str, ...]:
        widget = self._device.get_single_config(name)
        return tuple(widget.get_choice(index) for index in range(widget.count_choices()))

    def _set(self, name: str, value: str | int) -> None:
        widget = self._device.get_single_config(name)
        widget.set_value(value)
        self._device.set_single_config(name, widget)

    def _change(self, name: str, value: str) -> None:
        before = self._device.get_single_config(name).get_value()
        if before != value:
            self._set(name, value)
            self._changes.append((name, before))

    def _close_bulb(self) -> None:
        if self._opened_s is not None:
            self._opened_s = None
            try:
                with _errors():
                    self._set(_BULB, 0)
            except CameraError as error:
                raise CameraError(
                    f"{self.camera}: its bulb exposure does not end, switch it off ({error})"
                ) from None


def seconds(speed: str) -> float | None:
    """Return the time of a listed shutter speed; None of one that is none, as ``bulb``.

    Examples
    --------
    >>> [seconds(speed) for speed in ("1/250", "0.0100s", "30", "bulb")]
    [0.004, 0.01, 30.0, None]
    """
    if not _SPEED.fullmatch(speed):
        return None
    number = speed.removesuffix("s")
    if number.startswith("1/"):
        return 1 / float(number[2:]) if float(number[2:]) else None
    return float(number)


@contextlib.contextmanager
def _errors() -> Iterator[None]:
    """Raise libgphoto2's errors as CameraError, one line each."""
    import gphoto2

    try:
        yield
    except gphoto2.GPhoto2Error as error:
        raise CameraError(f"gphoto2: {one_line(error)}") from None
