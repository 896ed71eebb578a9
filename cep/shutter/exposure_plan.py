"""Exposure that holds a code: who begins it, the closed time before the code, the least length."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from cep.optics.camera import Camera as NoiseModel
from cep.optics.code import ShutterCode
from hw.cameras.camera import Trigger
from hw.program import Program
from motdiff.trajectory import Trajectory

NO_BUSY_OUTPUT = "cxp-rp2040"
"""Firmware without an output that is high while a code plays."""
LEAD_IN_S = 0.001
"""Closed time before the code: the camera may begin to expose so late, s."""

_MARGIN_S = 0.0005  # of the exposure beyond the code, for the jitter of its start
_HOST_MARGIN_S = 0.05  # where no wire times the code
_CLOCK_SHARE = 0.002  # and for the error of two clocks: ceramic resonators


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


@dataclass(frozen=True, kw_only=True)
class ShotSettings:
    """What a photo through a code is taken with.

    Attributes
    ----------
    release : Release or None
        Who begins; the camera's own trigger input is preferred where None.
    motion : Trajectory or None
        Of the image during the code, where it is known.
    profile : cep.optics.camera.Camera or None
        The camera's figures: its noise, for the restoration, and, where ``cep hw timing`` has
        measured them, its times.
    lead_in_s : float or None
        Closed time before the code, s, in whole chips: by so much the camera may be late. That of
        the profile where None, or :data:`LEAD_IN_S`.
    exposure_s : float or None
        The least that holds the code where None.
    gain_db : float or None
        The camera's own where None.
    wait_s : float
        For the machine's own trigger, or another program's photo.

    Examples
    --------
    >>> import cep
    >>> cep.ShotSettings(motion=cep.Trajectory.straight(52), exposure_s=0.02).closed_s()
    0.001
    """

    release: Release | None = None
    motion: Trajectory | None = None
    profile: NoiseModel | None = None
    lead_in_s: float | None = None
    exposure_s: float | None = None
    gain_db: float | None = None
    wait_s: float = 10.0

    @property
    def measured_s(self) -> float:
        """Lead-in by the times of the profile; 0 where they were not measured."""
        return 0.0 if self.profile is None else self.profile.lead_in_s

    def closed_s(self) -> float:
        """Return the closed time before the code; a ValueError where it cannot be."""
        lead_in_s = self.lead_in_s
        if lead_in_s is None:
            return self.measured_s or LEAD_IN_S
        if not (math.isfinite(lead_in_s) and 0 <= lead_in_s <= 1):
            raise ValueError(f"lead_in: must be a time within 0..1 s, got {lead_in_s:g} s")
        if lead_in_s < self.measured_s:
            raise ValueError(
                f"lead_in: {1e3 * lead_in_s:.6g} ms is less than the camera's delay,"
                f" {1e3 * self.measured_s:.6g} ms by its profile"
            )
        return lead_in_s


@dataclass(frozen=True, kw_only=True)
class ExposurePlan:
    """Times of an exposure that holds a code.

    Attributes
    ----------
    program : Program
        Of the shutter: the closed chips, then the code.
    lead_ns : int
        From the controller's trigger to the first chip.
    wait_s : float
        From this computer's firing of the camera until it plays the code.
    play_s : float
        From the trigger to the code's end: an exposure that is shorter does not hold it.
    least_exposure_s : float
        That with a margin for jitter, clocks and the camera's own times.
    """

    release: Release
    program: Program
    lead_ns: int
    wait_s: float
    play_s: float
    least_exposure_s: float

    @classmethod
    def of(
        cls, code: ShutterCode, settings: ShotSettings, release: Release, *, board_lead_ns: int
    ) -> Self:
        """Plan the exposure of a code; a ValueError says which setting cannot be.

        ``board_lead_ns`` passes from the controller's trigger to its program's begin.
        """
        closed_s = settings.closed_s()
        wait_s = closed_s if release is Release.HOST else 0.0
        closed_chips = math.ceil((closed_s - wait_s) * 1e9 / code.chip_ns - 1e-9)
        lead_ns = board_lead_ns + closed_chips * code.chip_ns
        # late by the lead-in at most, the exposure still holds the code's first chip and last
        play_s = wait_s + 1e-9 * (lead_ns + code.duration_ns)
        margin_s = _HOST_MARGIN_S if release is Release.HOST else _MARGIN_S
        least_s = play_s * (1 + _CLOCK_SHARE) + margin_s
        if settings.profile is not None:
            least_s = max(least_s, settings.profile.least_stated_s(play_s))
        return cls(
            release=release,
            program=Program("0" * closed_chips + code.bits, chip_ns=code.chip_ns),
            lead_ns=lead_ns,
            wait_s=wait_s,
            play_s=play_s,
            least_exposure_s=least_s,
        )

    def check(self, exposure_s: float) -> None:
        """Refuse an exposure that does not hold the code."""
        if exposure_s < self.play_s:
            raise ValueError(
                f"exposure: {1e3 * exposure_s:.6g} ms is shorter than the code with its lead-in,"
                f" {1e3 * self.play_s:.6g} ms; set {1e3 * self.least_exposure_s:.6g} ms or more"
            )
