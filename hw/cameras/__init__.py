"""Cameras: one protocol, and adapters that are loaded when they are named."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

from hw.cameras.camera import Camera

__all__ = ["CAMERAS", "Camera", "camera_class", "open_camera"]

CAMERAS: Mapping[str, str] = MappingProxyType(
    {"aravis": "hw.cameras.aravis:AravisCamera", "pylon": "hw.cameras.pylon:PylonCamera"}
)
"""Kind of camera to ``module:Class`` of its adapter, which is imported when the kind is named.

The module itself imports no vendor's library: ``Camera.open`` does.
"""


def camera_class(kind: str, kinds: Mapping[str, str] = CAMERAS) -> type[Camera]:
    """Import the adapter of a kind of camera.

    ValueError if the kind is not known; the line lists those that are.
    """
    if kind not in kinds:
        listed = ", ".join(f"{name}:" for name in sorted(kinds))
        raise ValueError(f"camera: kind {kind[:40]!r} is not known; known are {listed}")
    module, _, name = kinds[kind].partition(":")
    adapter: type[Camera] = getattr(import_module(module), name)
    return adapter


def open_camera(name: str, kinds: Mapping[str, str] = CAMERAS) -> Camera:
    """Open the camera of a name ``kind:address``; the address may hold colons, or be empty.

    ValueError if there is no such kind, or no such camera; the line lists those that are.
    """
    kind, colon, address = name.partition(":")
    if not colon:
        raise ValueError(
            f"camera: {name[:40]!r} has no colon; write kind:address, or kind: for the only one"
        )
    return camera_class(kind, kinds).open(address)
