"""Cameras that ``cep shoot`` knows: those of hardware, and those that need photographs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from hw import cameras as hardware

CAMERAS: Mapping[str, str] = MappingProxyType(
    {
        **hardware.CAMERAS,
        "folder": "cep.shutter.folder:FolderCamera",
        "gphoto2": "cep.shutter.gphoto2:Gphoto2Camera",
        "burst": "cep.shutter.burst:BurstCamera",
        "twin": "cep.shutter.twin:TwinCamera",
    }
)
"""As :data:`hw.cameras.CAMERAS`, with those that read photos or simulate them."""


def path_and_settings(address: str, **settings: str) -> tuple[Path, dict[str, str]]:
    """Split an address as ``photos#gamma=linear`` into a path and settings.

    Parameters
    ----------
    **settings : str
        Those that are known, with their defaults.

    Raises
    ------
    ValueError
        If the path is missing, or a setting is not known.

    Examples
    --------
    >>> path_and_settings("fall.mp4#t=1.5", t="0", gamma="srgb")[1]
    {'t': '1.5', 'gamma': 'srgb'}
    """
    path, _, fragment = address.partition("#")
    if not path:
        raise ValueError("camera: a path is needed behind the colon")
    for item in filter(None, fragment.split("&")):
        name, equals, value = item.partition("=")
        if name not in settings or not equals:
            names = " and ".join(f"{name}=" for name in settings)
            raise ValueError(f"camera: {item[:40]!r} is not known behind #; known are {names}")
        settings[name] = value
    return Path(path), settings
