"""Driver of CXP1 controllers: check, load, read back, arm, trigger, abort."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Self

from hw.device import DeviceProfile
from hw.drivers.report import Trust, UploadReport
from hw.framing import FrameError
from hw.link import Link, open_link
from hw.program import Program
from hw.protocol import (
    MAX_TICKS,
    DeviceError,
    Hello,
    Op,
    State,
    Status,
    WrongStateError,
    pack_arm,
    pack_load,
    unpack_load,
    unpack_status,
)

__all__ = ["Controller", "VerifyError"]


class VerifyError(RuntimeError):
    """The device holds, or did, something else than it was told."""


class Controller:
    """A CXP1 shutter controller on an open link.

    Use it as a context manager: left by an exception it sends ABORT, which closes and disarms the shutter.

    Parameters
    ----------
    link : Link
        Open link, owned by the controller from now on.
    hello : Hello
        What the device announced.

    Examples
    --------
    ::

        with Controller.open("/dev/ttyUSB0") as controller:
            report = controller.upload(program, arm=True)
            controller.trigger()
            controller.wait(timeout_s=1.0)
    """

    def __init__(self, link: Link, hello: Hello) -> None:
        self.link = link
        self.announced = hello

    @classmethod
    def open(
        cls, port: str, *, baud: int = 115200, timeout_s: float = 0.15, attempts: int = 12, hello_s: float = 3.0
    ) -> Self:
        """Open the controller on a serial port; parameters and errors as `hw.link.open_link`."""
        return cls(*open_link(port, baud=baud, timeout_s=timeout_s, attempts=attempts, hello_s=hello_s))

    def hello(self) -> Hello:
        """Greet the device again and note what it announces."""
        self.announced = self.link.hello()
        return self.announced

    def check(self, program: Program, *, profile: DeviceProfile | None = None) -> tuple[str, ...]:
        """List every limit that the program breaks: those the device announced, and those of `profile`."""
        tick_ns = self.announced.tick_ns
        own = DeviceProfile(
            name=self.link.name, tick_ns=tick_ns, max_chip_ns=MAX_TICKS * tick_ns, max_chips=self.announced.max_chips
        )
        return own.check(program) + (profile.check(program) if profile else ())

    def load(self, program: Program) -> None:
        """Store a program in the device, which must be neither armed nor playing; nothing is checked here."""
        self.link.request(Op.LOAD, pack_load(program, tick_ns=self.announced.tick_ns))

    def read(self) -> Program:
        """Read the stored program back.

        Raises
        ------
        VerifyError
            If what comes is no program.
        """
        try:
            return unpack_load(self.link.request(Op.READ), tick_ns=self.announced.tick_ns)
        except FrameError as error:
            raise VerifyError(f"{self.link.name}: {error}") from None

    def arm(self, *, lease_ms: int = 10_000) -> None:
        """Let the next trigger play the program; without one the device disarms itself after `lease_ms`."""
        payload = pack_arm(lease_ms)
        self._closed_on_doubt(Op.ARM, payload)

    def trigger(self) -> None:
        """Play the program once; a lost reply never plays it twice."""
        self._closed_on_doubt(Op.TRIG)

    def abort(self) -> None:
        """Close the shutter and disarm.

        Raises
        ------
        LinkError
            If the device does not acknowledge.
        """
        self.link.request(Op.ABORT)

    def status(self) -> Status:
        """Ask for the state of the player.

        Raises
        ------
        VerifyError
            If the reply cannot be understood.
        """
        try:
            return unpack_status(self.link.request(Op.STATUS))
        except FrameError as error:
            raise VerifyError(f"{self.link.name}: {error}") from None

    def wait(self, *, timeout_s: float) -> Status:
        """Wait until the device is no longer playing, and return its status.

        Raises
        ------
        VerifyError
            If it still plays after `timeout_s`, or reports a fault; it has then been told to abort.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            status = self.status()
            late = status.state is State.PLAY and time.monotonic() >= deadline
            if late or status.state is State.FAULT:
                what = f"still plays after {timeout_s:g} s" if late else "reports a fault"
                closed = "told to abort" if self.link.abort() else "and ABORT is not acknowledged: look at the shutter"
                raise VerifyError(f"{self.link.name} {what}, {closed}")
            if status.state is not State.PLAY:
                return status
            time.sleep(0.001)

    def upload(
        self,
        program: Program,
        *,
        profile: DeviceProfile | None = None,
        verify: bool = True,
        arm: bool = False,
        lease_ms: int = 10_000,
    ) -> UploadReport:
        """Check a program, load it, read it back, and arm if wanted.

        Parameters
        ----------
        program : Program
            What to play.
        profile : DeviceProfile, optional
            Limits of the shutter, besides those the controller announced.
        verify : bool
            Read the stored program back and compare; without it the report's trust is only "acknowledged".
        arm : bool
            Arm when all went well.
        lease_ms : int
            Lease of the arming, ms.

        Returns
        -------
        UploadReport
            What is now known.

        Raises
        ------
        ValueError
            If a limit is broken; the message lists all of them and nothing was sent.
        VerifyError
            If the device holds another program than it was sent.
        DeviceError, LinkError
            If the device refuses, or stops answering.
        """
        problems = self.check(program, profile=profile)
        if problems:
            raise ValueError("program cannot be played: " + "; ".join(problems))
        payload = pack_arm(lease_ms)
        start, retries = time.monotonic(), self.link.retries
        try:
            self.load(program)
            if verify and (stored := self.read()) != program:
                raise VerifyError(
                    f"{self.link.name} holds another program than it was sent: {_difference(program, stored)}"
                )
            if arm:
                self.link.request(Op.ARM, payload)
        except WrongStateError:
            raise  # it is armed or playing for somebody: refusing is all it did, and all we should do
        except BaseException as error:
            self.link.abort_after(error)
            raise
        return UploadReport(
            port=self.link.name,
            chips=program.chips,
            chip_ns=program.chip_ns,
            pulses=program.pulses,
            duration_ns=program.duration_ns,
            code_crc32=program.code_crc32,
            trust=Trust.READ_BACK if verify else Trust.ACKNOWLEDGED,
            armed=arm,
            lease_ms=lease_ms if arm else None,
            retries=self.link.retries - retries,
            seconds=time.monotonic() - start,
        )

    def close(self) -> None:
        """Close the port without a word to the device."""
        self.link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.link.__exit__(kind, error, trace)

    def _closed_on_doubt(self, op: Op, payload: bytes = b"") -> None:
        try:
            self.link.request(op, payload)
        except DeviceError:
            raise  # refused: nothing changed in the device
        except (
            BaseException
        ) as error:  # no reply: it may or may not be armed or open, and closed is the only safe guess
            self.link.abort_after(error)
            raise


def _difference(sent: Program, stored: Program) -> str:
    if sent.chip_ns != stored.chip_ns:
        return f"chip of {stored.chip_ns} ns, not {sent.chip_ns}"
    if sent.chips != stored.chips:
        return f"{stored.chips} chips, not {sent.chips}"
    wrong = [k for k, (a, b) in enumerate(zip(sent.bits, stored.bits, strict=True)) if a != b]
    return f"{len(wrong)} of {sent.chips} chips differ, the first is chip {wrong[0]}"
