"""Choice of a camera among those that are connected, by its serial number, name or address."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


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
