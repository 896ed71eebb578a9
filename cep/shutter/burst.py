"""Virtual shutter: frames of a fast video, linearised and summed by a code."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from cep.files.images import parse_gamma
from cep.optics.code import ShutterCode
from cep.shutter.cameras import path_and_settings
from hw.cameras.camera import Camera, CameraError, CameraSettings, Frame, FrameLostError, Trigger
from motdiff.files.decoding import decoder_output
from motdiff.photo_values import to_linear

_GAP = 1.5  # an interval that is longer than the median by this factor has lost a frame
_UNEVEN_SHARE = 0.05  # of the interval: frame times that vary by more are said
_CLIPPED_SHARE = 0.01


class BurstCamera(Camera):
    """A video as a camera with a shutter: each chip is a whole number of its frames.

    Parameters
    ----------
    path : Path
    start_s : float
        Of the first photo, s of the video; further ones follow it.
    gamma : str or float
        Curve of the video: ``srgb``, ``linear`` or an exponent.
    """

    name: ClassVar[str] = "burst"
    summary: ClassVar[str] = (
        "burst:VIDEO, frames of a slow-motion video summed by the code; #t=SECONDS is its start"
    )
    triggers: ClassVar[frozenset[Trigger]] = frozenset({Trigger.SOFTWARE})

    def __init__(self, path: Path, start_s: float, gamma: str | float) -> None:
        import cv2

        self.path = path
        with decoder_output():
            self._video = cv2.VideoCapture(str(path))
        self.frame_s = 1 / fps if (fps := self._video.get(cv2.CAP_PROP_FPS)) > 0 else math.nan
        self.frames = int(self._video.get(cv2.CAP_PROP_FRAME_COUNT))
        if not self._video.isOpened() or self.frames < 2 or not 0 < self.frame_s < 1:
            raise ValueError(f"camera: {path} is no video that OpenCV can read")
        self._next = round(start_s / self.frame_s)
        exponent = {"srgb": None, "linear": 1.0}.get(str(gamma), gamma)
        codes = np.arange(256) / 255
        self._light = to_linear(codes, gamma=exponent).astype(np.float32)  # type: ignore[arg-type]
        self._code: ShutterCode | None = None
        self._frames_a_chip = 1
        self._photos = 0
        self._armed = False

    @classmethod
    def open(cls, address: str) -> Self:
        """Open a video, as ``fall.mp4`` or ``fall.mp4#t=1.5&gamma=2.2``."""
        path, settings = path_and_settings(address, t="0", gamma="srgb")
        if not path.is_file():
            raise ValueError(f"camera: {path}: there is no such video")
        try:
            start_s = float(settings["t"])
        except ValueError:
            start_s = math.nan
        if not 0 <= start_s < 1e6:
            raise ValueError(f"camera: t must be seconds of the video, got {settings['t'][:40]!r}")
        return cls(path, start_s, parse_gamma(settings["gamma"]))

    def controller_port(self, port: str | None) -> None:
        """Refuse a port: the frames are the shutter."""
        if port is not None:
            raise ValueError("port: not valid with a burst, whose frames are its shutter")

    def plays(self, code: ShutterCode) -> ShutterCode:
        """Take a code, and return it with chips of whole frames, one at least.

        ValueError if the video is too short for it.
        """
        self._frames_a_chip = max(1, round(code.chip_ns * 1e-9 / self.frame_s))
        needed = code.chips * self._frames_a_chip
        if self._next + needed > self.frames:
            raise ValueError(
                f"camera: {self.path} has {max(0, self.frames - self._next)} frames from the start"
                f" on, the code takes {needed}: {code.chips} chips of {self._frames_a_chip}"
            )
        self._code = ShutterCode(code.bits, round(self._frames_a_chip * self.frame_s * 1e9))
        return self._code

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Return the settings: the video was exposed already."""
        return settings

    def arm(self) -> None:
        """Let the next frames of the video be summed."""
        self._armed = True

    def wait_ready(self, timeout_s: float) -> None:
        """Return at once."""

    def fire(self) -> None:
        """Begin at the next frame of the video."""

    def read(self, timeout_s: float) -> Frame:  # noqa: ARG002 - nothing is waited for
        """Sum the frames of the open chips; white is the light of all chips at white."""
        if self._code is None or not self._armed:
            raise FrameLostError(f"{self.path}: it was not armed with a code")
        import cv2

        self._armed = False
        code = self._code
        chips = np.repeat(code.array, self._frames_a_chip)
        self._video.set(cv2.CAP_PROP_POS_FRAMES, self._next)
        light: NDArray[np.float32] | None = None
        times_ms = []
        clipped = 0.0
        for number, is_open in enumerate(chips):
            was_read, frame = self._video.read()
            if not was_read:
                raise FrameLostError(
                    f"{self.path}: frame {self._next + number} cannot be decoded: choose another"
                    " start, #t=SECONDS"
                )
            times_ms.append(self._video.get(cv2.CAP_PROP_POS_MSEC))
            if is_open:
                # OpenCV gives blue first
                rgb = frame[:, :, ::-1] if frame.ndim == 3 else frame
                clipped += float(np.mean(rgb == 255))
                exposed = self._light[rgb]
                light = exposed if light is None else light + exposed
        assert light is not None
        self.warnings = self._doubts(np.diff(times_ms), clipped / chips.sum())
        self._next += chips.size
        self._photos += 1
        # the sum over the whole exposure: a dark chip counts as a frame of no light
        values = np.rint(light / chips.size * 65535).astype(np.uint16)
        if values.ndim == 3 and (values == values[:, :, :1]).all():
            values = np.ascontiguousarray(values[:, :, 0])
        return Frame(
            values=values,
            bits=16,
            frame_id=self._photos,
            exposure_s=code.duration_ns * 1e-9,
            camera=self.path.name,
        )

    def close(self) -> None:
        """Close the video."""
        self._video.release()

    def _doubts(self, intervals_ms: NDArray[Any], clipped: float) -> tuple[str, ...]:
        """Say in what the sum is not the photo that a shutter would have given."""
        doubts = [
            "a sum of frames: light between them is lost, and a phone's curve is only about sRGB's"
        ]
        median_ms = float(np.median(intervals_ms)) if intervals_ms.size else 0.0
        if median_ms > 0:
            gaps = int((intervals_ms > _GAP * median_ms).sum())
            spread = float(np.std(intervals_ms[intervals_ms <= _GAP * median_ms]) / median_ms)
            if gaps:
                raise CameraError(
                    f"{self.path}: {gaps} frames are missing within the code: choose another"
                    " start, #t=SECONDS"
                )
            if spread > _UNEVEN_SHARE:
                doubts.append(f"the frames' times vary by {spread:.0%} of their interval")
        if clipped > _CLIPPED_SHARE:
            doubts.append(f"{clipped:.1%} of the frames' pixels are white: light was lost there")
        return tuple(doubts)
