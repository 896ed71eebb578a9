"""Driver of CXP1 controllers: check, load, read back, arm, play, abort; error of their clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from statistics import linear_regression, pstdev
from typing import ClassVar, Self

from hw.cxp.link import Link, only_controller, open_link
from hw.cxp.protocol import (
    AT_REST,
    FrameError,
    Hello,
    Op,
    State,
    Status,
    Stored,
    pack_arm,
    stored_program,
    unpack_crc,
    unpack_status,
    unpack_stored,
)
from hw.device import DeviceProfile, refusal
from hw.drivers.driver import LEASE_MS, Driver, Trust, UploadReport
from hw.errors import DeviceError, VerifyError, WrongStateError
from hw.program import Program

PROVEN_FIRMWARE = frozenset({"cxp-avr 1", "cxp-rp2040 1"})
"""Firmware whose edges the tests prove on emulated processors."""
_WRAP_US = 2**32  # STATUS counts 32 bits: some 72 minutes
_LEAST_READINGS = 8
_READINGS_IN_A_ROW = 4
_LARGEST_PPM = 100_000  # 10 %: a clock that is worse is no clock


class Controller(Driver):
    """A CXP1 shutter controller on an open link.

    Every change is confirmed by the controller's status afterwards. Left by an exception, as a
    context manager, it sends ABORT after it has loaded, armed or triggered anything, which closes
    and disarms the shutter.

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
            controller.play()
    """

    armed_to_play: ClassVar[bool] = True
    stretches_chips: ClassVar[bool] = True

    def __init__(self, link: Link, hello: Hello) -> None:
        self.link = link
        self.announced = hello

    @classmethod
    def open(
        cls, port: str, *, timeout_s: float = 0.15, attempts: int = 12, hello_s: float = 3.0
    ) -> Self:
        """Open the controller on a port, or with ``"auto"`` the only one that is connected.

        Other parameters as `hw.cxp.link.open_link`.

        Raises
        ------
        PortError
            If the port cannot be opened or is no controller, or with ``"auto"`` there is none, or
            more than one.
        """
        if port == "auto":
            port = only_controller()
        link, hello = open_link(port, timeout_s=timeout_s, attempts=attempts, hello_s=hello_s)
        return cls(link, hello)

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
            max_on_ns=hello.max_on_ns,
            max_duty=hello.max_duty,
        )

    @property
    def trust(self) -> Trust:
        """Trust that :meth:`verify` proves: A with :data:`PROVEN_FIRMWARE`, else B."""
        return Trust.A if self.announced.firmware in PROVEN_FIRMWARE else Trust.B

    def check(self, program: Program, *, profile: DeviceProfile | None = None) -> tuple[str, ...]:
        """List every limit that the program breaks: the announced ones, and those of `profile`."""
        problems = self.limits.check(program)
        if profile is None:
            return problems
        if profile.closed_level:
            problems += (
                f"{profile.name}: closed at a high level, but this controller rests low; put an"
                " inverter between",
            )
        return problems + profile.check(program)

    def _upload(
        self,
        program: Program,
        *,
        profile: DeviceProfile | None,
        arm: bool,
        lease_ms: int,
        clock_ppm: float,
    ) -> UploadReport:
        problems = self.check(program, profile=profile)
        if problems:
            raise ValueError(refusal(problems, self.limits))
        payload = pack_arm(lease_ms)  # a wrong lease is refused before anything is sent
        start_s = time.monotonic()
        retries = self.link.retries
        armed = False
        # in a wrong state it is armed or playing for another host: it is left as it is
        with self.link.aborted_on_error(WrongStateError):
            self.load(program, clock_ppm=clock_ppm)
            self.verify(program, clock_ppm=clock_ppm)
            if arm:
                armed = self._armed(payload, self.status()).state is State.ARMED
        return UploadReport(
            port=self.link.name,
            program=program,
            firmware=self.announced.firmware,
            read_back=True,
            trust=self.trust,
            armed=armed,
            lease_ms=lease_ms if armed else None,
            clock_ppm=clock_ppm,
            warnings=_warnings(profile),
            retries=self.link.retries - retries,
            seconds=time.monotonic() - start_s,
        )

    def load(self, program: Program, *, clock_ppm: float = 0.0) -> Stored:
        """Store a program in the device, which must be neither armed nor playing.

        Its limits are not checked here. The program sent is returned, as the device confirmed it.

        Raises
        ------
        ValueError
            If the program cannot be expressed in the device's ticks.
        VerifyError
            If the device confirms another CRC-32, or is not loaded afterwards.
        """
        stored = stored_program(program, self.announced, clock_ppm=clock_ppm)
        with self._understood():
            crc = unpack_crc(self.link.request(Op.LOAD, stored.payload))
        if crc != stored.crc32:
            raise VerifyError(
                f"{self.link.name} confirms CRC32 0x{crc:08x}: 0x{stored.crc32:08x} was sent"
            )
        status = self.status()
        if status.state is not State.LOADED:
            raise self._contradiction(Op.LOAD, status)
        return stored

    def read(self) -> Stored:
        """Read the stored program back; VerifyError if the reply is no program."""
        with self._understood():
            return unpack_stored(self.link.request(Op.READ))

    def verify(self, program: Program, *, clock_ppm: float = 0.0) -> None:
        """Read the stored program back; VerifyError says how it differs from the one given."""
        right = stored_program(program, self.announced, clock_ppm=clock_ppm)
        stored = self.read()
        if stored != right:
            raise VerifyError(
                f"{self.link.name} holds another program than it was sent:"
                f" {right.difference(stored)}"
            )

    def arm(self, *, lease_ms: int = LEASE_MS) -> Status:
        """Let the next trigger play the program, until the lease is over.

        Returns
        -------
        Status
            Read back afterwards: ARMED, or PLAY or DONE where the trigger input was quicker.

        Raises
        ------
        VerifyError
            If the device is in another state; ABORT has then been sent.
        """
        payload = pack_arm(lease_ms)
        before = self.status()  # a trigger input may play it before the reply comes
        with self._closed_on_doubt():
            return self._armed(payload, before)

    def renew(self, *, lease_ms: int = LEASE_MS) -> Status:
        """Arm an armed device anew, unless a trigger is quicker: then it plays, and is left alone.

        Returns
        -------
        Status
            ARMED, or what a trigger has made of it.
        """
        status = self.status()
        if status.state is not State.ARMED:
            return status
        try:
            return self.arm(lease_ms=lease_ms)
        except WrongStateError:
            status = self.status()
            if status.state not in (State.PLAY, State.DONE):
                raise
            return status

    def trigger(self) -> None:
        """Play the program once; a lost reply never plays it twice. The end is not awaited."""
        with self._closed_on_doubt():
            self.link.request(Op.TRIG)

    def play(self) -> Status:
        """Play the armed program once, wait for its end, and read back that it was played.

        Returns
        -------
        Status
            Read back afterwards: DONE, with one more play ended and no edge of it missed.

        Raises
        ------
        VerifyError
            If it plays for longer than the stored program lasts, or the status is another one;
            ABORT has then been sent.
        """
        stored = self.read()
        duration_ns = len(stored.bits) * float(stored.chip_ticks) * self.announced.tick_ns
        before = self.status()
        self.trigger()
        status = self.wait(timeout_s=1.1e-9 * duration_ns + 2)  # a clock may be 10 % slow
        with self._closed_on_doubt():
            # The count of plays, not the state: DONE may be that of an earlier play.
            plays = (status.runs - before.runs) % 65536
            missed = status.late - before.late
            if (status.state, plays, missed) != (State.DONE, 1, 0):
                raise self._contradiction(
                    Op.TRIG, status, f", with {plays} plays ended and {missed} edges missed"
                )
        return status

    def wait(self, *, timeout_s: float) -> Status:
        """Wait until the device is no longer playing, and return its status.

        VerifyError if it still plays after `timeout_s`, or reports a fault; ABORT has then been
        sent.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            status = self.status()
            late = status.state is State.PLAY and time.monotonic() >= deadline
            if late or status.state is State.FAULT:
                failure = f"still plays after {timeout_s:g} s" if late else "reports a fault"
                error = VerifyError(f"{self.link.name} {failure}; ABORT was sent")
                self.link.abort_after(error)
                raise error
            if status.state is not State.PLAY:
                return status
            time.sleep(0.001)  # a question takes longer on the line

    def abort(self) -> Status:
        """Close the shutter and disarm; the status afterwards is IDLE or LOADED.

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
                raise self._contradiction(Op.ABORT, status)
        except BaseException as error:
            error.add_note("the shutter may still be open")
            raise
        return status

    def status(self) -> Status:
        """Ask for the state of the player; VerifyError if the reply cannot be understood."""
        with self._understood():
            return unpack_status(self.link.request(Op.STATUS))

    def close(self) -> None:
        """Close the port without sending anything."""
        self.link.close()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.link.__exit__(kind, error, trace)

    def _armed(self, payload: bytes, before: Status) -> Status:
        self.link.request(Op.ARM, payload)
        status = self.status()
        played = status.state is State.DONE and status.runs != before.runs
        # Without a trigger input nothing but this host could have begun a play.
        triggered = self.announced.trigger_input and (status.state is State.PLAY or played)
        if status.state is not State.ARMED and not triggered:
            lease_ms = int.from_bytes(payload, "little")
            hint = ""
            if status.state is State.LOADED:
                hint = f"; its lease of {lease_ms} ms may be over"
            raise self._contradiction(Op.ARM, status, hint)
        return status

    def _contradiction(self, op: Op, status: Status, more: str = "") -> VerifyError:
        return VerifyError(
            f"{self.link.name} acknowledged {op.name}, but is {status.state.name} afterwards{more}"
        )

    @contextmanager
    def _understood(self) -> Iterator[None]:
        try:
            yield
        except FrameError as error:
            # what cannot be read verifies nothing
            raise VerifyError(f"{self.link.name}: {error}") from None

    def _closed_on_doubt(self) -> AbstractContextManager[None]:
        # No reply, or a wrong one: it may or may not be armed or open, and closed is the only safe
        # guess. Where it refuses, nothing changed in it.
        return self.link.aborted_on_error(DeviceError)


def _warnings(profile: DeviceProfile | None) -> tuple[str, ...]:
    if profile is None or not profile.on_bias_ns:
        return ()
    return (
        f"{profile.name} makes every opening {profile.on_bias_ns} ns longer, which a controller of"
        " whole chips cannot take back; the camera recipe (cep export --format camera) does",
    )


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Error of a device's clock.

    Parameters
    ----------
    ppm : float
        Parts per million; negative when it is slow and plays everything too long.
    uncertainty_ppm : float
        Two standard errors of the fit. The host's own clock, good to some 20 ppm, is taken as
        right.
    seconds : float
        Time between the first and the last reading.
    samples : int
        Readings used.
    """

    ppm: float
    uncertainty_ppm: float
    seconds: float
    samples: int


def fit_clock(readings: Sequence[tuple[float, float, int]]) -> ClockFit:
    """Fit a line to readings of a device's clock.

    The time of a reading lies between the request and its reply. The quickest of every four in a
    row is used, at the middle: a constant delay moves the line without tilting it. (The quickest
    quarter of all may come from a short part of the time where delays are even.)

    Parameters
    ----------
    readings : sequence of (sent_s, received_s, device_us)
        Host times, and the device's clock, which wraps at 2^32 us; 8 or more.

    Raises
    ------
    ValueError
        If the device's clock does not go on with the host's (a restart).
    """
    start_s, _, start_us = readings[0]
    # delay, host s, device s less host s (small: it keeps its digits)
    points: list[tuple[float, float, float]] = []
    device_us = 0
    previous = start_us
    for sent_s, received_s, now_us in readings:
        device_us += (now_us - previous) % _WRAP_US
        previous = now_us
        host_s = 0.5 * (sent_s + received_s) - start_s
        drift_s = device_us * 1e-6 - host_s
        # Half a second beyond the largest error: a slow first reply is no restart.
        if abs(drift_s) > _LARGEST_PPM * 1e-6 * host_s + 0.5:
            raise ValueError(
                "the device's clock jumped: it was restarted meanwhile, or is no clock; measure"
                " again"
            )
        points.append((received_s - sent_s, host_s, drift_s))
    row = min(_READINGS_IN_A_ROW, len(points) // _LEAST_READINGS)
    quick = [min(points[k : k + row]) for k in range(0, len(points) - row + 1, row)]
    _, times_s, drifts_s = zip(*quick, strict=True)
    slope, offset_s = linear_regression(times_s, drifts_s)
    residuals = [d - offset_s - slope * t for t, d in zip(times_s, drifts_s, strict=True)]
    # Two standard errors of the slope.
    error = math.hypot(*residuals) / math.sqrt((len(quick) - 2) * len(quick)) / pstdev(times_s)
    return ClockFit(1e6 * slope, 2e6 * error, times_s[-1] - times_s[0], len(quick))


def measure_clock(
    controller: Controller,
    *,
    seconds: float = 10.0,
    progress: Callable[[float], None] | None = None,
) -> ClockFit:
    """Read a controller's clock again and again, and fit it against the host's.

    Parameters
    ----------
    seconds : float
        Duration; the error falls with its power of 1.5.
    progress : callable, optional
        Called with the fraction done, 0..1.

    Raises
    ------
    ValueError
        If `seconds` is not above 0.
    VerifyError
        If the device was restarted meanwhile.
    """
    if not 0 < seconds < 3600:
        raise ValueError(f"seconds is {seconds}: above 0 and below 3600 are needed; 10 are plenty")
    readings: list[tuple[float, float, int]] = []
    start = time.monotonic()
    while (sent_s := time.monotonic()) < start + seconds or len(readings) < _LEAST_READINGS:
        retries = controller.link.retries
        uptime_us = controller.status().uptime_us
        if controller.link.retries == retries:  # a retry hides when the clock was read
            readings.append((sent_s, time.monotonic(), uptime_us))
        if progress is not None:
            progress(min(1.0, (time.monotonic() - start) / seconds))
    try:
        return fit_clock(readings)
    except ValueError as error:
        raise VerifyError(f"{controller.link.name}: {error}") from None
