"""Who begins an exposure, and what camera and controller need for it."""

from __future__ import annotations

from enum import StrEnum

from hw.cameras.camera import Trigger

NO_BUSY_OUTPUT = "cxp-rp2040"
"""Firmware without an output that is high while a code plays."""


class Release(StrEnum):
    """Who begins an exposure."""

    SHUTTER = "shutter"
    """This computer plays the code; the controller's output "busy" triggers the camera."""
    CAMERA = "camera"
    """This computer fires the camera; its output "exposure active" triggers the controller."""
    EXTERNAL = "external"
    """The machine triggers the controller, whose output "busy" triggers the camera."""
    HOST = "host"
    """This computer fires the camera, and plays the code a lead-in later, without a wire."""

    @property
    def fires(self) -> bool:
        """Whether this computer fires the camera, instead of a wire to its trigger input."""
        return self in (Release.CAMERA, Release.HOST)


def checked_release(
    triggers: frozenset[Trigger], kind: str, firmware: str, release: Release | None
) -> Release:
    """Return who begins an exposure; a ValueError says what camera or controller lack for it.

    Parameters
    ----------
    triggers : frozenset of Trigger
        Of the camera.
    kind : str
        Of camera.
    firmware : str
        Of the controller.
    release : Release or None
        None for the best that both can: the camera's own trigger input is preferred.
    """
    fires = Trigger.SOFTWARE in triggers
    has_input = Trigger.LINE in triggers
    has_busy = not firmware.startswith(NO_BUSY_OUTPUT)
    if release is None:
        return Release.SHUTTER if has_input and (has_busy or not fires) else Release.CAMERA
    if release.fires:
        if not fires:
            raise ValueError(
                f"release: this computer cannot fire a camera {kind}:; shutter and external can"
            )
        return release
    if not has_input:
        raise ValueError(f"release: camera {kind}: has no trigger input; camera and host fire it")
    if not has_busy and fires:
        raise ValueError(
            f'release: {firmware} has no output "busy" to trigger the camera; camera does without'
        )
    return release
