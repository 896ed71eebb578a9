"""Protocol of the cameras: configure, arm, fire, read a frame."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar, Protocol, Self

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class CameraError(RuntimeError):
    """The camera failed, or is gone."""


class FrameLostError(CameraError):
    """No frame came in time, or an incomplete one."""


class Trigger(StrEnum):
    """What begins an exposure."""

    SOFTWARE = "software"
    """``fire``."""
    LINE = "line"
    """An edge on the camera's trigger input."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    """What an exposure is taken with.

    Attributes
    ----------
    exposure_s : float
        Whole exposure, s, lead-in and code within it.
    trigger : Trigger
    gain_db : float or None
        The camera's own where None.
    """

    exposure_s: float
    trigger: Trigger = Trigger.SOFTWARE
    gain_db: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """A frame as the camera delivered it: whole code values, nothing scaled.

    Attributes
    ----------
    values : (H, W) uint8 or uint16 array; (H, W, 3) where the camera delivers colours only
    bits : int
        Depth: white is ``2**bits - 1``.
    black_level : float or None
        Code value of no light, where the camera states it.
    bayer : str or None
        Colours of the first two rows and columns, as ``RGGB``.
    exposure_s : float or None
        As the camera states it.
    gain_db : float or None
    frame_id : int
        Counted by the camera, or by the adapter where it does not: a gap is a lost frame.
    timestamp_ns : int or None
        By the camera's clock.
    camera, serial : str
        Model and serial number.
    gamma : {"linear", "srgb"}
        Curve of the code values: that of finished pictures, as a JPEG, is ``srgb``.
    """

    values: NDArray[np.uint8] | NDArray[np.uint16]
    bits: int
    frame_id: int
    camera: str
    serial: str = ""
    black_level: float | None = None
    bayer: str | None = None
    exposure_s: float | None = None
    gain_db: float | None = None
    timestamp_ns: int | None = None
    gamma: str = "linear"


class Camera(Protocol):
    """An open camera, a context manager that leaves the camera as it was found.

    Adapters inherit it, and with it what a context manager needs.

    Attributes
    ----------
    name : str
        Kind, as ``pylon``: what stands before the colon in ``--camera pylon:ADDRESS``.
    summary : str
        One line for help pages: which cameras, and what has to be installed.
    triggers : frozenset of Trigger
    warnings : tuple of str
        What its photos are not sure of, or lack.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    triggers: ClassVar[frozenset[Trigger]]
    warnings: tuple[str, ...] = ()

    @classmethod
    def open(cls, address: str) -> Self:
        """Open the camera at an address (a serial number, an IP, a folder); the only one if empty.

        Raises
        ------
        ValueError
            If there is no such camera (the line lists those seen), several fit, it is used by
            another program, or a library is missing (the line says how to install it).
        """

    def controller_port(self, port: str | None) -> str | None:
        """Return the port of its shutter's controller, by the one named; None if it has none.

        Raises
        ------
        ValueError
            If one is needed and not named, or named and not needed.
        """
        if port is None:
            raise ValueError(f"port: camera {self.name}: needs a controller; name its port")
        return port

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set the camera, and return what it really took.

        Raises
        ------
        ValueError
            If it cannot: the exposure's bounds or its triggers are named.
        """

    def arm(self) -> None:
        """Let the next trigger expose one frame."""

    def wait_ready(self, timeout_s: float) -> None:
        """Wait until a trigger would not be lost; FrameLostError when it does not become so."""

    def fire(self) -> None:
        """Trigger by software; returns at once."""

    def read(self, timeout_s: float) -> Frame:
        """Wait for the frame of the last trigger.

        Raises
        ------
        FrameLostError
            If none came in time, or an incomplete one.
        CameraError
            If the camera is gone.
        """

    def close(self) -> None:
        """Stop, put the camera's settings back and release it; never raises for a camera gone."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.close()
