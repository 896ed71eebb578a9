"""Protocol of the drivers: capabilities, upload with its report, arm, play, status and abort."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar, Protocol, Self

from hw.cxp.protocol import Status
from hw.device import DeviceProfile
from hw.program import Program

LEASE_MS = 10_000
"""After this an armed device disarms itself, where it can and no other lease is wanted, ms."""


class Trust(StrEnum):
    """Level of evidence that a shutter plays the program."""

    A = "A"
    """The device sent its stored program back identical, and its firmware's edges are proven on
    emulated hardware."""
    B = "B"
    """The device acknowledged the program, and no more is known."""
    C = "C"
    """A file was written; no device was involved."""

    @property
    def meaning(self) -> str:
        """Meaning of the level, in a few words."""
        return _MEANINGS[self]


_MEANINGS = {
    Trust.A: "read back, edge timing proven on emulated hardware",
    Trust.B: "acknowledged only",
    Trust.C: "file only",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Capabilities:
    """What a kind of device can do besides storing and playing a program.

    Attributes
    ----------
    armed_to_play : bool
        A program must be armed before it is played, and is not armed afterwards.
    stretches_chips : bool
        Chips can be stretched by a known error of the clock.
    """

    armed_to_play: bool = False
    stretches_chips: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadReport:
    """Outcome of an upload that succeeded.

    Attributes
    ----------
    port : str
    program : Program
    trust : Trust
        Proven by the upload.
    read_back : bool
        Whether the device sent the program back, identical.
    firmware : str
        As the device reports it.
    armed : bool
        Whether the device now waits for a trigger; it does not if one came right after arming.
    lease_ms : int or None
        After how long without a trigger an armed device disarms itself.
    clock_ppm : float
        Assumed error of the device's clock, positive when fast.
    warnings : tuple of str
        Deviations from the program, one sentence each.
    retries : int
        Frames sent again because no valid reply came.
    seconds : float
    """

    port: str
    program: Program
    trust: Trust
    read_back: bool
    firmware: str
    armed: bool
    lease_ms: int | None
    retries: int
    seconds: float
    clock_ppm: float = 0.0
    warnings: tuple[str, ...] = ()


class Driver(Protocol):
    """A device that plays programs, on an open connection.

    Left by an exception, as a context manager, it closes and disarms the shutter. ``status``, and
    what is returned of it, is None where the device cannot be asked.
    """

    capabilities: ClassVar[Capabilities]

    @classmethod
    def open(cls, port: str) -> Self:
        """Open the device on a port; PortError when it is missing, busy or another device."""

    def check(self, program: Program, *, profile: DeviceProfile | None = None) -> tuple[str, ...]:
        """List every limit of the device, and of `profile`, that the program breaks."""

    def upload(
        self,
        program: Program,
        *,
        profile: DeviceProfile | None = None,
        arm: bool = False,
        lease_ms: int = LEASE_MS,
        clock_ppm: float = 0.0,
    ) -> UploadReport:
        """Check a program, store it, and arm if wanted.

        Parameters
        ----------
        profile : DeviceProfile, optional
            Limits of the shutter, and the level at which it is closed.
        lease_ms : int
            Lease of the arming; without effect on devices that have none.
        clock_ppm : float
            Error of the device's clock, positive when fast; chips are stretched by it.

        Raises
        ------
        ValueError
            If a limit is broken; the message lists all of them and nothing was sent.
        DeviceError, LinkError, VerifyError
            If the device refuses, stops answering, or is not in the state it should be in. ABORT
            has then been sent.
        """

    def arm(self) -> Status | None:
        """Let the next trigger play the program."""

    def play(self) -> Status | None:
        """Play the program once, now, and wait for its end."""

    def status(self) -> Status | None:  # None where the device cannot be asked
        """Ask for the state."""

    def abort(self) -> Status | None:
        """Close the shutter and disarm; raises when the device does not confirm it."""

    def __enter__(self) -> Self: ...

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None: ...
