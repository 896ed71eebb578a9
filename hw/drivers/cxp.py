"""Driver of CXP1 controllers: check, load, read back, arm, trigger, abort."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Self

from hw.cxp.link import open_link
from hw.cxp.player import RemotePlayer
from hw.cxp.protocol import State, pack_arm
from hw.device import DeviceProfile, refusal
from hw.drivers.report import Trust, UploadReport
from hw.errors import WrongStateError
from hw.program import Program

PROVEN_FIRMWARE = frozenset({"cxp-avr 1", "cxp-rp2040 1"})
"""Firmware whose edges the tests prove on emulated processors."""


class Controller(RemotePlayer):
    """A CXP1 shutter controller on an open link.

    Use it as a context manager: left by an exception after it has loaded, armed or triggered
    anything it sends ABORT, which closes and disarms the shutter.

    Parameters
    ----------
    link : Link
        Open link, owned by the controller from now on.
    hello : Hello
        HELLO of the device.

    Examples
    --------
    ::

        with Controller.open("/dev/ttyUSB0") as controller:
            report = controller.upload(program, arm=True)
            controller.play(timeout_s=1.0)
    """

    @classmethod
    def open(
        cls,
        port: str,
        *,
        baud: int = 115200,
        timeout_s: float = 0.15,
        attempts: int = 12,
        hello_s: float = 3.0,
    ) -> Self:
        """Open the controller on a serial port; parameters and errors as
        `hw.cxp.link.open_link`.
        """
        return cls(
            *open_link(port, baud=baud, timeout_s=timeout_s, attempts=attempts, hello_s=hello_s)
        )

    @property
    def limits(self) -> DeviceProfile:
        """Limits that the device announced."""
        hello = self.announced
        return DeviceProfile(
            name=self.link.name,
            description=hello.firmware,
            tick_ns=hello.tick_ns,
            min_chip_ns=hello.min_ticks * hello.tick_ns,
            max_chip_ns=hello.max_ticks * hello.tick_ns,
            max_chips=hello.max_chips,
            max_on_ns=None if hello.max_on_ticks is None else hello.max_on_ticks * hello.tick_ns,
            max_duty=hello.max_duty,
        )

    @property
    def trust(self) -> Trust:
        """Trust that :meth:`verify` proves of a program: A with firmware of
        :data:`PROVEN_FIRMWARE`, else B.
        """
        return Trust.A if self.announced.firmware in PROVEN_FIRMWARE else Trust.B

    def check(self, program: Program, *, profile: DeviceProfile | None = None) -> tuple[str, ...]:
        """List every limit that the program breaks: those the device announced, and those of
        `profile`.
        """
        found = self.limits.check(program)
        if profile is None:
            return found
        if profile.closed_level:
            found += (
                (
                    f"{profile.name}: closed at a high level, but this controller rests low; put"
                    " an inverter between"
                ),
            )
        return found + profile.check(program)

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
            Program to play.
        profile : DeviceProfile, optional
            Limits of the shutter, besides those the controller announced.
        verify : bool
            Read the stored program back and compare; without it the report's trust is B.
        arm : bool
            Arm when all went well.
        lease_ms : int
            Lease of the arming, ms.
        clock_ppm : float
            Error of the device's clock, positive when fast (`hw.cxp.clock.measure_clock`); chips
            are stretched by it.

        Raises
        ------
        ValueError
            If a limit is broken; the message lists all of them and nothing was sent.
        VerifyError
            If the device holds another program than it was sent, or is not in the state it should
            be in.
        DeviceError, LinkError
            If the device refuses, or stops answering.
        """
        problems = self.check(program, profile=profile)
        if problems:
            raise ValueError(refusal(problems, self.limits))
        payload = pack_arm(lease_ms)
        start = time.monotonic()
        retries = self.link.retries
        armed = False
        try:
            self.load(program, clock_ppm=clock_ppm)
            if verify:
                self.verify(program, clock_ppm=clock_ppm)
            if arm:
                armed = self._armed(payload, self.status()).state is State.ARMED
        except WrongStateError:
            raise  # it is armed or playing for another host: leave it as it is
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
            trust=self.trust if verify else Trust.B,
            armed=armed,
            lease_ms=lease_ms if armed else None,
            clock_ppm=clock_ppm,
            warnings=_warnings(profile),
            retries=self.link.retries - retries,
            seconds=time.monotonic() - start,
        )

    def close(self) -> None:
        """Close the port without sending anything."""
        self.link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.link.__exit__(kind, error, trace)


def _warnings(profile: DeviceProfile | None) -> tuple[str, ...]:
    if profile is None or not profile.on_bias_ns:
        return ()
    return (
        (
            f"{profile.name} makes every opening {profile.on_bias_ns} ns longer, which a"
            " controller of whole chips cannot take back; the camera recipe (cep export --format"
            " camera) does"
        ),
    )
