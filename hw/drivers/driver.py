"""Base classes of drivers, of devices with and without a status: upload, arm, play, abort."""

from __future__ import annotations

import atexit
import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import ClassVar, Protocol, Self

from hw.cxp.protocol import Status
from hw.device import DeviceProfile, load_profile
from hw.errors import WrongStateError
from hw.program import Program

LEASE_MS = 10_000
"""After this an armed device disarms itself, where it can and no other lease is wanted, ms."""
_MARGIN_S = 0.01  # from the command to the first edge


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

    armed_to_play: ClassVar[bool] = False
    """Whether a program must be armed before it is played, and is not armed afterwards."""
    stretches_chips: ClassVar[bool] = False
    """Whether chips can be stretched by a known error of the clock."""

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
        report = self._upload(
            Program(code.bits, chip_ns=code.chip_ns),
            profile=load_profile(profile) if isinstance(profile, str) else profile,
            arm=arm or (play and self.armed_to_play),  # some devices only play what is armed
            lease_ms=lease_ms,
            clock_ppm=clock_ppm,
        )
        if play:
            self.play()
            if self.armed_to_play:  # the play used up the arming
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


class WriteOnlyDevice(Driver):
    """Base of drivers for devices without read-back or status: their trust is B.

    The uploaded program and the end of a play are known to this driver only. So only a program
    uploaded here is triggered, and only once at a time. As a context manager it aborts when left
    by an exception; left normally it leaves an armed device armed. One that is still open when the
    interpreter ends aborts too.

    Parameters
    ----------
    name : str
        Name of the port or resource, for messages.
    """

    limits: ClassVar[tuple[Callable[[Program], object], ...]]
    """Functions that raise ValueError for a program that the device cannot play."""

    def __init__(self, *, name: str) -> None:
        self.name = name
        self._program: Program | None = None
        self._ends_s = 0.0  # of the last play, on the monotonic clock
        # without a lease these devices would stay armed after Python has ended
        atexit.register(self._leave)

    @property
    @abstractmethod
    def firmware(self) -> str:
        """Firmware, as the device reports it."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user about this device, one sentence each."""
        return ()

    def check(self, program: Program, *, profile: DeviceProfile | None = None) -> tuple[str, ...]:
        """List every limit of the device, and of `profile`, that the program breaks."""
        problems: tuple[str, ...] = ()
        for limit in self.limits:
            try:
                limit(program)
            except ValueError as error:
                problems += (f"{self.name}: {error}",)
        if profile is None:
            return problems
        return problems + profile.check(program)

    def _upload(
        self,
        program: Program,
        *,
        profile: DeviceProfile | None,
        arm: bool,
        lease_ms: int,  # noqa: ARG002 - these devices stay armed until the next upload
        clock_ppm: float,
    ) -> UploadReport:
        if clock_ppm:
            raise ValueError(
                "clock_ppm: this device cannot stretch chips, only cxp controllers do"
            )
        problems = self.check(program, profile=profile)
        if problems:
            raise ValueError("program cannot be played: " + "; ".join(problems))
        start_s = time.monotonic()
        retries = self._retries
        self._program = None  # from here on it may hold neither the old one nor the new
        with self._aborted_on_error():
            self.abort()  # stored programs must not change under a running play
            self._load(program, profile=profile or DeviceProfile(name="generic"))
        self._program = program
        if arm:
            self.arm()
        return UploadReport(
            port=self.name,
            program=program,
            trust=Trust.B,
            read_back=False,
            firmware=self.firmware,
            armed=arm,
            lease_ms=None,
            retries=self._retries - retries,
            seconds=time.monotonic() - start_s,
            warnings=self.warnings,
        )

    def arm(self) -> None:
        """Let each rising edge of the trigger input play the program, until `abort`."""
        self._loaded("arm")
        with self._aborted_on_error():
            self._arm()

    def trigger(self) -> None:
        """Play the program once, now, without confirmation by the device.

        Raises
        ------
        WrongStateError
            If no program was uploaded here, or one that was triggered here is still playing.
        DeviceError, LinkError
            If the device refuses, or is gone; an abort has then been sent.
        """
        program = self._loaded("trigger")
        left_s = self._ends_s - time.monotonic()
        if left_s > 0:
            raise WrongStateError(
                f"{self.name} still plays for {left_s:.3g} s: wait before the next trigger"
            )
        with self._aborted_on_error():
            self._trigger()
        # The device does not tell the end of a play: it is over when its time is.
        self._ends_s = time.monotonic() + self._lasts_ns(program) / 1e9 + _MARGIN_S

    def wait(self) -> None:
        """Sleep until a program triggered by `trigger` must be over."""
        time.sleep(max(0.0, self._ends_s - time.monotonic()))

    def play(self) -> None:
        """Play the program once and wait for its end; what was not armed is not left armed."""
        self.trigger()
        self.wait()

    def abort(self) -> None:
        """Close the shutter and disarm; LinkError if the device does not acknowledge."""
        self._abort()
        self._ends_s = 0.0  # after it: an abort not confirmed may leave a play going on

    def close(self) -> None:
        """Close the connection without sending anything; may be called again."""
        atexit.unregister(self._leave)
        self._disconnect()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None:
            self._abort_after(error)
        self.close()

    def status(self) -> None:
        """Return nothing: these devices cannot be asked."""

    @property
    def _retries(self) -> int:
        return 0

    def _lasts_ns(self, program: Program) -> int:
        return program.duration_ns

    @abstractmethod
    def _load(self, program: Program, *, profile: DeviceProfile) -> None: ...

    @abstractmethod
    def _arm(self) -> None: ...

    @abstractmethod
    def _trigger(self) -> None: ...

    @abstractmethod
    def _abort(self) -> None: ...

    @abstractmethod
    def _disconnect(self) -> None: ...

    def _loaded(self, request: str) -> Program:
        if self._program is None:
            raise WrongStateError(
                f"{self.name} holds no program that was uploaded here: upload before {request}"
            )
        return self._program

    @contextlib.contextmanager
    def _aborted_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException as error:
            self._program = None  # it may hold half of it
            self._abort_after(error)
            raise

    def _abort_after(self, error: BaseException) -> None:
        note = f"{self.name} did not confirm ABORT: the shutter may still be open"
        # nested contexts would say it twice
        if not self._aborts() and note not in getattr(error, "__notes__", ()):
            error.add_note(note)

    def _aborts(self) -> bool:
        try:
            self.abort()
        except Exception:
            return False  # the error that led here is the one to be reported
        return True

    def _leave(self) -> None:
        self._aborts()
        self.close()
