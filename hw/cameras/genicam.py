"""Cameras with GenICam features: exposure, trigger and pixel format set, and put back at close."""

from __future__ import annotations

import contextlib
import re
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Protocol

from hw.cameras.camera import Camera, CameraError, CameraSettings, Frame, FrameLostError, Trigger

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_NAME = re.compile(r"(?:Mono|Bayer(RG|GR|GB|BG))(?:(8|10|12|14|16)|(10|12)(p|Packed))")
# colours of the second row follow from the first: greens lie on a diagonal
_SECOND_ROW = {"RG": "GB", "GR": "BG", "GB": "RG", "BG": "GR"}
SETTLING_S = 0.1
"""Wait after the start of acquisition, for cameras that do not state when they are ready."""
_POLL_S = 0.002
_BLOCKS = 65535  # numbers of frames in GigE Vision 1, which leaves out 0

Value = str | float | bool


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A format of one value a pixel.

    Attributes
    ----------
    name : str
        By GenICam's convention (PFNC), as ``BayerRG12p``.
    bits : int
    packing : str
        ``p``: a stream of bits, the lowest first. ``Packed``: two pixels in three bytes, as GigE
        Vision has it. Empty: one or two bytes a pixel.
    bayer : str or None
        Colours of the first two rows, as ``RGGB``.
    """

    name: str
    bits: int
    packing: str
    bayer: str | None

    def unpack(
        self, data: bytes | memoryview, shape: tuple[int, int], *, padding: int = 0
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Return the (H, W) code values of an image; ``padding`` bytes follow each of its rows.

        ValueError if the data are too short for the shape.
        """
        import numpy as np  # not before a camera is opened

        height, width = shape
        octets = np.frombuffer(data, np.uint8)
        if padding:
            stride = self._bytes(width) + padding
            rows = octets[: height * stride].reshape(height, stride)[:, :-padding]
            values = np.concatenate([self._values(row, width) for row in rows])
        else:
            values = self._values(octets, height * width)
        return values.reshape(shape)

    def _bytes(self, pixels: int) -> int:
        if self.packing == "Packed":
            return (pixels * 3 + 1) // 2
        return (pixels * (self.bits if self.packing else 8 * (1 + (self.bits > 8))) + 7) // 8

    def _values(
        self, octets: NDArray[np.uint8], pixels: int
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        import numpy as np

        if len(octets) < self._bytes(pixels):
            raise ValueError(
                f"{len(octets)} bytes for {pixels} pixels of {self.name}: {self._bytes(pixels)}"
                " are needed"
            )
        octets = octets[: self._bytes(pixels)]
        # GenICam's numbers are little-endian, the array is in the machine's order
        if not self.packing:
            return octets.copy() if self.bits == 8 else octets.view("<u2").astype(np.uint16)
        # the shortest run of whole bytes that holds whole pixels
        group, count = (5, 4) if (self.packing, self.bits) == ("p", 10) else (3, 2)
        padded = np.zeros(-(-pixels // count) * group, np.uint16)
        padded[: len(octets)] = octets
        parts = padded.reshape(-1, group)
        values = np.empty((len(parts), count), np.uint16)
        if self.packing == "p":
            for pixel in range(count):
                byte, shift = divmod(pixel * self.bits, 8)
                values[:, pixel] = parts[:, byte] >> shift | parts[:, byte + 1] << (8 - shift)
            values &= 2**self.bits - 1
        else:  # the low bits of both pixels share the byte between their high ones
            low = self.bits - 8
            mask = 2**low - 1
            values[:, 0] = parts[:, 0] << low | parts[:, 1] & mask
            values[:, 1] = parts[:, 2] << low | parts[:, 1] >> 4 & mask
        return values.reshape(-1)[:pixels]


def pixel_format(name: str) -> PixelFormat | None:
    """Return the format of a name; None if it is neither monochrome nor Bayer.

    Examples
    --------
    >>> pixel_format("BayerRG12p")
    PixelFormat(name='BayerRG12p', bits=12, packing='p', bayer='RGGB')
    >>> pixel_format("RGB8") is None
    True
    """
    if (match := _NAME.fullmatch(name)) is None:
        return None
    first, unpacked, packed, packing = match.groups()
    bayer = first and first + _SECOND_ROW[first]
    return PixelFormat(name, int(unpacked or packed), packing or "", bayer)


def deepest(names: tuple[str, ...]) -> PixelFormat | None:
    """Return the format of most bits, unpacked rather than packed; None if none fits.

    Of a camera with one Bayer pattern it is that of the sensor: its monochrome ones are computed
    from it. A camera that offers several patterns is an emulated one, and has a grey picture.

    Examples
    --------
    >>> deepest(("Mono8", "Mono12p", "Mono12", "RGB8")).name
    'Mono12'
    >>> deepest(("Mono12", "BayerRG8", "BayerRG12")).name
    'BayerRG12'
    """
    formats = [layout for name in names if (layout := pixel_format(name)) is not None]
    mosaic = len({layout.bayer for layout in formats} - {None}) == 1
    return max(
        formats,
        key=lambda layout: ((layout.bayer is not None) == mosaic, layout.bits, not layout.packing),
        default=None,
    )


class Features(Protocol):
    """Features of a camera by their names in GenICam's standard (SFNC).

    Every method raises CameraError if the camera refuses or is gone.
    """

    def available(self, name: str) -> bool:
        """Whether the camera has the feature, in its present state."""

    def get(self, name: str) -> Value:
        """Value: an enumeration's as text."""

    def set(self, name: str, value: Value) -> None:
        """Change it."""

    def entries(self, name: str) -> tuple[str, ...]:
        """Values of an enumeration that can be set now."""

    def bounds(self, name: str) -> tuple[float, float]:
        """Least and largest value of a number."""

    def unit(self, name: str) -> str:
        """Return the unit of a number, as ``dB``; empty where none is stated."""

    def execute(self, name: str) -> None:
        """Run a command."""


class GenicamCamera(Camera, ABC):
    """An open GenICam camera; a subclass delivers its frames.

    Every change is noted with the value before it, and undone in reverse order at close.

    Parameters
    ----------
    features : Features
    camera, serial : str
        Model and serial number.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    triggers: ClassVar[frozenset[Trigger]] = frozenset(Trigger)

    def __init__(self, features: Features, *, camera: str, serial: str) -> None:
        self.features = features
        self.camera = camera
        self.serial = serial
        self._changes: list[tuple[str, Value]] = []
        self._settings: CameraSettings | None = None
        self._format = PixelFormat("Mono8", 8, "", None)
        self._armed_s: float | None = None
        self._block: int | None = None  # of the latest frame since acquisition began
        self._gone = False  # a camera that does not answer costs seconds at each question

    # -- what a subclass supplies -------------------------------------------------------------

    @abstractmethod
    def _start(self) -> None:
        """Start acquisition."""

    @abstractmethod
    def _stop(self) -> None:
        """Stop acquisition, and drop what is queued."""

    @abstractmethod
    def _drop(self) -> None:
        """Drop frames that have arrived and were not read; their ids leave a gap."""

    @abstractmethod
    def _release(self) -> None:
        """Close the device."""

    @abstractmethod
    def read(self, timeout_s: float) -> Frame:
        """Wait for the frame of the last trigger; errors as the protocol."""

    # -- the protocol -------------------------------------------------------------------------

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set the deepest format, trigger, exposure and gain; return what the camera took.

        Automatic exposure, gain and frame rate are switched off.
        """
        self._halt()
        self._format = self._deepest_format()
        self._change("PixelFormat", self._format.name)
        for name, value in (
            ("ExposureAuto", "Off"),
            ("GainAuto", "Off"),
            ("AcquisitionFrameRateEnable", False),
            ("AcquisitionMode", "Continuous"),
        ):
            if self.features.available(name):
                self._change(name, value)
        self._change_trigger(settings.trigger)
        self._settings = replace(
            settings,
            exposure_s=self._change_exposure(settings.exposure_s),
            gain_db=self._change_gain(settings.gain_db),
        )
        return self._settings

    def arm(self) -> None:
        """Start acquisition where it does not run, and drop frames of earlier triggers."""
        if self._settings is None:
            raise ValueError("configure the camera before it is armed")
        if self._armed_s is None:
            self._block = None
            self._start()
            self._armed_s = time.monotonic()
        else:
            self._drop()

    def wait_ready(self, timeout_s: float) -> None:
        """Wait until the camera states that it awaits a trigger, or else has had time to settle.

        Without either, a trigger right after the start of acquisition is lost now and then.
        """
        start_s = time.monotonic()
        if self._armed_s is None:
            raise ValueError("arm the camera before it can be ready")
        selector = "AcquisitionStatusSelector"
        if not self.features.available(selector) or "FrameTriggerWait" not in (
            self.features.entries(selector)
        ):
            time.sleep(min(max(0.0, self._armed_s + SETTLING_S - start_s), timeout_s))
            return
        self._change(selector, "FrameTriggerWait")
        while not self.features.get("AcquisitionStatus"):
            if time.monotonic() - start_s > timeout_s:
                raise self._not_ready(timeout_s)
            time.sleep(_POLL_S)

    def fire(self) -> None:
        """Trigger by software."""
        if self._settings is None or self._settings.trigger is not Trigger.SOFTWARE:
            raise ValueError("trigger: the camera fires by itself with the software trigger only")
        self.features.execute("TriggerSoftware")

    def close(self) -> None:
        """Stop, put back every setting in reverse order, and release the camera."""
        with contextlib.suppress(CameraError):  # it may be gone by now
            if not self._gone:
                self._halt()
                while self._changes:
                    self.features.set(*self._changes.pop())
        self._changes.clear()
        self._release()

    # -- settings -----------------------------------------------------------------------------

    def _halt(self) -> None:
        if self._armed_s is not None:
            self._armed_s = None
            self._stop()

    def _change(self, name: str, value: Value) -> None:
        before = self.features.get(name)
        # what stays as it is need not be put back
        if before != value:
            self.features.set(name, value)
            self._changes.append((name, before))

    def _deepest_format(self) -> PixelFormat:
        names = self.features.entries("PixelFormat")
        if (best := deepest(names)) is None:
            raise ValueError(
                f"camera: {self.camera} has {', '.join(names)}: none is monochrome or Bayer"
            )
        return best

    def _change_trigger(self, trigger: Trigger) -> None:
        features = self.features
        if features.available("TriggerSelector"):
            selectors = features.entries("TriggerSelector")
            if "FrameStart" not in selectors:
                raise ValueError(
                    f"trigger: {self.camera} has no FrameStart trigger; it has"
                    f" {', '.join(selectors)}"
                )
            for selector in selectors:
                self._change("TriggerSelector", selector)
                if selector != "FrameStart" and features.available("TriggerMode"):
                    self._change("TriggerMode", "Off")  # it would hold FrameStart's back
            self._change("TriggerSelector", "FrameStart")
        self._change("TriggerMode", "On")
        self._change("TriggerSource", self._trigger_source(trigger))
        if features.available("ExposureMode"):
            modes = features.entries("ExposureMode")
            if "Timed" not in modes:
                raise ValueError(
                    f"camera: {self.camera} does not expose by Timed, only by {', '.join(modes)}"
                )
            self._change("ExposureMode", "Timed")
        if trigger is not Trigger.SOFTWARE and features.available("TriggerActivation"):
            self._change("TriggerActivation", "RisingEdge")

    def _trigger_source(self, trigger: Trigger) -> str:
        sources = self.features.entries("TriggerSource")
        prefix = "Software" if trigger is Trigger.SOFTWARE else "Line"
        present = str(self.features.get("TriggerSource"))
        fits = [source for source in sources if source.startswith(prefix)]
        if trigger is Trigger.SOFTWARE:
            fits = [source for source in fits if source == prefix]
        if not fits:
            raise ValueError(
                f"trigger: {self.camera} has no trigger source {prefix}; it has"
                f" {', '.join(sources)}"
            )
        return present if present in fits else fits[0]  # the input that the user had chosen

    def _change_exposure(self, exposure_s: float) -> float:
        names = ("ExposureTime", "ExposureTimeAbs")
        name = next(filter(self.features.available, names), None)
        if name is None:
            raise ValueError(f"exposure: {self.camera} has no exposure time to set")
        lower_us, upper_us = self.features.bounds(name)
        if not lower_us <= exposure_s * 1e6 <= upper_us:
            raise ValueError(
                f"exposure: {self.camera} takes {lower_us * 1e-6:g} to {upper_us * 1e-6:g} s,"
                f" got {exposure_s:g} s"
            )
        self._change(name, exposure_s * 1e6)
        return float(self.features.get(name)) * 1e-6

    def _change_gain(self, gain_db: float | None) -> float | None:
        features = self.features
        in_db = features.available("Gain") and features.unit("Gain").lower() in ("", "db")
        if gain_db is not None:
            if not in_db:
                raise ValueError(f"gain: {self.camera} does not state its gain in dB")
            lower, upper = features.bounds("Gain")
            if not lower <= gain_db <= upper:
                raise ValueError(
                    f"gain: {self.camera} takes {lower:g} to {upper:g} dB, got {gain_db:g}"
                )
            self._change("Gain", float(gain_db))
        return float(features.get("Gain")) if in_db else None

    # -- frames -------------------------------------------------------------------------------

    def _not_ready(self, timeout_s: float) -> FrameLostError:
        return FrameLostError(f"{self.camera} is not ready for a trigger after {timeout_s:g} s")

    def _no_frame(self, timeout_s: float) -> FrameLostError:
        return FrameLostError(f"{self.camera}: no frame within {timeout_s:g} s of waiting")

    def _frame(
        self,
        data: bytes | memoryview,
        *,
        shape: tuple[int, int],
        padding: int,
        block: int,
        timestamp_ns: int,
    ) -> Frame:
        """Unpack a frame's bytes; FrameLostError if there are too few.

        ``block`` is the camera's own number of the frame: GigE Vision's goes to 65535, and on from
        1.
        """
        settings = self._settings
        assert settings is not None
        advance = 0 if self._block is None else self._block - block
        frame_id = block + (advance + _BLOCKS // 2) // _BLOCKS * _BLOCKS
        self._block = frame_id
        try:
            values = self._format.unpack(data, shape, padding=padding)
        except ValueError as error:
            raise FrameLostError(f"{self.camera}: incomplete frame {frame_id}: {error}") from None
        return Frame(
            values=values,
            bits=self._format.bits,
            frame_id=frame_id,
            camera=self.camera,
            serial=self.serial,
            bayer=self._format.bayer,
            exposure_s=settings.exposure_s,
            gain_db=settings.gain_db,
            timestamp_ns=timestamp_ns or None,  # 0 from cameras without a clock
        )
