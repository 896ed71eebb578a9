"""Protocol of the cameras: configure, arm, fire, read a frame; choice of one that is connected."""

from __future__ import annotations

from collections.abc import Sequence
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

        ValueError if one is needed and not named, or named and not needed.
        """
        if port is None:
            raise ValueError(f"port: camera {self.name}: needs a controller; name its port")
        return port

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set the camera, and return what it really took.

        ValueError if it cannot: the exposure's bounds or its triggers are named.
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


@dataclass(frozen=True, slots=True)
class ConnectedCamera:
    """A camera that a library lists.

    Attributes
    ----------
    model : str
    names : tuple of str
        By which it can be named, its serial number first.
    """

    model: str
    names: tuple[str, ...]

    def __str__(self) -> str:
        # the camera's own words, which go to a terminal
        text = f"{self.model} {self.names[0]}"
        return "".join(character if character.isprintable() else "?" for character in text)[:80]


def choose_camera(kind: str, address: str, connected: Sequence[ConnectedCamera]) -> int:
    """Return the index of the camera that an address names; of the only one if it is empty.

    Raises
    ------
    ValueError
        If there is none, or more than one fits; the line lists them.

    Examples
    --------
    >>> cameras = [ConnectedCamera("acA1300", (name,)) for name in ("2201", "2202")]
    >>> choose_camera("pylon", "2202", cameras)
    1
    >>> choose_camera("pylon", "", cameras)
    Traceback (most recent call last):
    ...
    ValueError: pylon: 2 cameras fit: acA1300 2201, acA1300 2202; name one, as pylon:2201
    """
    if not connected:
        raise ValueError(
            f"{kind}: no camera is seen: check power and cable, and close its other programs"
        )
    fits = [
        index for index, camera in enumerate(connected) if not address or address in camera.names
    ]
    if not fits:
        listed = ", ".join(map(str, connected))
        raise ValueError(f"{kind}:{address[:80]}: there is no such camera; seen: {listed}")
    if len(fits) > 1:
        several = ", ".join(str(connected[index]) for index in fits)
        names = connected[fits[0]].names
        # a name that none of the others has, where there is one
        right = next((name for name in names if _owners(name, connected) == 1), names[0])
        raise ValueError(
            f"{kind}: {len(fits)} cameras fit: {several}; name one, as {kind}:{right}"
        )
    return fits[0]


def _owners(name: str, connected: Sequence[ConnectedCamera]) -> int:
    return sum(name in camera.names for camera in connected)
