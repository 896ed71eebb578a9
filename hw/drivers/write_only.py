"""Base class of drivers for devices without read-back or status."""

from __future__ import annotations

import atexit
import contextlib
import time
from abc import abstractmethod
from collections.abc import Callable, Iterator
from typing import ClassVar

from hw.device import DeviceProfile
from hw.drivers.driver import Driver, Trust, UploadReport
from hw.errors import WrongStateError
from hw.program import Program

_MARGIN_S = 0.01  # from the command to the first edge


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
