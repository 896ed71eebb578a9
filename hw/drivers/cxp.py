"""Driver of CXP1 controllers: check, load, read back, arm, trigger, abort."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self

from hw.cxp.framing import FrameError
from hw.cxp.link import Link, open_link
from hw.cxp.protocol import (
    AT_REST,
    Hello,
    Op,
    State,
    Status,
    pack_arm,
    unpack_crc,
    unpack_status,
)
from hw.cxp.stored import Stored, stored_program, unpack_stored
from hw.device import DeviceProfile
from hw.drivers.report import Trust, UploadReport
from hw.errors import DeviceError, WrongStateError
from hw.program import Program

__all__ = ["PROVEN_FIRMWARE", "Controller", "VerifyError"]

PROVEN_FIRMWARE = frozenset({"cxp-avr 1", "cxp-rp2040 1"})
"""Firmware whose edges the tests prove on emulated processors."""


class VerifyError(RuntimeError):
    """The device holds, or did, something else than it was told."""


class Controller:
    """A CXP1 shutter controller on an open link.

    Use it as a context manager: left by an exception after it has loaded, armed or triggered anything it sends ABORT,
    which closes and disarms the shutter.

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
            controller.play(timeout_s=1.0)
    """

    def __init__(self, link: Link, hello: Hello) -> None:
        self.link = link
        self.announced = hello

    @classmethod
    def open(
        cls, port: str, *, baud: int = 115200, timeout_s: float = 0.15, attempts: int = 12, hello_s: float = 3.0
    ) -> Self:
        """Open the controller on a serial port; parameters and errors as `hw.cxp.link.open_link`."""
        return cls(*open_link(port, baud=baud, timeout_s=timeout_s, attempts=attempts, hello_s=hello_s))

    @property
    def limits(self) -> DeviceProfile:
        """Limits that the device announced."""
        told = self.announced
        return DeviceProfile(
            name=self.link.name,
            description=told.firmware,
            tick_ns=told.tick_ns,
            min_chip_ns=told.min_ticks * told.tick_ns,
            max_chip_ns=told.max_ticks * told.tick_ns,
            max_chips=told.max_chips,
            max_on_ns=None if told.max_on_ticks is None else told.max_on_ticks * told.tick_ns,
            max_duty=told.max_duty,
        )

    def check(self, program: Program, *, profile: DeviceProfile | None = None) -> tuple[str, ...]:
        """List every limit that the program breaks: those the device announced, and those of `profile`."""
        found = self.limits.check(program)
        if profile is None:
            return found
        if profile.closed_level:
            found += (
                f"{profile.name}: closed at a high level, but this controller rests low; put an inverter between",
            )
        return found + profile.check(program)

    def load(self, program: Program, *, clock_ppm: float = 0.0) -> Stored:
        """Store a program in the device, which must be neither armed nor playing; its limits are not checked here.

        Returns
        -------
        Stored
            What was sent, of which the device has confirmed the CRC-32.

        Raises
        ------
        ValueError
            If the program cannot be said in the device's ticks, see `hw.cxp.protocol.stored_program`.
        VerifyError
            If the device confirms something else, or is not loaded afterwards.
        """
        wanted = stored_program(program, self.announced, clock_ppm=clock_ppm)
        try:
            crc = unpack_crc(self.link.request(Op.LOAD, wanted.payload))
        except FrameError as error:
            raise VerifyError(f"{self.link.name}: {error}") from None
        if crc != wanted.crc32:
            raise VerifyError(f"{self.link.name} confirms CRC32 0x{crc:08x}: 0x{wanted.crc32:08x} was sent")
        status = self.status()
        if status.state is not State.LOADED:
            raise self._belied(Op.LOAD, status)
        return wanted

    def read(self) -> Stored:
        """Read the stored program back, as the device has it.

        Raises
        ------
        VerifyError
            If what comes is no program.
        """
        try:
            return unpack_stored(self.link.request(Op.READ))
        except FrameError as error:
            raise VerifyError(f"{self.link.name}: {error}") from None

    def verify(self, program: Program, *, clock_ppm: float = 0.0) -> None:
        """Read the stored program back and compare it.

        Raises
        ------
        VerifyError
            If the device holds another program; the message says what differs.
        """
        wanted, stored = stored_program(program, self.announced, clock_ppm=clock_ppm), self.read()
        if stored != wanted:
            raise VerifyError(f"{self.link.name} holds another program than it was sent: {wanted.difference(stored)}")

    def arm(self, *, lease_ms: int = 10_000) -> Status:
        """Let the next trigger play the program; without one the device disarms itself after `lease_ms`.

        Returns
        -------
        Status
            Read back afterwards. The state is ARMED, or PLAY or DONE where the trigger input was quicker.

        Raises
        ------
        VerifyError
            If the device is in another state; it has then been told to abort.
        """
        payload = pack_arm(lease_ms)
        before = self.status()
        with self._closed_on_doubt():
            return self._armed(payload, before)

    def trigger(self) -> None:
        """Play the program once; a lost reply never plays it twice. The device acknowledges, and no more is known."""
        with self._closed_on_doubt():
            self.link.request(Op.TRIG)

    def play(self, *, timeout_s: float) -> Status:
        """Play the program once, wait for its end, and read back that it was played.

        Returns
        -------
        Status
            Read back afterwards. The state is DONE, one more play has ended, and no edge of it was missed.

        Raises
        ------
        VerifyError
            If it still plays after `timeout_s`, or if the device says anything else; it has then been told to abort.
        """
        before = self.status()
        self.trigger()
        status = self.wait(timeout_s=timeout_s)
        with self._closed_on_doubt():
            ended, missed = (status.runs - before.runs) % 65536, status.late - before.late
            if (status.state, ended, missed) != (State.DONE, 1, 0):
                raise self._belied(Op.TRIG, status, f", with {ended} plays ended and {missed} edges missed")
        return status

    def abort(self) -> Status:
        """Close the shutter and disarm.

        Returns
        -------
        Status
            Read back afterwards. The state is IDLE or LOADED.

        Raises
        ------
        LinkError
            If the device does not answer.
        VerifyError
            If the device is in another state.
        """
        try:
            self.link.request(Op.ABORT)
            status = self.status()
            if status.state not in AT_REST:
                raise self._belied(Op.ABORT, status)
        except BaseException as error:
            error.add_note("the shutter may still be open")
            raise
        return status

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
                error = VerifyError(f"{self.link.name} {what}, told to abort")
                self.link.abort_after(error)
                raise error
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
        clock_ppm: float = 0.0,
    ) -> UploadReport:
        """Check a program, load it, read it back, and arm if wanted.

        Parameters
        ----------
        program : Program
            What to play.
        profile : DeviceProfile, optional
            Limits of the shutter, besides those the controller announced.
        verify : bool
            Read the stored program back and compare; without it the report's trust is B.
        arm : bool
            Arm when all went well.
        lease_ms : int
            Lease of the arming, ms.
        clock_ppm : float
            By how much the device's clock is fast, as `hw.cxp.clock.measure_clock` finds it; chips are stretched by it.

        Raises
        ------
        ValueError
            If a limit is broken; the message lists all of them and nothing was sent.
        VerifyError
            If the device holds another program than it was sent, or is not in the state it should be in.
        DeviceError, LinkError
            If the device refuses, or stops answering.
        """
        problems = self.check(program, profile=profile)
        if problems:
            raise ValueError("program cannot be played: " + "; ".join(problems))
        payload = pack_arm(lease_ms)
        start, retries = time.monotonic(), self.link.retries
        armed = False
        try:
            self.load(program, clock_ppm=clock_ppm)
            if verify:
                self.verify(program, clock_ppm=clock_ppm)
            if arm:
                armed = self._armed(payload, self.status()).state is State.ARMED
        except WrongStateError:
            raise  # it is armed or playing for somebody: refusing is all it did, and all we do
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
            firmware=self.announced.firmware,
            read_back=verify,
            trust=Trust.A if verify and self.announced.firmware in PROVEN_FIRMWARE else Trust.B,
            armed=armed,
            lease_ms=lease_ms if armed else None,
            clock_ppm=clock_ppm,
            warnings=_warnings(profile),
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

    def _armed(self, payload: bytes, before: Status) -> Status:
        self.link.request(Op.ARM, payload)
        status = self.status()
        played = status.state is State.DONE and status.runs != before.runs
        triggered = self.announced.trigger_input and (status.state is State.PLAY or played)
        if status.state is not State.ARMED and not triggered:
            lease_ms = int.from_bytes(payload, "little")
            over = f"; its lease of {lease_ms} ms may be over" if status.state is State.LOADED else ""
            raise self._belied(Op.ARM, status, over)
        return status

    def _belied(self, op: Op, status: Status, more: str = "") -> VerifyError:
        return VerifyError(f"{self.link.name} acknowledged {op.name}, but is {status.state.name} afterwards{more}")

    @contextmanager
    def _closed_on_doubt(self) -> Iterator[None]:
        try:
            yield
        except DeviceError:
            raise  # refused: nothing changed in the device
        except BaseException as error:
            # No reply, or a wrong one: it may or may not be armed or open, and closed is the only safe guess.
            self.link.abort_after(error)
            raise


def _warnings(profile: DeviceProfile | None) -> tuple[str, ...]:
    if profile is None or not profile.on_bias_ns:
        return ()
    return (
        f"{profile.name} makes every opening {profile.on_bias_ns} ns longer, which a controller of whole chips cannot "
        "take back; the camera recipe (cep export --format camera) does",
    )
