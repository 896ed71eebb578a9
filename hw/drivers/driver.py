"""Base class of the drivers: capabilities, upload with its report, arm, play, status, abort."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import ClassVar, Protocol, Self

from hw.cxp.protocol import Status
from hw.device import DeviceProfile, load_profile
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


class Playable(Protocol):
    """What is played: a program, or a code with its chip time."""

    @property
    def bits(self) -> str:
        """Chips, one character each: ``"1"`` is open."""

    @property
    def chip_ns(self) -> int:
        """Duration of a chip."""


class Driver(ABC):
    """A device that plays programs, on an open connection.

    Left by an exception, as a context manager, it closes and disarms the shutter. ``status``, and
    what is returned of it, is None where the device cannot be asked.
    """

    capabilities: ClassVar[Capabilities] = Capabilities()

    @classmethod
    @abstractmethod
    def open(cls, port: str) -> Self:
        """Open the device on a port; PortError when it is missing, busy or another device."""

    @abstractmethod
    def check(self, program: Program, *, profile: DeviceProfile | None = None) -> tuple[str, ...]:
        """List every limit of the device, and of `profile`, that the program breaks."""

    def upload(
        self,
        code: Playable,
        *,
        profile: DeviceProfile | str | None = None,
        arm: bool = False,
        play: bool = False,
        lease_ms: int = LEASE_MS,
        clock_ppm: float = 0.0,
    ) -> UploadReport:
        """Load a code, read it back where the device can be asked, and arm or play it if wanted.

        Parameters
        ----------
        code : Program, or cep.ShutterCode
        profile : DeviceProfile or str, optional
            Limits of the shutter, and the level at which it is closed; or their name as of
            :func:`hw.device.load_profile`. Checked before anything is sent.
        arm : bool
            The next trigger plays the code.
        play : bool
            Play it once, now, and wait for its end; it is not armed afterwards.
        lease_ms : int
            An armed "cxp" controller disarms itself after this; other devices stay armed until the
            next upload.
        clock_ppm : float
            By how much the clock of a "cxp" controller is fast, as ``cep hw calibrate`` finds it;
            chips are stretched by it.

        Raises
        ------
        ValueError
            If the shutter or the device cannot play the code: the line lists every limit it
            breaks. Nothing was sent.
        DeviceError, LinkError, VerifyError
            If the device refuses, stops answering, or holds another program than it was sent.
            ABORT has then been sent.
        """
        armed_to_play = self.capabilities.armed_to_play
        report = self._upload(
            Program(code.bits, chip_ns=code.chip_ns),
            profile=load_profile(profile) if isinstance(profile, str) else profile,
            arm=arm or (play and armed_to_play),  # some devices only play what is armed
            lease_ms=lease_ms,
            clock_ppm=clock_ppm,
        )
        if play:
            self.play()
            if armed_to_play:  # the play used up the arming
                report = replace(report, armed=False, lease_ms=None)
        return report

    @abstractmethod
    def _upload(
        self,
        program: Program,
        *,
        profile: DeviceProfile | None,
        arm: bool,
        lease_ms: int,
        clock_ppm: float,
    ) -> UploadReport: ...

    @abstractmethod
    def arm(self) -> Status | None:
        """Let the next trigger play the program."""

    @abstractmethod
    def play(self) -> Status | None:
        """Play the program once, now, and wait for its end."""

    @abstractmethod
    def status(self) -> Status | None:
        """Ask for the state."""

    @abstractmethod
    def abort(self) -> Status | None:
        """Close the shutter and disarm; raises when the device does not confirm it."""

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None: ...
